"""The load on a grasp: facets against the ellipsoid, retiming, gradients, plans, and MuJoCo's fingers."""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import mujoco
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import graceful_plan as gp
from failbench import ExecutionRefused, SimSettings, build_world, execute
from failbench.simulated.states import STATE
from graceful_plan.constraints.grasp import load_facets
from graceful_plan.constraints.scene_constraints import SceneConstraints, default_constraints
from graceful_plan.constraints.specific_force import SpecificForceCone
from graceful_plan.core import _native
from graceful_plan.costs.objective import Objective, search_paces
from graceful_plan.exceptions import SettingError, UnsupportedError
from graceful_plan.planners.native import native_space
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.scene.rules.grip import find_grip
from sizes import first_quick

CARRIED = {
    "serve_tea": "dining_table",
    "pass_bottle": "dining_table",
    "serve_stew": "dining_table",
    "serve_cake": "dining_table",
    "put_book_away": "desk",
    "bring_coffee": "desk",
    "green_to_blue": "tabletop",
}
_INSIDE = 0.115
"""Most that flat facets cut off an ellipsoid: 1 minus the radius of the ball inside the 26 facets of a cube's
directions."""
numbers = st.floats(-1.0, 1.0, allow_nan=False)


@cache
def task_of(name):
    return gp.load_scene(CARRIED[name]).tasks[name]


def exact_load(grip, felt):
    """Return the used share of the pads' capacity, from forces and moments at each pad."""
    force = grip.mass * np.asarray(felt)
    moment = np.cross(grip.p_GC, force)
    n, a, b = grip.axes
    h = grip.half[0]
    loads = [0.0]
    couple = np.zeros(3)
    for axis, other, pressed, rim in ((a, b, grip.pressed[0], grip.half[2]), (b, a, grip.pressed[1], grip.half[1])):
        about = float(moment @ axis)
        if pressed:
            loads.append(abs(about) / (grip.force * rim))
        else:
            # Opposite forces c at +-h n give the moment 2 h n x c.
            direction = other * np.sign(np.cross(n, other) @ axis)
            couple = couple + about / (2.0 * h) * direction
    for side in (1.0, -1.0):
        tangential = 0.5 * (force - (force @ n) * n) + side * couple
        torsion = 0.5 * float(moment @ n)
        presses = 0.5 * grip.force + 0.5 * side * float(force @ n)
        if presses <= 0.0:
            return np.inf
        used = np.hypot(np.linalg.norm(tangential) / grip.friction, torsion / grip.torsion)
        loads.append(used / presses)
    return max(loads)


@pytest.mark.parametrize("name", CARRIED)
@settings(max_examples=15)
@given(numbers, numbers, numbers)
def test_facets_are_inside_of_the_ellipsoid_and_near_it(name, x, y, z):
    direction = np.array([x, y, z])
    assume(np.linalg.norm(direction) > 0.1)
    grip = gp.GraspHolds().grip(task_of(name).scene)
    facets, room = load_facets(grip)
    most = 1.0 / (facets @ direction / room).max()  # where a ray leaves the facets
    assert exact_load(grip, most * direction) <= 1.0 + 1e-9
    assert exact_load(grip, (1.0 + 1e-9) * most / (1.0 - _INSIDE) * direction) >= 1.0


@pytest.mark.parametrize("name", CARRIED)
def test_at_rest_the_load_is_weight(name):
    task = task_of(name)
    holds = gp.GraspHolds(share=1.0)
    grip = holds.grip(task.scene)
    ends = np.vstack([task.start, task.goal])
    batch = gp.StateBatch(task.scene, ends)
    loads = holds.residual(batch) + 0.95  # the residual is zero at the limit
    for load, pose in zip(loads, batch.object_poses, strict=True):
        exact = exact_load(grip, 9.81 * pose[2, :3])
        assert (1.0 - 1e-9) * exact <= load <= exact / (1.0 - _INSIDE)


@pytest.mark.parametrize("name", ["serve_tea", "put_book_away"])
def test_cones_of_the_core_equal_the_residual(name):
    scene = task_of(name).scene
    holds = gp.GraspHolds(force=20.0, share=1.0)
    q = np.random.default_rng(0).uniform(*scene.limits.position.T, size=(400, 7))
    poses = gp.StateBatch(scene, q).object_poses
    kept = np.ones(len(q), dtype=bool)
    for rule in holds.resting(scene):
        kept &= poses[:, 2, :3] @ np.array(rule.axis) >= np.cos(rule.angle)
    assert 0 < kept.sum() < len(kept)
    assert np.array_equal(kept, holds.residual(gp.StateBatch(scene, q)) <= 0.0)


def duration(task, constraints):
    path = gp.Path(np.vstack([task.start, np.atleast_2d(task.goal)[0]]))
    return SceneConstraints(task.scene, constraints).retimed(path, deviation=0.05).duration


