from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import graceful_plan as gp
from failbench.calibrations import failures
from failbench.calibrations.failure_jobs import MotionKind, make_motion
from failbench.calibrations.failures import Failures
from failbench.fault.registry import GripperFailure, PowerLoss, WeakGrip
from failbench.rollouts.execution import execute
from failbench.rollouts.rollout import run_rollouts
from failbench.rollouts.sampling import make_requests
from failbench.simulated.world import build_world
from graceful_plan.exceptions import SettingError

SCENE, TASK = "tabletop_l1", "green_to_blue"


@pytest.fixture(scope="module")
def task() -> gp.Task:
    return gp.load_scene(SCENE).tasks[TASK]


@pytest.fixture(scope="module")
def motion(task: gp.Task) -> gp.Trajectory:
    made = make_motion(task, MotionKind(way="rrt_connect", speed=0.6), 1)
    assert made is not None
    return made


@pytest.fixture(scope="module")
def dropped(task: gp.Task, motion: gp.Trajectory) -> Failures:
    return failures.simulate_failures(motion, task.scene, n=24, seed=3, task=TASK)


def _same(first: Failures, second: Failures) -> bool:
    values = [(getattr(first, f.name), getattr(second, f.name)) for f in dataclasses.fields(Failures)]
    return all(np.array_equal(a, b) for a, b in values)


@pytest.mark.long
def test_events_equal_those_of_the_recorder(task: gp.Task, motion: gp.Trajectory, dropped: Failures) -> None:
    execution = execute(motion, build_world(task.scene))
    jobs = make_requests([GripperFailure(degree="critical")], execution.duration, n=24, seed=3)
    rollouts = run_rollouts(execution, jobs)
    for i, rollout in enumerate(rollouts):
        touched = {(event.striker, event.entity) for event in rollout.events if not event.secondary}
        rows, columns = np.nonzero(dropped.hit[i])
        assert {(dropped.components[r], dropped.entities[c]) for r, c in zip(rows, columns, strict=True)} == touched
        at = motion.at(motion.t[0] + rollout.onset)
        np.testing.assert_allclose(dropped.q[i], at.q, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(dropped.qd[i], at.qd, rtol=1e-12, atol=1e-12)
    assert dropped.hit.any() and not dropped.hit.all()
    assert len(dropped) == 24
    assert (dropped.grasp, dropped.lost) == ("fingers", 0)
    assert dropped.entities == tuple(task.scene.entities)
    assert dropped.faults == ("gripper_failure",)
    assert dropped.dropped.all() and not dropped.spilled.any()


def test_failures_of_one_kind_are_picked_from_many(task: gp.Task, motion: gp.Trajectory) -> None:
    many = failures.simulate_failures(motion, task.scene, [*failures.DROP, PowerLoss(brake="none")], n=16, seed=1)
    falls = many.only(["power_loss", "no such fault"])
    assert len(falls) == 8 and {many.faults[i] for i in falls.fault} == {"power_loss"}
    assert len(many.only([])) == 0
    hit, counted = falls.events(["body", "carried"])
    assert np.array_equal(hit, falls.hit[:, [many.components.index(c) for c in ("body", "carried")]].any(axis=1))
    assert hit.shape == (8, len(many.entities)) and counted.shape == (len(many.entities),)
    assert falls.hit[:, many.components.index("body")].any()


def test_a_weakening_grip_is_predicted_from_the_state_of_the_release(task: gp.Task, motion: gp.Trajectory) -> None:
    opened, slips, sudden = (
        failures.simulate_failures(motion, task.scene, [fault], n=6, seed=5)
        for fault in (GripperFailure(), WeakGrip(ramp=0.3), WeakGrip(ramp=0.0))
    )
    np.testing.assert_allclose(slips.q, opened.ahead[:, 2], atol=1e-9)  # 0.3 s after the onset
    np.testing.assert_allclose(slips.ahead[:, 0], opened.ahead[:, 3], atol=1e-9)
    assert not np.allclose(slips.qd, opened.qd)
    assert np.array_equal(sudden.q, opened.q) and np.array_equal(sudden.qd, opened.qd)


def test_drops_repeat_and_survive_a_file(
    task: gp.Task, motion: gp.Trajectory, dropped: Failures, tmp_path: Path
) -> None:
    again = failures.simulate_failures(motion, task.scene, n=24, seed=3, task=TASK, threads=2)
    assert _same(again, dropped)
    failures.write_failures(tmp_path / "drops.npz", [dropped, dataclasses.replace(again, motion="other")])
    first, second = failures.read_failures(tmp_path / "drops.npz")
    assert _same(first, dropped)
    assert second.motion == "other"


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 no archive", b"not a file of drops"])
def test_other_files_are_refused(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "other.npz").write_bytes(content)
    with pytest.raises(gp.GracefulPlanError, match=r"other\.npz"):
        failures.read_failures(tmp_path / "other.npz")


def test_without_an_object_nothing_is_dropped(motion: gp.Trajectory) -> None:
    with pytest.raises(SettingError, match="gripper"):
        failures.simulate_failures(motion, gp.load_scene(SCENE), n=1)
