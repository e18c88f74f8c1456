"""Grips of hinged fingers, linkages, vacuum cups and magnets: forces by virtual work, breaking loads, the judge."""

from __future__ import annotations

from itertools import pairwise

import mujoco
import numpy as np
import pytest
from grippers import CUP, GOAL, JAW, JAW_DRIVE, START, armed, below, linkage
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import graceful_plan as gp
from failbench import ObjectLost, build_world, execute
from graceful_plan.constraints.grasp import load_facets
from graceful_plan.constraints.scene_constraints import SceneConstraints
from graceful_plan.exceptions import SettingError, UnsupportedError
from graceful_plan.scene.rules.grip import Grip

_INSIDE = 0.115
"""Most that flat facets cut off a ball, as in test_grasp."""
numbers = st.floats(-1.0, 1.0, allow_nan=False)


def held_by_linkage(**changes: object) -> gp.Scene:
    return linkage(carried="block", X_TO=below(0.02), fingers=gp.Opening(), **changes)


def held_by_cup(force: float, radius: float = 0.02, friction: float = 0.5) -> gp.Scene:
    return armed(CUP).attach("block", X_TO=below(0.06), grip=gp.Adhesion(force, radius, friction))


def test_the_force_of_a_linkage_is_that_of_virtual_work() -> None:
    scene = held_by_linkage()
    grip = gp.GraspHolds().grip(scene)
    assert isinstance(grip, Grip)
    driver = float(scene.home_qpos[scene.model.joint("g/left_driver").qposadr[0]])
    gaps = []
    for angle in (driver - 0.01, driver + 0.01):
        turned = linkage(fingers=angle)
        data, pads = turned.data_at([0.0]), [turned.model.geom(f"g/{side}_pad").id for side in ("left", "right")]
        gaps.append(mujoco.mj_geomDistance(turned.model, data, *pads, 1.0, None))
    # A tendon of half of both drivers' angles with 5 N m does the work 5 N m dq, and each pad F/2 times its way.
    assert grip.force / 2.0 * (gaps[0] - gaps[1]) == pytest.approx(5.0 * 0.02, rel=0.05)
    assert grip.half[0] == pytest.approx(0.02, abs=5e-4)
    assert np.abs(grip.axes[0]) == pytest.approx([0.0, 1.0, 0.0], abs=1e-6)


def test_pads_of_a_linkage_press_as_much_in_mujoco() -> None:
    scene = held_by_linkage()
    world = build_world(scene)
    data = mujoco.MjData(world.model)
    mujoco.mj_setState(world.model, data, execute([START, [-0.79]], world).states[0], 16383)
    data.ctrl[world.robot.gripper_actuators] = world.robot.grip_closed
    mujoco.mj_forward(world.model, data)
    pressed, wrench = 0.0, np.zeros(6)
    for k, contact in enumerate(data.contact[: data.ncon]):
        if world.carried_body in world.model.geom_bodyid[[contact.geom1, contact.geom2]]:
            mujoco.mj_contactForce(world.model, data, k, wrench)
            pressed += wrench[0]
    assert pressed == pytest.approx(gp.GraspHolds().grip(scene).force, rel=0.1)


def test_one_jaw_may_be_fixed() -> None:
    scene = armed(JAW, drive=JAW_DRIVE, carried="block", X_TO=below(0.0) @ _shifted(0.005), fingers=gp.Opening())
    grip = gp.GraspHolds().grip(scene)
    assert isinstance(grip, Grip)
    assert grip.force == pytest.approx(2.0 * 4.0 / 0.085, rel=0.3)  # 4 N m on a lever of 8 to 10 cm


def _shifted(y: float) -> np.ndarray:
    X = np.eye(4)
    X[1, 3] = y
    return X


def test_distances_tell_why_a_grasp_is_none() -> None:
    far = linkage(carried="block", X_TO=below(0.02))  # the fingers are open
    with pytest.raises(UnsupportedError, match=r"no finger touches 'block' \(17 mm away\).*Opening"):
        gp.GraspHolds().grip(far)
    with pytest.raises(UnsupportedError, match="no fingers that move"):
        gp.GraspHolds().grip(armed(CUP, carried="block", X_TO=below(0.06)))


