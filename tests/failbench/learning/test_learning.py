"""Learning from generated scenes: the scenes, the data on drops, the fit, and the command."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.optimize import check_grad

from failbench import cli
from failbench.calibrations.failure_jobs import run_job
from failbench.calibrations.failures import Failures, write_failures
from failbench.learning import rollouts
from failbench.learning import training as fits
from failbench.learning.generated import generated_scene, scene_names
from failbench.learning.learn import learn
from failbench.learning.rollouts import DropData, Pairs, bundled_jobs, drop_jobs, pairs_of, scene_of
from failbench.learning.training import Training, logits, probability, train
from graceful_plan import FailureMixture
from graceful_plan.costs.models.drop.network import LOOKS, STATE_FEATURES, DropNetwork, fade
from graceful_plan.costs.models.drop.tables import SHAPE_CLASSES
from graceful_plan.exceptions import SettingError, UnknownNameError

Array = np.ndarray

SMALL = Training(hidden=4, decays=(1e-4,), iterations=60)


def made_up(n: int = 600, *, factor: float = 1.5, seed: int = 0) -> Pairs:
    """Return pairs of surfaces whose odds are off by e^factor on one side of the first input."""
    rng = np.random.default_rng(seed)
    plain = rng.uniform(0.02, 0.9, size=2 * n)
    told = rng.normal(size=(2 * n, len(STATE_FEATURES)))
    logit = np.log(plain / (1.0 - plain)) + fade(plain) * factor * np.tanh(3.0 * told[:, 0])
    most = np.maximum.reduceat(logit, np.arange(0, 2 * n, 2))
    return Pairs(
        told=told,
        looks=rng.uniform(size=(2 * n, len(LOOKS))),
        shape=np.eye(len(SHAPE_CLASSES))[rng.integers(len(SHAPE_CLASSES), size=2 * n)],
        plain=plain,
        first=np.arange(0, 2 * n, 2),
        hit=rng.uniform(size=n) < 1.0 / (1.0 + np.exp(-most)),
        chooses=np.arange(n) % 4 == 0,
        motion=np.arange(n),
    )


# --- scenes -----------------------------------------------------------------------------------------------------------


def test_scenes_match_their_names() -> None:
    first = generated_scene("generated_3")
    generated_scene.cache_clear()
    again, other = generated_scene("generated_3"), generated_scene("generated_4")
    assert first.spec.to_xml() == again.spec.to_xml() != other.spec.to_xml()
    for name in first.tasks:
        np.testing.assert_array_equal(first.tasks[name].start, again.tasks[name].start)
    assert scene_names(2, first=5) == ["generated_5", "generated_6"]


@pytest.mark.parametrize("name", ["generated_", "generated_-1", "generated_1.5", "desk", "generated_1234567890"])
def test_other_names_are_refused(name: str) -> None:
    with pytest.raises(UnknownNameError, match="generated"):
        generated_scene(name)


@pytest.mark.parametrize("name", scene_names(4, first=900))
def test_things_stand_by_themselves(name: str) -> None:
    scene = generated_scene(name)
    data = mujoco.MjData(scene.model)
    data.qpos[:] = scene.home_qpos
    mujoco.mj_forward(scene.model, data)
    bodies = scene.model.geom_bodyid[data.contact.geom[: data.ncon]]
    others = ~np.isin(bodies, list(scene.robot_bodies)).any(axis=1)
    assert np.all(data.contact.dist[: data.ncon][others] > -1e-3)
    assert len(scene.entities) > 4 and len(scene.tasks) == 2
    for task in scene.tasks.values():
        assert np.linalg.norm(task.goal[0] - task.start) > 0.5


# --- data on drops ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def drops() -> list[Failures]:
    data = DropData(scenes=2, rollouts=84)
    found = [run_job(job) for job in (drop_jobs(data)[0], bundled_jobs(data)[0])]
    return [part for part in found if isinstance(part, Failures)]


@pytest.mark.long
def test_pairs_equal_those_of_the_drop_model(drops: list[Failures]) -> None:
    pairs = pairs_of(drops)
    assert len(pairs) > 10 and pairs.hit.any() and not pairs.hit.all()
    np.testing.assert_array_equal(pairs.chooses, pairs.motion == 1)
    assert np.diff(np.append(pairs.first, len(pairs.plain))).min() >= 1
    found, i = probability(None, pairs), 0
    for part in drops:
        scene = scene_of(part.scene).tasks[part.task].scene
        P = FailureMixture().probability(part.states(scene))[:, list(scene.components).index("carried")]
        hit, counted = part.events(["carried"])
        chosen = (P > 1e-4) & counted
        n = int(chosen.sum())
        np.testing.assert_allclose(np.clip(P[chosen], None, 1.0 - 1e-6), found[i : i + n], rtol=1e-6)
        np.testing.assert_array_equal(hit[chosen], pairs.hit[i : i + n])
        i += n
    assert i == len(pairs)


def test_some_of_the_pairs_are_the_same_pairs() -> None:
    pairs = made_up(50)
    chosen = np.arange(50) % 3 == 1
    part = pairs.of(chosen)
    np.testing.assert_array_equal(logits(None, part)[0], logits(None, pairs)[0][chosen])
    np.testing.assert_array_equal(part.hit, pairs.hit[chosen])
    assert len(pairs.of(np.zeros(50, dtype=bool))) == 0


def test_jobs_do_not_depend_on_processes() -> None:
    one, two = (drop_jobs(DropData(scenes=2, rollouts=40, processes=n)) for n in (1, 2))
    assert one == two
    assert sum(job.n for job in one) == pytest.approx(40, abs=len(one))
    assert {job.seed for job in one}.isdisjoint(
        {job.seed for job in drop_jobs(DropData(scenes=2, rollouts=40, seed=1))}
    )


@pytest.mark.parametrize("wrong", [{"scenes": 1}, {"rollouts": 0}, {"seed": -1}])
def test_sizes_are_checked(wrong: dict[str, float]) -> None:
    with pytest.raises(SettingError, match=next(iter(wrong))):
        DropData(**wrong)  # pyright: ignore[reportArgumentType]


# --- the fit ----------------------------------------------------------------------------------------------------------


def test_the_gradient_of_the_likelihood() -> None:
    pairs = made_up(40)
    of = partial(fits._objective, pairs=pairs, told=pairs.told, training=SMALL, decay=0.01)
    rng = np.random.default_rng(0)
    size = sum(int(np.prod(shape)) for shape in fits._sizes(4).values())
    for _ in range(3):
        x = rng.normal(scale=0.5, size=size)
        assert check_grad(lambda z: of(z)[0], lambda z: of(z)[1], x) < 1e-5


def test_the_fit_learns_a_known_error() -> None:
    found = train(made_up(4000), replace(SMALL, iterations=120))
    fresh = made_up(4000, seed=1)
    truth = made_up(4000, seed=1).hit
    plain, better = (np.mean((probability(x, fresh) - truth) ** 2) for x in (None, found.network))
    assert better < 0.97 * plain
    assert found.corrected.log_loss < found.plain.log_loss
    assert 0.0 < found.network.bound <= 1.5 * SMALL.bound


def test_where_there_is_nothing_to_learn_little_is_changed() -> None:
    found = train(made_up(1500, factor=0.0), SMALL)
    fresh = made_up(1500, factor=0.0, seed=1)
    assert np.abs(probability(found.network, fresh) - probability(None, fresh)).mean() < 0.05
    assert found.corrected.log_loss <= found.plain.log_loss + 1e-9  # a scale of zero is among the candidates


def test_same_seed_same_weights() -> None:
    pairs = made_up(300)
    one, two, other = (train(pairs, replace(SMALL, seed=seed)).network for seed in (0, 0, 1))
    np.testing.assert_array_equal(one.told, two.told)
    assert not np.array_equal(one.told, other.told)


@pytest.mark.parametrize("chooses", [True, False])
def test_there_has_to_be_something_to_fit_to_and_to_choose_by(chooses: bool) -> None:
    with pytest.raises(SettingError, match="generated"):
        train(replace(made_up(30), chooses=np.full(30, chooses)), SMALL)


@pytest.mark.parametrize("wrong", [{"hidden": 0}, {"hidden": 33}, {"bound": 0.0}, {"decays": ()}, {"decays": (-1.0,)}])
def test_settings_are_checked(wrong: dict[str, object]) -> None:
    with pytest.raises(SettingError, match=next(iter(wrong))):
        Training(**wrong)  # pyright: ignore[reportArgumentType]


# --- the command ------------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_the_command_learns(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kept, first, second = tmp_path / "drops.npz", tmp_path / "a.npz", tmp_path / "b.npz"
    data = DropData(scenes=2, rollouts=28)
    jobs = (drop_jobs(data)[0], drop_jobs(data)[-1], bundled_jobs(data)[0])
    write_failures(kept, [part for part in map(run_job, jobs) if isinstance(part, Failures)])
    size = ["--drops", str(kept), "--workers", "1"]
    assert cli.main(["learn", "--output", str(first), *size]) == 0
    assert "network" in capsys.readouterr().out
    assert cli.main(["learn", "--output", str(second), *size, "--json"]) == 0
    one, two = DropNetwork.read(first), DropNetwork.read(second)
    np.testing.assert_array_equal(one.told, two.told)
    assert one.about["drops"] == 6 and one.about["scenes"] == 3 and one.about["drops_from"] == "drops.npz"
    assert one.about["bundled_scenes"] == 1


@pytest.mark.long
def test_drops_are_simulated_if_there_are_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rollouts, "bundled_jobs", lambda data: bundled_jobs(data)[:2])
    found = learn(DropData(scenes=2, rollouts=14), SMALL, kept=tmp_path / "drops.npz")
    assert found.network.about["data"] == {"scenes": 2, "rollouts": 14, "seed": 0}
    again = learn(training=SMALL, kept=tmp_path / "drops.npz")
    np.testing.assert_array_equal(again.network.told, found.network.told)


def test_the_command_refuses_other_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["learn", "--output", str(tmp_path / "net.pkl")]) == 2
    assert ".npz" in capsys.readouterr().err
