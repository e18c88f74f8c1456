"""The benchmarks of FailBench: that what they measure is what they say."""

import dataclasses
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from benchmarks.subjects import drop_physics, drop_prediction, failbench_soak, failbench_speed, transcription
from motions import Drop, Shake, execution

import failbench
import graceful_plan as gp
from benchmarks import suite
from failbench import ContactEvent, Job, Rollout, SimSettings

# --- drop physics -----------------------------------------------------------------------------------------------------


def test_distance_from_ballistics_is_zero_on_the_parabola():
    start, velocity, time = np.array([1.0, 2.0, 3.0]), np.array([0.5, -0.25, 0.8]), 0.6
    place = start + velocity * time
    place[2] -= 0.5 * drop_physics.GRAVITY * time**2
    assert drop_physics._off((start, velocity), place) == pytest.approx(0.0, abs=1e-12)
    assert drop_physics._off((start, velocity), place + [0.03, 0.04, 0.0]) == pytest.approx(0.05)


def test_a_clean_drop_flies_on_a_parabola():
    done = execution(settings=SimSettings(grasp="weld"))
    found = [
        drop_physics.flight(done, Job(fault=Drop(), onset=share * done.duration, seed=0)) for share in (0.3, 0.5, 0.7)
    ]
    for flight in found:
        assert flight.fall > 0.01
        assert flight.error < drop_physics.FLIGHT_WITHIN
        assert flight.error_after_touch == flight.error  # nothing of the robot touches it after a clean release


def test_an_object_alone_is_the_object_of_the_scene():
    world = failbench.build_world(suite.scene("desk"))
    for body in world.movable.values():
        alone = drop_physics.alone(world, body)
        geoms = np.flatnonzero(world.model.geom_bodyid == body)
        for name in ("type", "size", "pos", "quat", "condim", "friction", "solref", "solimp"):
            expected = getattr(world.model, f"geom_{name}")[geoms]
            np.testing.assert_allclose(getattr(alone, f"geom_{name}")[1:], expected, err_msg=name)
        assert alone.body_mass[1] == pytest.approx(world.model.body_mass[body])
        np.testing.assert_allclose(alone.body_inertia[1], world.model.body_inertia[body])
        for name in ("timestep", "integrator", "cone", "impratio"):
            assert getattr(alone.opt, name) == getattr(world.model.opt, name)


def test_boxes_slide_as_coulomb_says_and_do_not_bounce():
    boxes = {landing.name: landing for landing in drop_physics.land("tabletop")}
    white, green = boxes["white1"], boxes["green"]
    assert white.alike == 14  # and blue, which differs in severity alone
    assert white.upright.coefficient == pytest.approx(1.0, rel=0.05)
    assert green.upright.coefficient == pytest.approx(2.8, rel=0.05)
    assert max(white.rebound, green.rebound) < 1e-3