# --- adhesion ---------------------------------------------------------------------------------------------------------


def exact_load(scene: gp.Scene, felt: np.ndarray) -> float:
    """Return the load on a disc at the top of the block relative to what breaks the grip."""
    grip = scene.notes.held.grip
    force, lever = 0.3 * felt, np.array([0.0, 0.0, -0.06])
    moment = np.cross(lever, force)
    peels = np.hypot(moment[0], moment[1]) / grip.radius
    slips = np.hypot(np.hypot(force[0], force[1]) / grip.friction, moment[2] / (grip.friction * grip.radius * 2 / 3))
    return max(force[2] + max(peels, slips), 0.0) / grip.force


@settings(max_examples=40)
@given(numbers, numbers, numbers)
def test_facets_of_a_disc_are_inside_of_its_limits_and_near_them(x: float, y: float, z: float) -> None:
    scene, direction = held_by_cup(20.0), np.array([x, y, z])
    assume(np.linalg.norm(direction) > 0.1 and exact_load(scene, direction) > 1e-3)
    facets, room = load_facets(gp.GraspHolds().grip(scene))
    most = 1.0 / (facets @ direction / room).max()
    assert exact_load(scene, most * direction) <= 1.0 + 1e-9
    # Facets cut off at most a share of what peels or slips, and nothing of what pulls.
    assert exact_load(scene, (1.0 + 1e-9) * most / (1.0 - _INSIDE) * direction) >= 1.0 - abs(0.3 * most * z) / 20.0


def test_pressing_an_object_to_the_disc_never_breaks_the_grip() -> None:
    facets, room = load_facets(gp.GraspHolds().grip(held_by_cup(20.0)))
    assert (facets @ [0.0, 0.0, -1e6] / room).max() <= 1e-6


def timed(scene: gp.Scene, constraints: list[gp.GraspHolds]) -> gp.Trajectory:
    return SceneConstraints(scene, constraints).retimed(gp.Path(np.array([START, GOAL])), deviation=0.05)


def test_a_weaker_disc_never_makes_a_motion_faster() -> None:
    durations = [timed(held_by_cup(force), [gp.GraspHolds()]).duration for force in (60.0, 12.0, 7.0, 5.0)]
    assert all(a <= b * (1.0 + 1e-9) for a, b in pairwise(durations))
    assert durations[-1] > 1.1 * durations[0]


def test_the_judge_finds_the_load_that_timing_allows() -> None:
    scene = held_by_cup(5.0)
    constraint = gp.GraspHolds()
    kept, rushed = timed(scene, [constraint]), timed(scene, [])
    checks = [gp.verify(motion, scene, constraints=[constraint]).checks["grasp_holds"] for motion in (kept, rushed)]
    assert checks[0].passed and checks[0].worst == pytest.approx(0.9, abs=0.15)
    assert not checks[1].passed


def test_mujoco_loses_what_breaks_the_grip_and_keeps_what_does_not() -> None:
    scene = held_by_cup(4.5)
    assert execute(timed(scene, [gp.GraspHolds()]), build_world(scene)).slip < 5e-3
    with pytest.raises(ObjectLost, match="'block'"):
        execute(timed(scene, []), build_world(scene))


def test_an_object_too_heavy_for_the_disc_is_no_start() -> None:
    result = gp.plan(START, GOAL, held_by_cup(3.0), constraints=[gp.GraspHolds()])
    assert result.status is gp.PlanStatus.INVALID_START
    assert "of what the grip holds" in result.detail


@pytest.mark.parametrize("name", ["force", "radius", "friction"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_adhesion_has_positive_numbers(name: str, value: float) -> None:
    with pytest.raises(SettingError, match=name):
        gp.Adhesion(**({"force": 10.0, "radius": 0.02} | {name: value}))