@pytest.mark.parametrize("name", ["serve_tea", "pass_bottle", "serve_cake"])
def test_a_weaker_grasp_never_makes_a_motion_faster(name):
    task = task_of(name)
    durations = [duration(task, [gp.GraspHolds(force=force)]) for force in (1e6, 140.0, 70.0, 50.0)]
    assert durations[0] == duration(task, [])
    assert all(a <= b * (1.0 + 1e-9) for a, b in pairwise(durations))
    assert durations[-1] > durations[0]


@pytest.mark.parametrize("name", ["serve_tea", "serve_cake"])
def test_gradients_of_descents_equal_finite_differences(name):
    task = task_of(name)
    objective = Objective(w=0.0).bind(task.scene, search_paces())
    felt = SceneConstraints(task.scene, [gp.GraspHolds(force=60.0)]).felt
    assert not isinstance(felt[0], SpecificForceCone)
    s = np.linspace(0.0, 1.0, 9)[:, None]
    bent = 0.05 * 4.0 * s * (1.0 - s) * np.random.default_rng(1).normal(size=7)
    q = task.start + s * (np.atleast_2d(task.goal)[0] - task.start) + bent
    problem = SceneProblem(kernels=objective.kernels, start=q[0], goals=q[-1:], margin=0.002)
    space, limits = native_space(problem, objective), task.scene.limits

    def descent(felt):
        return _native.MotionDescent(
            space,
            path=q,
            velocity=limits.velocity,
            acceleration=limits.acceleration,
            controls=12,
            density=6,
            time_price=0.05,
            felt=felt,
        )

    held, free = descent([one.native for one in felt]), descent([])
    x = held.controls[1:-1].ravel()

    def added(x):
        """Return the energy added by the limits; the rest of the energy is less smooth."""
        return held.energy(x)[0] - free.energy(x)[0]

    assert added(x) > 0.0  # the motion takes longer
    gradient = np.ravel(held.energy(x)[1] - free.energy(x)[1])
    step = 1e-4  # smaller steps show the single precision of positions
    slopes = [(added(x + step * k) - added(x - step * k)) / (2.0 * step) for k in np.eye(len(x))]
    error = np.abs(gradient - slopes) / np.abs(slopes).max()
    assert np.median(error) < 1e-3 and np.quantile(error, 0.9) < 5e-3


@pytest.mark.long
def test_an_end_that_needs_more_gets_more():
    task = task_of("serve_stew")
    held = SceneConstraints(task.scene, [gp.GraspHolds()]).around(np.vstack([task.start, task.goal]))
    (grasp,) = held.constraints
    assert 0.9 < grasp.share < 1.0
    result = gp.plan(task.start, task.goal, task.scene, w=0.0, iterations=200)
    assert result.status is gp.PlanStatus.SOLVED and result.verdict.checks["grasp_holds"].passed
    assert execute(result, build_world(task.scene)).healthy.harmless


def test_descents_leave_rare_loads_to_timing():
    mug = SceneConstraints(gp.load_scene("desk").tasks["bring_coffee"].scene, [gp.GraspHolds()])
    assert mug.felt and not mug.penalised
    bottle = SceneConstraints(task_of("pass_bottle").scene, [gp.GraspHolds()])
    assert bottle.penalised


def test_a_grasp_goes_without_saying_only_where_it_holds_at_home():
    assert default_constraints(task_of("put_book_away").scene) == (gp.GraspHolds(),)
    assert default_constraints(gp.load_scene("tabletop")) == ()  # no carried object
    for force, asked in ((20.0, ()), (70.0, (gp.GraspHolds(),))):
        assert default_constraints(_pressing(force)) == asked


def test_a_grasp_that_does_not_hold_at_home_is_reported():
    task = task_of("serve_stew")
    weak = gp.plan(task.start, task.goal, _pressing(20.0), stop="first")
    assert "gripper" in weak.detail and "pan" in weak.detail
    assert "not expected" not in gp.plan(task.start, task.goal, _pressing(70.0), stop="first").detail
    assert "not expected" not in gp.plan(task.start, task.goal, _pressing(20.0), constraints=[], stop="first").detail


def _pressing(force):
    """Return the scene of the heavy pan with another grip force [N]."""
    scene = task_of("serve_stew").scene
    spec = scene.spec.copy()
    spec.actuator("panda/gripper").forcerange = [-force, force]
    joints = {f"panda/finger_joint{k}": k for k in (1, 2)}
    opening = {name: float(scene.home_qpos[scene.model.joint(name).qposadr[0]]) for name in joints}
    return gp.Scene.from_mjcf(
        spec,
        robot="panda/",
        tool=scene.tool,
        carried=scene.carried.body,
        X_TO=scene.carried.X_TO,
        fingers=opening,
        velocity=list(scene.limits.velocity),
        acceleration=list(scene.limits.acceleration),
    )


def test_an_object_too_heavy_at_rest_is_reported_with_its_excess():
    task = task_of("serve_stew")
    result = gp.plan(task.start, task.goal, task.scene, constraints=[gp.GraspHolds(force=30.0)])
    assert result.status is gp.PlanStatus.INVALID_START
    assert "2.04" in result.detail and "0.95" in result.detail


