"""Harm without failure: mugs turned over by construction, level mugs, hits, lost objects."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from motions import Drop, Weaken, arm, execution, world

import graceful_plan as gp
from failbench import Execution, ObjectLost, RolloutRequest, SimSettings, build_world, execute, run_rollouts
from failbench.recording.healthy import HealthyHarm, whole_execution
from failbench.recording.records import ContactEvent, Rollout
from failbench.recording.score import observed_impact
from graceful_plan.scene.rules.vessel import find_vessel

_LEVEL, _HALF, _OVER = 0.3, 0.8, 1.6
"""Turns of the wrist [rad] that tilt the mug by 17, 46 and 92 degrees."""


def _turned(angle: float) -> gp.Trajectory:
    """Turn the mug of coffee where the task begins, and back, slowly enough that only the tilt matters."""
    task = gp.load_scene("desk").tasks["bring_coffee"]
    tilted = task.start + angle * np.eye(7)[5] * np.sign(task.scene.limits.position[5].mean() - task.start[5])
    path = gp.Path(np.stack([task.start, tilted, task.start]))
    return gp.retime(path, task.scene.limits, task.scene.joints, speed=0.2)


@cache
def _done(angle: float) -> Execution:
    return execute(_turned(angle), world("desk", "bring_coffee", SimSettings(grasp="weld")))


# --- contents ---------------------------------------------------------------------------------------------------------


def test_a_level_mug_does_no_harm() -> None:
    healthy = _done(_LEVEL).healthy
    assert healthy.harmless and healthy.harm == healthy.spilled == 0.0 and str(healthy) == ""
    assert not healthy.events and not healthy.by_entity
    assert healthy.kept is not None and np.ptp(healthy.kept) == 0.0
    assert healthy.to_document() == {"harm": 0.0, "spilled": 0.0, "dropped": False, "by_entity": {}, "events": []}


def test_an_overturned_mug_harms_the_entities_below() -> None:
    done = _done(_OVER)
    healthy, scene = done.healthy, done.world.scene
    assert healthy.spilled > 0.98 and not healthy.dropped
    reached = {event.entity for event in healthy.events}
    assert {"laptop", "desk"} <= reached == set(healthy.by_entity)
    assert {event.striker for event in healthy.events} == {"contents"}
    assert healthy.by_entity == {name: scene.entities[name].severity["contents"] for name in reached}
    assert healthy.harm == sum(healthy.by_entity.values()) == observed_impact(healthy, scene)
    assert all(0.0 < event.time < done.duration + 1.0 for event in healthy.events)
    assert all(0.0 <= healthy.poured[event.entity] <= done.duration for event in healthy.events)
    text = str(healthy)
    assert "99.2 %" in text and "'mug' (hot)" in text and "laptop 20" in text


def test_a_half_tilted_mug_keeps_the_capacity_of_a_cylinder() -> None:
    done = _done(_HALF)
    scene, vessel = done.world.scene, find_vessel(done.world.scene)
    assert vessel is not None and done.healthy.kept is not None
    turned = [scene.data_at(q).body("mug").xmat.reshape(3, 3) for q in done.trajectory.sample(0.02).q]
    tilt = np.arccos(min(float((R_WB @ vessel.axis)[2]) for R_WB in turned))
    # With some tolerance, since the arm lags and the mug is accelerated while it turns.
    expected = 1.0 - float(vessel.capacity(np.array(tilt))) / vessel.volume
    assert done.healthy.spilled == pytest.approx(expected, abs=0.03)
    assert 0.1 < done.healthy.spilled < 0.5
    assert done.healthy.kept[-1] == pytest.approx((1.0 - done.healthy.spilled) * vessel.volume)
    assert 0.0 < done.healthy.harm < _done(_OVER).healthy.harm
    assert set(done.healthy.by_entity) <= set(_done(_OVER).healthy.by_entity)


def test_a_planned_motion_does_no_harm_and_nothing_about_its_failures_changes() -> None:
    healthy = execution("desk", "lift_coffee").healthy
    assert healthy.harmless and healthy.carried == "mug" and healthy.contents == "hot"
    empty_handed = execute(gp.load_scene("desk").tasks["bring_coffee"].start[None], build_world(gp.load_scene("desk")))
    assert empty_handed.healthy.harmless and empty_handed.healthy.kept is None and not empty_handed.healthy.carried


# --- with failures ----------------------------------------------------------------------------------------------------


def test_contents_lost_before_the_onset_are_not_counted_for_the_failure() -> None:
    """The same drop before and after the mug was turned over: each part of the contents spills once."""
    done = _done(_OVER)
    jobs = [RolloutRequest(fault=Drop(), onset=onset, seed=0) for onset in (0.0, done.duration)]
    early, late = run_rollouts(done, jobs, horizon=0.6)
    assert early.spilled > 0.8 and late.spilled == 0.0
    assert done.healthy.kept is not None and done.healthy.kept[-1] < 0.01 * done.healthy.kept[0]
    wet = [{event.entity for event in rollout.events if event.striker == "contents"} for rollout in (early, late)]
    assert wet[0] and not wet[1]
    scene = done.world.scene
    before, after = (whole_execution(rollout, done.healthy) for rollout in (early, late))
    # Nothing had been poured out before the first drop; everything had before the second.
    assert observed_impact(before, scene) == observed_impact(early, scene)
    own = observed_impact(late, scene)
    assert observed_impact(after, scene) == pytest.approx(own + done.healthy.harm)


def test_every_pair_counts_once_in_an_execution() -> None:
    """A harmless fault changes nothing: every pair of the healthy run counts exactly once."""
    done = _done(_OVER)
    nothing = Weaken(degree="minor", duration=0.002)
    middle = float(np.median(list(done.healthy.poured.values())))
    jobs = [RolloutRequest(fault=nothing, onset=onset, seed=0) for onset in (0.0, middle, done.duration)]
    rollouts = run_rollouts(done, jobs, horizon=done.duration + 0.2)
    for rollout in (rollouts[0], rollouts[-1]):
        whole = observed_impact(whole_execution(rollout, done.healthy), done.world.scene)
        assert whole == pytest.approx(done.healthy.harm)
    for rollout in rollouts:
        pairs = [(e.striker, e.entity) for e in whole_execution(rollout, done.healthy).events if not e.secondary]
        assert len(pairs) == len(set(pairs))


def _event(striker: str, entity: str, time: float = 0.1) -> ContactEvent:
    nothing = dict.fromkeys(("peak_force", "impulse", "speed", "energy"), 0.0)
    return ContactEvent(striker=striker, entity=entity, time=time, position=(0.0, 0.0, 0.0), **nothing)


def test_an_execution_by_hand() -> None:
    healthy = HealthyHarm(
        spilled=1.0,
        events=(_event("contents", "laptop"), _event("contents", "desk"), _event("body", "phone", 2.0)),
        landings=(_event("carried", ""),),
        poured={"laptop": 0.5, "desk": 1.5},
    )
    rollout = Rollout(
        job=RolloutRequest(fault=Drop(), onset=1.0, seed=0), onset=1.0, events=(_event("carried", "desk"),)
    )
    whole = whole_execution(rollout, healthy)
    pairs = [(event.striker, event.entity) for event in whole.events]
    assert pairs == [("contents", "laptop"), ("body", "phone"), ("carried", "desk")]
    assert whole.landings == healthy.landings
    again = dataclasses.replace(rollout, events=(_event("contents", "laptop"),))
    assert [event.entity for event in whole_execution(again, healthy).events] == ["phone", "laptop"]


# --- hits and lost objects --------------------------------------------------------------------------------------------


def test_hits_of_a_healthy_robot_are_harm() -> None:
    spec = arm().spec.copy()
    spec.geom("vase").size[1], spec.geom("vase").mass = 0.2, 0.1
    spec.body("vase").pos = -0.05, 0.0, 0.2
    scene = gp.Scene.from_mjcf(
        spec, robot="base", tool="tool", entities={"vase": "glass"}, velocity=[2.0], acceleration=[5.0]
    )
    made = build_world(scene)
    bump = execute(np.array([[1.0], [1.8]]), made)
    assert bump.healthy.by_entity == {"vase": scene.entities["vase"].severity["body"]}
    (event,) = bump.healthy.events
    assert (event.striker, event.entity) == ("body", "vase") and 0.0 < event.time < bump.duration
    assert event.energy > 0.0
    assert "vase: harm 15 " in str(bump.healthy)
    assert execute(np.array([[0.5], [1.0]]), made).healthy.harmless
    # The rollout omits this hit, so the execution's counts.
    (rollout,) = run_rollouts(
        bump, [RolloutRequest(fault=Weaken(degree="minor", duration=0.002), onset=0.0, seed=0)], horizon=1.0
    )
    assert observed_impact(rollout, scene) == 0.0
    assert observed_impact(whole_execution(rollout, bump.healthy), scene) == bump.healthy.harm


@pytest.mark.long
def test_initial_and_allowed_contacts_are_no_harm() -> None:
    task = gp.load_scene("dining_table").tasks["move_bottle"]  # the bottle stands on the table at both ends
    moved = gp.plan(task.start, task.goal, task.scene, w=0.0, iterations=2000, speed=0.5)
    down = execute(moved, world("dining_table", "move_bottle"))
    assert ("carried", "table") in down.baseline and down.healthy.harmless


def test_a_lost_object_is_refused_with_its_harm() -> None:
    bottle = gp.load_scene("dining_table").tasks["pass_bottle"]
    rushed = np.stack([bottle.start, bottle.goal[0]])
    with pytest.raises(ObjectLost, match=r"'bottle'.*SimSettings\(grasp='weld'\)") as lost:
        execute(rushed, world("dining_table", "pass_bottle"))
    healthy = lost.value.healthy
    assert not healthy.harmless and str(healthy) in str(lost.value)
    assert healthy.harm > 0.0
    assert {event.striker for event in healthy.events if not event.secondary} & {"carried", "contents"}
