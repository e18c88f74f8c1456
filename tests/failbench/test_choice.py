"""Choice among motions by simulated failures."""

from __future__ import annotations

import numpy as np
import pytest

import failbench
import graceful_plan as gp
from failbench.fault.registry import GripperFailure
from failbench.surroundings.registry import PersonWalksIn
from graceful_plan.exceptions import SettingError

DROPS = [GripperFailure()]
HORIZON = 0.5
"""Time after each failure [s]; within it, a dropped block reaches the table."""


@pytest.fixture(scope="module")
def motions() -> tuple[gp.Scene, list[gp.Trajectory]]:
    """A graceful motion, one with w = 0, and the latter four times as slow, which fails four times as often."""
    task = gp.load_scene("tabletop").tasks["green_to_blue"]
    fast, graceful = (
        gp.plan(task.start, task.goal, task.scene, w=w, iterations=200, speed=0.6).unwrap() for w in (0.0, 1.0)
    )
    slow = gp.retime(fast.path, task.scene.limits, task.scene.joints, speed=0.15)
    return task.scene, [slow, fast, graceful]


def test_the_motion_with_less_harm_is_chosen(motions):
    scene, three = motions
    found = failbench.choose(three, scene, DROPS, seconds=600.0, rounds=3, horizon=HORIZON, threads=1)
    assert found.best == 2
    assert found.refused == {}
    means = [estimate.mean for estimate in found.harm]
    assert means[2] == min(means)
    assert found.n[0] == 16 < found.n[2]  # the worst of three is dropped after the first round


def test_the_same_seed_gives_the_same_choice(motions):
    scene, three = motions
    first, second = (
        failbench.choose(three[1:], scene, DROPS, seconds=600.0, rounds=1, horizon=HORIZON, threads=t) for t in (1, 2)
    )
    assert (first.best, first.harm, first.n, first.sure) == (second.best, second.harm, second.n, second.sure)


def test_estimates_are_those_of_a_validation(motions):
    scene, three = motions
    found = failbench.choose(three[1:2], scene, DROPS, seconds=0.0, seed=5, horizon=HORIZON, threads=1)
    report = failbench.validate(three[1], scene, DROPS, n=16, seed=5, horizon=HORIZON, threads=1)
    assert found.sure and found.n == (16,)
    assert found.harm[0].mean == pytest.approx(report.observed_per_task.mean, rel=1e-9)


def test_equal_motions_are_never_surely_different(motions):
    scene, three = motions
    found = failbench.choose([three[1], three[1]], scene, DROPS, seconds=600.0, rounds=1, horizon=HORIZON, threads=1)
    assert not found.sure and found.harm[0] == found.harm[1]


def test_motions_that_cannot_be_executed_are_left_out(motions):
    scene, three = motions
    t = np.array([0.0, 0.05])
    wild = gp.Trajectory(t, three[1].q[[0, -1]], np.zeros((2, 7)), np.zeros((2, 7)), scene.joints)
    found = failbench.choose([wild, three[1]], scene, DROPS, seconds=0.0, horizon=HORIZON, threads=1)
    assert found.best == 1 and found.sure and found.harm[0] is None and set(found.refused) == {0}
    assert "motion 0" in str(found)
    with pytest.raises(failbench.ExecutionRefused):
        failbench.choose([wild], scene, DROPS)


def test_people_who_walk_in_are_simulated(motions):
    scene, three = motions
    found = failbench.choose(three[1:2], scene, PersonWalksIn(), seconds=0.0, rounds=1, horizon=HORIZON, threads=1)
    report = failbench.validate(three[1], scene, PersonWalksIn(), n=16, horizon=HORIZON, threads=1)
    assert found.harm[0].mean == pytest.approx(report.observed_per_task.mean, rel=1e-9)


def test_misuse_is_refused(motions):
    scene, three = motions
    for motions_, settings in (([], {}), (three, {"seconds": -1.0}), (three, {"rounds": 0}), (three, {"rate": np.nan})):
        with pytest.raises(SettingError):
            failbench.choose(motions_, scene, DROPS, **settings)


def test_the_candidates_of_a_result_race(motions):
    scene = motions[0]
    task = gp.load_scene("tabletop").tasks["green_to_blue"]
    result = gp.plan(task.start, task.goal, task.scene, iterations=200, speed=0.6, candidates=3)
    assert len(result.candidates) > 1
    settings = {"seconds": 600.0, "rounds": 1, "horizon": HORIZON, "threads": 1}
    found = failbench.choose(result, scene, DROPS, **settings)
    same = failbench.choose(result.candidates, scene, DROPS, **settings)
    assert (found.best, found.harm, found.n) == (same.best, same.harm, same.n)
    alone = gp.plan(task.start, task.goal, task.scene, w=0.0, iterations=10)
    single = failbench.choose(alone, scene, DROPS, **settings)
    assert single.best == 0 and single.sure


def test_a_failed_plan_is_refused(motions):
    failed = gp.plan(np.full(7, 9.0), "home", motions[0], iterations=10)
    with pytest.raises(gp.PlanningFailed):
        failbench.choose(failed, motions[0], DROPS)