def test_the_rebound_of_a_springy_object_is_seen():
    """With damping ratio z, an impact on MuJoCo's spring-damper gives back exp(-pi z / sqrt(1 - z^2)) of the speed."""
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><option timestep="0.0005" integrator="implicitfast"/><worldbody>
        <geom type="plane" size="0 0 1" solref="0.02 0.2" priority="1"/>
        <body><freejoint/><geom type="sphere" size="0.05"/></body></worldbody></mujoco>"""
    )
    height = drop_physics._path(model, np.array([1.0, 0.0, 0.0, 0.0]), lift=0.3)[:, 2]
    lowest = int(np.argmin(height[: len(height) // 4]))
    e = np.sqrt((height[lowest:].max() - 0.05) / 0.3)
    assert e == pytest.approx(np.exp(-np.pi * 0.2 / np.sqrt(1.0 - 0.04)), rel=0.2)


# --- speed ------------------------------------------------------------------------------------------------------------


def test_the_plain_loop_does_the_same_rollouts():
    done = execution()
    jobs = [Job(fault=fault, onset=0.5 * done.duration, seed=3) for fault in (Drop(), Shake(ramp=0.1))]
    rollouts = failbench.run_rollouts(done, jobs, horizon=failbench_speed.HORIZON)
    for anew in (False, True):
        for rollout in rollouts:
            assert failbench_speed.same(rollout, failbench_speed.plain_rollout(done, rollout.job, anew=anew))
    assert not failbench_speed.same(*(dataclasses.replace(rollout, job=jobs[0]) for rollout in rollouts))


def test_time_goes_where_it_is_booked():
    done, timing = execution(), failbench_speed.Timing()
    jobs = [Job(fault=Drop(), onset=0.2, seed=0)]
    failbench_speed._time(timing, 1, lambda: failbench.run_rollouts(done, jobs, horizon=0.2))
    assert set(timing.parts) == {"simulation", "recorder"}
    assert 0.0 < timing.parts["recorder"] and 0.0 < timing.parts["simulation"]
    assert sum(timing.parts.values()) < timing.seconds


# --- soak -------------------------------------------------------------------------------------------------------------


def _rollout(**changed):
    return Rollout(job=Job(fault=Drop(), onset=0.0, seed=0), onset=0.0, **changed)


def test_a_census_counts_what_is_wrong():
    event = ContactEvent(
        striker="body", entity="red1", time=0.1, position=(0.0, 0.0, np.nan), peak_force=1.0, impulse=1.0, speed=1.0,
        energy=1.0,
    )  # fmt: skip
    census = failbench_soak.Census()
    census.add(
        6,
        [
            _rollout(),
            _rollout(events=(event,)),
            _rollout(poses={"red1": np.full(7, np.inf)}),
            _rollout(status="diverged", state=np.zeros(3)),
            _rollout(status="diverged"),
        ],
    )
    assert (census.asked, census.returned, census.not_finite, census.without_state) == (6, 5, 2, 1)
    assert census.diverged == {"drop": 2}
    met = {target.what: target.met for target in failbench_soak._targets(census, [100.0] * 10)}
    assert met == {
        "rollouts returned of those asked for": False,
        "memory growth after the first 608": True,
        "complete rollouts that are not finite": False,
        "diverged rollouts without their state": False,
    }


def test_growth_of_memory_is_judged_by_its_peak():
    memory = [50.0, 90.0, 100.0, 100.0, 130.0, 101.0]
    (target,) = (t for t in failbench_soak._targets(failbench_soak.Census(), memory) if "memory" in t.what)
    assert target.met is False


# --- harm of an executed motion ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def lifted():
    task = suite.task("tabletop/lift_to_goal")
    return task, gp.plan(task.start, task.goal, task.scene, w=0.0, iterations=50).unwrap()


def test_what_a_motion_costs_is_its_duration_and_the_impact_over_it(lifted):
    _, motion = lifted
    assert transcription.timed_cost(motion, lambda q, qd: np.zeros(len(q))) == pytest.approx(motion.duration)
    assert transcription.timed_cost(motion, lambda q, qd: np.full(len(q), 2.0)) == pytest.approx(3.0 * motion.duration)
    # The rate of the first joint adds up to how far it goes.
    went = float(np.abs(np.diff(motion.at(np.linspace(motion.t[0], motion.t[-1], 4000)).q[:, 0])).sum())
    total = transcription.timed_cost(motion, lambda q, qd: np.abs(qd[:, 0]))
    assert total - motion.duration == pytest.approx(went, rel=1e-3)


def test_both_motions_are_played_at_the_pace_that_both_allow(lifted, monkeypatch):
    task, motion = lifted
    played = []

    def validate(played_motion, scene, fault, *, n, threads):
        played.append(played_motion.duration / motion.duration)
        if len(played) == 2:  # the second motion, at full speed
            raise failbench.ExecutionRefused("the object 'red'", 0.5, "slips")
        return SimpleNamespace(observed=SimpleNamespace(mean=float(len(played))))

    monkeypatch.setattr(failbench, "validate", validate)
    found = transcription.observed(task, motion, motion, 10)
    assert played == pytest.approx([1.0, 1.0, 1.0 / 0.7, 1.0 / 0.7])
    assert (found.refused, found.speed, found.impact) == ("", 0.7, (3.0, 4.0))
    assert found.harm == pytest.approx((3.0 * motion.duration / 0.7, 4.0 * motion.duration / 0.7))


def test_motions_that_cannot_be_observed_are_told(lifted, monkeypatch):
    task, motion = lifted

    def validate(*args, **kwargs):
        raise failbench.ExecutionRefused("joint 'panda/joint1'", 0.5, "does not follow")

    monkeypatch.setattr(failbench, "validate", validate)
    slow = transcription.observed(task, motion, motion, 10)
    assert slow.refused == "joint 'panda/joint1' at 0.5"
    cases = [
        transcription.Transcribed(task="a", observed=slow),
        transcription.Transcribed(task="b", observed=transcription.observed(task, motion, None, 10)),
        transcription.Transcribed(
            task="c", observed=transcription.ObservedHarm(speed=1.0, impact=(2.0, 1.0), duration=(1.0, 1.5))
        ),
    ]
    target = transcription._harm_target(cases)
    assert target.met
    assert target.measured == (
        "2.00 to 1.50 s, median ratio 0.750, 1 of 3 tasks; "
        "refused: a: joint 'panda/joint1' at 0.5, b: no motion of least F"
    )
    assert transcription._harm_target(cases[:2]).met is None


# --- drop prediction --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "tall"), [("pass_bottle", True), ("serve_cake", False)])
def test_a_bottle_is_tall_as_long_as_it_stands(name: str, tall: bool) -> None:
    task = gp.load_scene("dining_table").tasks[name]
    assert drop_prediction.is_tall(task.scene, task.start) is tall
    lying = task.start.copy()
    lying[-2] -= np.pi / 2  # the wrist tips it
    assert not drop_prediction.is_tall(task.scene, lying)
