"""Driving bases under controllers, healthy and failing."""

import numpy as np
import pytest

import failbench as fb
import graceful_plan as gp
from failbench.mobile.driving import drive_base
from failbench.rollouts.execution import execute
from failbench.simulated.world import build_world
from graceful_plan.exceptions import SettingError
from graceful_plan.mobile.control.pure_pursuit import PurePursuit
from jackals import jackal


@pytest.mark.long
def test_a_planned_motion_is_driven():
    scene = jackal((1.0, 0.3))
    result = gp.plan([-3.0, 0.0, 0.0], gp.BasePose(3.0, 0.0, 0.0), scene, iterations=3000)
    driven = drive_base(result.trajectory, scene)
    assert not driven.touched and driven.error.max() < 0.08
    np.testing.assert_allclose(driven.pose[-1], [3.0, 0.0, 0.0], atol=0.03)


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "task", "goal", "error"),
    [("apartment", "bring_parcel", (6.0, 1.5), 0.08), ("hallway", "carry_bottle", (4.0, -0.6), 0.08)],
)
def test_bundled_scenes_are_driven_in(name, task, goal, error):
    """A Jackal away from stairs, and a Fetch past a plant with its arm extended, where floors are boxes."""
    found = gp.load_scene(name).tasks[task]
    result = gp.plan(found.start, gp.BasePose(*goal), found.world, w=0.0, iterations=3000)
    driven = drive_base(result.trajectory, found.world)
    assert not driven.touched and driven.error.max() < error


@pytest.fixture(scope="module")
def scene():
    return jackal((1.0, 0.5))


@pytest.fixture(scope="module")
def motion(scene):
    return gp.plan([-2.0, 0.0, 0.0], gp.BasePose(2.0, 0.0, 0.0), scene, w=0.0, iterations=1000).unwrap()


def test_a_controlled_drive_sets_its_own_duration(scene, motion):
    """At half the greatest speed the motion takes longer; accelerating takes the same time in both."""
    slow = PurePursuit(speed=0.5 * float(np.abs(motion.qd[:, 0]).max()))
    execution = execute(motion, build_world(scene), controller=slow)
    assert 1.25 < execution.duration / motion.duration < 3.0
    assert np.linalg.norm(execution.trajectory.q[-1, :2] - [2.0, 0.0]) < 0.08
    assert np.abs(execution.trajectory.qd[:, 0]).max() < 0.55 * np.abs(motion.qd[:, 0]).max() + 0.05
    assert len(execution.command) == len(execution.measured) and execution.healthy.harmless


def test_the_same_controller_by_default_is_bit_by_bit_the_same(scene, motion):
    from failbench.mobile.slipping import fitted_tracking

    world = build_world(scene)
    given, default = execute(motion, world, controller=fitted_tracking(scene)), execute(motion, world)
    np.testing.assert_array_equal(given.command, default.command)


@pytest.mark.long
def test_a_cautious_controller_does_less_harm():
    """Without power the base rolls into the child behind the goal, unless the controller approached slowly."""
    scene, kind = jackal((2.85, 0.0)), fb.faults()["complete_shutdown"]
    motion = gp.plan([-2.0, 0.0, 0.0], gp.BasePose(2.0, 0.0, 0.0), scene, w=0.0, iterations=1000).unwrap()
    fault = kind(degree="critical", when=fb.Uniform(0.5, 0.7))
    blind, window = (
        drive_base(motion, scene, controller, faults=fault, n=32, horizon=2.0)
        for controller in (PurePursuit(), gp.DWA().bind(scene))
    )
    for driven in (blind, window):
        report = driven.failures
        assert driven.arrived and not driven.touched and driven.chosen[0] > 20
        assert report.n == 32 and report.diverged == 0 and set(report.by_fault) == {"complete_shutdown/critical"}
        assert report.healthy.harmless and report.duration > 0.95 * motion.duration
    assert 1.0 < blind.failures.observed.mean <= scene.entities["child0"].severity["body"]
    assert window.failures.observed.mean < 0.4 * blind.failures.observed.mean
    assert window.failures.predicted < 0.1 * blind.failures.predicted
    again = fb.validate(motion, scene, fault, n=32, horizon=2.0, threads=2, controller=PurePursuit())
    assert again.observed == blind.failures.observed  # independent of the number of threads


def test_places_on_the_floor_are_enough(scene):
    path = np.array([[-2.0, 0.0], [0.0, -0.4], [2.0, 0.0]])
    shutdown = fb.faults()["complete_shutdown"](degree="critical")
    driven = drive_base(path, scene, PurePursuit(speed=0.8), faults=shutdown, n=2, horizon=0.5)
    assert driven.arrived and driven.failures.n == 2 and driven.failures.duration > 4.0 / 0.8


def test_invalid_arguments_are_refused(scene, motion):
    tabletop = gp.load_scene("tabletop").tasks["lift_to_goal"]
    with pytest.raises(SettingError, match="does not drive"):
        execute(np.stack([tabletop.start, tabletop.goal[0]]), build_world(tabletop.scene), controller=PurePursuit())
    with pytest.raises(SettingError, match="times"):
        drive_base(np.array([[0.0, 0.0], [1.0, 0.0]]), scene)
    with pytest.raises(SettingError, match="start"):
        drive_base(motion, scene, faults="power/*/severe", start=np.zeros(3))
    with pytest.raises(fb.ExecutionRefused, match="arrived"):
        drive_base(motion, scene, PurePursuit(speed=0.2), faults="power/*/severe", seconds=1.0)


def test_a_skid_steer_turns_about_its_origin():
    """The centre of the wheels used to be the pivot; a turn in place then moved the base by 40 mm."""
    scene = jackal()
    result = gp.plan([0.0, 0.0, 0.0], [0.0, 0.0, 2.5], scene, w=0.0, iterations=100)
    driven = drive_base(result.trajectory, scene)
    assert np.abs(result.trajectory.q[:, :2]).max() < 1e-6 and driven.error.max() < 0.02
