"""Episodes, their outcomes, and the included policies."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import graceful_plan as gp
from failbench.cli import main
from failbench.fault.registry import faults
from failbench.policies.adapters import LeRobotPolicy, OpenLoop, planned, reach, scripted
from failbench.policies.evaluation import evaluate
from failbench.policies.mlp import Mlp
from failbench.policies.policy import Acting, PolicyError, imported_policy
from failbench.policies.rollouts import roll_out
from failbench.policies.task import PolicySettings, policy_task
from failbench.recording.records import RolloutRequest
from graceful_plan.exceptions import FormatError, SettingError, ShapeError, UnknownNameError


def following(task, seed):
    return OpenLoop(task.straight, task.settings.period)


def standing(task, seed):
    return Acting(lambda seen: np.zeros(len(seen.q)), "joint_velocity")


def same(a, b) -> bool:
    keep = ("seed", "onset", "status", "reached", "distance", "duration", "events", "landings", "dropped", "spilled")
    return all(getattr(a, name) == getattr(b, name) for name in keep)


@pytest.fixture(scope="module")
def noisy():
    return policy_task("tabletop_l1/green_to_blue", PolicySettings(limit=1.6, horizon=0.3))


def test_episodes_depend_on_the_seed_alone(noisy):
    jobs = [None, RolloutRequest(fault=faults()["gripper_failure"](), onset=0.4, seed=1), None]
    together = roll_out(noisy, following, [3, 4, 5], jobs)
    alone = roll_out(noisy, following, [4], jobs[1:2])
    again = roll_out(noisy, following, [5, 4, 3], jobs[::-1], batch=1)
    assert same(together[1], alone[0])
    assert all(same(a, b) for a, b in zip(together, again[::-1], strict=True))
    assert not same(together[0], together[2])


def test_success_is_at_the_goal_and_with_the_object(easy):
    drop = RolloutRequest(fault=faults()["gripper_failure"](degree="critical"), onset=0.5, seed=1)
    done, stood, dropped = (
        roll_out(easy, make, [0], [job])[0] for make, job in ((following, None), (standing, None), (following, drop))
    )
    assert done.success and done.reached == pytest.approx(easy.straight.duration, abs=0.1)
    assert done.distance[0] < 0.005
    assert not stood.success and stood.reached is None and stood.duration == pytest.approx(1.6)
    assert not dropped.success and dropped.dropped and dropped.onset == pytest.approx(0.5)
    assert dropped.harm(easy.scene) > 0.0 == done.harm(easy.scene)
    assert dropped.duration >= 0.5 + easy.settings.horizon


def test_an_evaluation_counts_the_harm_added_by_the_fault(easy):
    report = evaluate(easy, following, ["drop/gripper_failure/critical"], n=2, threads=1)
    figures = report.by_fault["gripper_failure/critical"]
    assert report.healthy.success.mean == 1.0 and figures.success.mean == 0.0
    assert figures.added is not None and figures.added.mean == pytest.approx(figures.harm.mean)
    assert report.harm_per_task == pytest.approx(1e-3 * report.duration / 3600.0 * figures.added.mean)
    onsets = [rollout.onset for rollout in report.rollouts["gripper_failure/critical"]]
    assert 0.0 <= onsets[0] < report.duration / 2.0 <= onsets[1] + 0.01  # one onset per stratum
    assert "gripper_failure/critical" in str(report) and report.to_document()["schema"] == "failbench.policy"
    lost = replace(report, healthy_rollouts=tuple(replace(one, reached=None) for one in report.healthy_rollouts))
    assert str(lost) != str(report)  # unfinished tasks are reported


def test_the_script_lifts_first_and_arrives():
    task = policy_task("tabletop_l1/green_to_blue", PolicySettings(noise=0.0, limit=4.0))
    heights, policy = [], scripted(task, 0)

    def watching(seen):
        heights.append(seen.tool[6])
        return policy(seen)

    found = roll_out(task, lambda task, seed: Acting(watching, "tool_pose"), [0])[0]
    assert found.success
    assert max(heights) > heights[0] + 0.1


def test_the_trained_policy_arrives_from_an_unseen_start():
    task = policy_task("tabletop/green_to_blue", PolicySettings(noise=0.1))
    found = roll_out(task, reach, [10**6, 10**6 + 1])
    assert all(rollout.reached is not None for rollout in found)


@pytest.mark.long
def test_planned_motions_are_followed(easy):
    found = roll_out(easy, planned(0.0, iterations=5), [0])[0]
    assert found.success


# --- networks and other people's policies ----------------------------------------------------------------------------


def test_a_network_is_the_formula_and_survives_its_file(tmp_path):
    rng = np.random.default_rng(0)
    W0, b0, W1, b1 = rng.normal(size=(4, 3)), rng.normal(size=4), rng.normal(size=(2, 4)), rng.normal(size=2)
    network, x = Mlp((W0, W1), (b0, b1)), rng.normal(size=(5, 3))
    np.testing.assert_allclose(network(x), np.tanh(x @ W0.T + b0) @ W1.T + b1)
    network.save(tmp_path / "net.npz")
    np.testing.assert_allclose(Mlp.load(tmp_path / "net.npz")(x), network(x), atol=1e-5)
    with pytest.raises(ShapeError):
        network(np.zeros(4))
    with pytest.raises(ShapeError):
        Mlp((W0, W0), (b0, b0))


@pytest.mark.parametrize(
    "arrays",
    [
        {"w0": np.array([{}], dtype=object), "b0": np.zeros(1)},
        {"w0": np.zeros((1, 1))},
        {"w0": np.full((1, 1), np.nan), "b0": np.zeros(1)},
        {"w1": np.zeros((1, 1)), "b0": np.zeros(1)},
        {"w0": np.array([["a"]]), "b0": np.zeros(1)},
        {"w0": np.zeros((2, 3)), "b0": np.zeros(5)},
    ],
    ids=["pickled", "odd", "nan", "names", "text", "shapes"],
)
def test_files_that_hold_no_network_are_refused(tmp_path, arrays):
    np.savez(tmp_path / "net.npz", **arrays)
    with pytest.raises((FormatError, ShapeError)):
        Mlp.load(tmp_path / "net.npz")


def test_a_file_without_archive_is_refused(tmp_path):
    (tmp_path / "net.npz").write_bytes(b"PK\x03\x04 nothing")
    with pytest.raises(FormatError):
        Mlp.load(tmp_path / "net.npz")


class Chunked:
    """A policy with LeRobot's interface: reset, and one action at a time from its own queue."""

    def __init__(self, chunk=4):
        self.chunk, self.batches = chunk, []

    def reset(self):
        self.queue = []

    def select_action(self, batch):
        self.batches.append(batch)
        if not self.queue:
            self.queue = [batch["observation.state"][0]] * self.chunk
        return self.queue.pop(0)[None]


