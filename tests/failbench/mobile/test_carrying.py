"""Objects on a base ride along, and fall if the base stops too hard."""

import mujoco
import numpy as np
import pytest

import failbench as fb
import graceful_plan as gp
from failbench.recording.records import RolloutRequest
from failbench.rollouts.execution import execute
from failbench.rollouts.rollout import run_rollouts
from failbench.simulated.world import build_world
from graceful_plan.scene.loading.robot_models import robot_file
from graceful_plan.scene.mobile.known_bases import known_base

GRIP = 0.6
"""Friction coefficient of the tyres, the deceleration of locked wheels over gravity."""


def laden(half_width, half_height):
    """A Jackal on a wide floor with a box on its deck, and a vase ahead of it."""
    size = f"{half_width} {half_width} {half_height}"
    world = (
        '<mujoco><worldbody><geom name="floor" type="plane" size="50 50 .1"/>'
        f'<body name="load" pos="0 5 {half_height}"><freejoint/><geom type="box" size="{size}" mass=".5"/></body>'
        '<body name="vase" pos="4 1.5 .2"><geom type="cylinder" size=".1 .2"/></body></worldbody></mujoco>'
    )
    spec = mujoco.MjSpec.from_string(world)
    spec.attach(mujoco.MjSpec.from_file(str(robot_file("jackal"))), prefix="jackal/", frame=spec.worldbody.add_frame())
    scene = gp.Scene.from_mjcf(
        spec,
        robot="jackal/",
        tool="jackal/deck",
        base=known_base("jackal"),
        body_class="base_coast",
        entities={"vase": "heirloom", "load": "robust"},
        allowed_contacts=[gp.AllowedContact("jackal/base", "floor")],
    )
    X_TO = np.eye(4)
    X_TO[2, 3] = half_height + 0.001
    return scene.attach("load", X_TO=X_TO, object_class="heavy")


def straight(scene):
    """Four metres ahead at up to 1 m/s."""
    return gp.plan([0.0, 0.0, 0.0], gp.BasePose(4.0, 0.0, 0.0), scene, w=0.0, iterations=50, speed=0.5, constraints=())


@pytest.mark.parametrize(("half_width", "falls"), [(0.03, True), (0.12, False)])
def test_an_object_on_a_base_tips_over_if_the_base_brakes_hard(half_width, falls):
    """A block tips if deceleration over gravity, 0.6 here, exceeds width over height: 0.25 or 1."""
    half_height = 0.12
    scene = laden(half_width, half_height)
    execution = execute(straight(scene), build_world(scene))
    assert execution.healthy.harmless and execution.slip < 0.01  # 1.5 m/s2 tips neither
    assert (half_width / half_height < GRIP) == falls
    locked = fb.faults()["stuck_position"](degree="critical", targets=("all",))
    job = RolloutRequest(fault=locked, onset=0.45 * execution.duration, seed=0)
    (rollout,) = run_rollouts(execution, [job], horizon=1.5)
    _, x, y, _ = rollout.poses["carried"][:4]
    upright = 1.0 - 2.0 * (x**2 + y**2)  # z component of its axis
    assert rollout.status == "completed" and rollout.dropped == falls
    assert abs(upright) < 0.2 if falls else upright > 0.95  # it lies on its side


@pytest.mark.long
def test_tea_on_a_jackal_spills_only_in_failures():
    task = gp.load_scene("apartment").tasks["serve_tea"]
    result = gp.plan(task.start, task.goal, task.scene, iterations=3000)
    assert result.status is gp.PlanStatus.SOLVED and result.verdict.checks["contents"].passed
    locked = fb.faults()["stuck_position"](degree="critical", targets=("all",))
    report = fb.validate(result, task.scene, locked, n=12, horizon=2.0, threads=1)
    assert report.healthy.harmless and report.diverged == 0
    assert report.spilled.mean > 0.2 and report.dropped.mean > 0.0  # some runs with locked wheels lose the cup
    assert report.predicted > 0.0