def test_fingers_lose_the_object_above_the_limit_and_keep_it_below():
    task = task_of("pass_bottle")
    world = build_world(task.scene, SimSettings(grasp="fingers"))
    path = gp.Path(np.vstack([task.start, np.atleast_2d(task.goal)[0]]))
    scene = task.scene

    def timed(constraints):
        return SceneConstraints(scene, constraints).retimed(path, deviation=0.05)

    # Less than half of it, since the object oscillates in the fingers after such an abrupt start and stop.
    swift, careful = timed([]), timed([gp.GraspHolds(share=0.4)])
    asked = [gp.GraspHolds()]
    assert not gp.verify(swift, scene, constraints=asked).checks["grasp_holds"].passed
    assert gp.verify(careful, scene, constraints=asked).checks["grasp_holds"].passed
    with pytest.raises(ExecutionRefused, match="slipped"):
        execute(swift, world)
    assert execute(careful, world).slip < 0.016


PULLED = {
    "serve_cake": ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.19, -0.2, 0.96)),  # by a thin handle, 10 cm above its mass
    "pass_bottle": ((1.0, 0.0, 0.0), (-1.0, 0.0, 0.0)),  # by its neck, 15 cm above its mass
    "put_book_away": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),  # by an edge, 6 cm above its mass
    "serve_stew": ((0.0, 0.0, -1.0),),  # by a handle, 17 cm beside its mass
}
"""Directions of the pull at the centre of mass, in the frame of the carried body."""


@pytest.mark.parametrize("name", first_quick(PULLED))
def test_mujocos_fingers_give_way_at_the_load_that_is_foreseen(name):
    """The pull grows within 1.5 s to 1.4 of the pads' capacity: up to .85 nothing turns, at the end it has slipped."""
    task = task_of(name)
    scene, world = task.scene, build_world(task.scene, SimSettings(grasp="fingers", sleep=False))
    held = execute(gp.Path(np.stack([task.start, task.start + 1e-3])), world)
    facets, room = load_facets(gp.GraspHolds().grip(scene))
    for direction in np.array(PULLED[name]):
        direction /= np.linalg.norm(direction)
        load, turned, moved = _pulled(world, held, scene, direction, lambda felt: (facets @ felt / room).max())
        held_still = load <= 0.85
        assert held_still.any() and turned[held_still].max() < 1.0 and moved[held_still].max() < 1e-3
        assert turned[load < 1.4].max() > 3.0 or moved[load < 1.4].max() > 3e-3


def _pulled(world, held, scene, direction, load_of):
    """Return loads, and at each the turn of the object [deg] and the displacement of its grasp point [m]."""
    model, body, site = world.model, world.carried_body, world.model.site(scene.tool).id
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, held.states[-1], STATE)
    data.ctrl[:] = held.command[-1]
    mujoco.mj_forward(model, data)
    grip, mass = find_grip(scene), model.body_subtreemass[body]
    rest, slope, X0, found = data.xmat[body].reshape(3, 3).T @ [0.0, 0.0, 9.81], 1.0, None, []
    while load_of(rest + slope * direction) < 1.4:
        slope *= 1.01
    for step in range(round(1.5 / model.opt.timestep)):
        R_WB, R_WT = data.xmat[body].reshape(3, 3), data.site_xmat[site].reshape(3, 3)
        R = R_WT.T @ R_WB
        p = R_WT.T @ (data.xpos[body] + R_WB @ (grip.p_BC - grip.p_GC) - data.site_xpos[site])
        X0 = X0 or (R.copy(), p.copy())
        pull = slope * step * model.opt.timestep / 1.5
        angle = np.degrees(np.arccos(np.clip(0.5 * (np.trace(X0[0].T @ R) - 1.0), -1.0, 1.0)))
        found.append((load_of(rest + pull * direction), angle, np.linalg.norm(p - X0[1])))
        force = -mass * pull * (R_WB @ direction)
        data.xfrc_applied[body] = [*force, *np.cross(data.subtree_com[body] - data.xipos[body], force)]
        mujoco.mj_step(model, data)
    return np.array(found).T


def test_the_grip_comes_from_model_and_settings():
    grip = find_grip(task_of("serve_tea").scene)
    assert grip.force == pytest.approx(70.0) and grip.friction == 1.0
    assert np.allclose(grip.axes @ grip.axes.T, np.eye(3))
    more = gp.GraspHolds(friction=0.5, force=30.0).grip(task_of("serve_tea").scene)
    assert (more.friction, more.force) == (0.5, 30.0) and more.torsion == pytest.approx(0.5 * grip.torsion)


def test_misuse_is_refused():
    for wrong in ({"friction": 0.0}, {"force": np.nan}, {"share": 1.5}):
        with pytest.raises(SettingError, match=next(iter(wrong))):
            gp.GraspHolds(**wrong)
    with pytest.raises(UnsupportedError):
        gp.GraspHolds().rule(gp.load_scene("tabletop"))