def test_a_lerobot_policy_acts(easy):
    made = []

    def make(task, seed):
        made.append(Chunked())
        return LeRobotPolicy(made[-1], tensor=np.asarray)

    found = roll_out(easy, make, [0, 1])
    assert len(made) == 2 and not any(rollout.success for rollout in found)
    batch = made[0].batches[0]
    assert batch["observation.state"].shape == (1, 7) and batch["observation.state"].dtype == np.float32
    assert batch["observation.environment_state"].ndim == 2


def test_other_objects_are_no_lerobot_policies():
    with pytest.raises(PolicyError, match="select_action"):
        LeRobotPolicy(SimpleNamespace(reset=lambda: None))


def test_policies_are_found_by_name(tmp_path, monkeypatch):
    (tmp_path / "my_policies.py").write_text("NUMBER = 3\ndef hold(task, seed):\n    return lambda seen: seen.q\n")
    (tmp_path / "my_broken_policies.py").write_text("1 / 0\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    assert imported_policy("my_policies:hold").__name__ == "hold"
    for name, error, words in (
        ("my_policies", SettingError, "factory"),
        ("my_policies:none", UnknownNameError, "hold"),
        ("my_policies:NUMBER", PolicyError, "callable"),
        ("my_broken_policies:x", PolicyError, "ZeroDivisionError"),
        ("no_such_module_here:x", PolicyError, "ModuleNotFoundError"),
    ):
        with pytest.raises(error, match=words):
            imported_policy(name)


def test_invalid_settings_are_refused(easy):
    for wrong in (
        {"period": 0.003},
        {"limit": 0.0},
        {"noise": -1.0},
        {"speed": 0.0},
        {"reach": (0.0, 0.1)},
        {"size": (0, 5)},
    ):
        with pytest.raises(SettingError):
            PolicySettings(**wrong)
    with pytest.raises(UnknownNameError):
        policy_task("tabletop_l1/nothing")
    with pytest.raises(UnknownNameError):
        Acting(lambda seen: seen.q, "thought")
    with pytest.raises(SettingError):
        roll_out(easy, following, [0], [])
    with pytest.raises(UnknownNameError):
        roll_out(easy, following, [0], [RolloutRequest(fault=faults()["noise"](targets=("elbow",)), onset=0.1, seed=0)])
    assert isinstance(easy.straight, gp.Trajectory)


# --- the command -----------------------------------------------------------------------------------------------------

FEW = ["-n", "1", "--scene", "tabletop_l1", "--limit", "0.6", "--horizon", "0.1", "--noise", "0"]


def test_the_command_prints_the_evaluation(capsys):
    words = ["policy", "scripted", "sensor/noise/severe", *FEW, "--recovery", "stop", "--delay", "0.05"]
    assert main([*words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["schema"], found["task"], found["n"]) == ("failbench.policy", "tabletop_l1/green_to_blue", 1)
    assert list(found["by_fault"]) == ["noise/severe"] and "StopOnFailure" in found["recovery"]
    assert found["healthy"]["success"]["mean"] == 0.0  # the horizon is too short to succeed
    assert main(words) == 0
    assert "noise/severe" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["no_such_module_here:x"], "no_such_module_here"),
        (["unheard"], "package.module:factory"),
        (["scripted", "--period", "0.003"], "period"),
        (["scripted", "--camera", "nowhere"], "camera"),
        (["scripted", "--task", "nothing"], "nothing"),
    ],
)
def test_misuse_of_the_command_is_named(capsys, words, said):
    assert main(["policy", *words[:1], "drop/gripper_failure/severe", *FEW, *words[1:]]) == 2
    assert said in capsys.readouterr().err
