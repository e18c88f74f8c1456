"""Specific force in a vessel: gravity at rest, derivatives, limits kept by timing, a swinging pendulum."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from felt_twin import curve_of_point, felt_limits, stays_below, swing
from hypothesis import given, settings
from hypothesis import strategies as st

import graceful_plan as gp
from graceful_plan.constraints import specific_force
from graceful_plan.constraints.distance import distance_kernels
from graceful_plan.constraints.scene_constraints import SceneConstraints
from graceful_plan.constraints.slosh import Slosh
from graceful_plan.constraints.specific_force import FACETS, Felt, SpecificForceCone
from graceful_plan.core import _native
from graceful_plan.core.compile import compile_scene
from graceful_plan.costs.objective import Objective, search_paces
from graceful_plan.exceptions import RetimingError
from graceful_plan.planners.native import native_space
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.scene.rules.vessel import Vessel, find_vessel
from graceful_plan.timing.retiming import timed
from graceful_plan.timing.spline import Spline
from graceful_plan.timing.topp import SpecificForceLevels, fastest

Array = np.ndarray
G = 9.81


@pytest.fixture(scope="module")
def coffee() -> gp.Task:
    return gp.load_scene("desk").tasks["bring_coffee"]


def curve(task: gp.Task, size: float = 0.1, seed: int = 0) -> Spline:
    start, goal = np.asarray(task.start), np.atleast_2d(task.goal)[0]
    s = np.linspace(0.0, 1.0, 8)[:, None]
    noise = np.random.default_rng(seed).normal(size=len(start))
    return Spline(start + s * (goal - start) + size * s * (1.0 - s) * noise)


def cone_of(task: gp.Task, angle: float) -> SpecificForceCone:
    """Return the limits of a vessel at some angle, without its surface."""
    return replace(gp.KeepContents().felt(task.scene), angle=angle, brim=None)


def level(task: gp.Task, *felt: Felt) -> SpecificForceLevels:
    names, limits = tuple(one.name for one in felt), tuple(one.timed for one in felt)
    return SpecificForceLevels(compile_scene(task.scene).kernels.core, names, (limits,))


def held(task: gp.Task, spline: Spline, *felt: Felt, speed: float = 1.0) -> gp.Trajectory:
    """Return the fastest motion along a curve within limits on specific force."""
    scene = task.scene
    return timed(spline, scene.limits, scene.joints, speed=speed, felt=level(task, *felt))


def test_derivatives_of_a_point_equal_differences(coffee: gp.Task) -> None:
    kernels, cone = compile_scene(coffee.scene).kernels, cone_of(coffee, 0.5)
    spline, h = curve(coffee), 1e-4
    u = np.linspace(0.5, 4.5, 9)
    controls = np.ascontiguousarray(spline.controls)

    def place(at: Array) -> Array:
        X = kernels.link_poses(_native.spline(controls, at)[0])[:, cone.link]
        return X[:, :3, 3] + X[:, :3, :3] @ cone.point

    q, slope, bend = _native.spline(controls, u)
    first, second = _native.point_derivatives(
        kernels.core, link=cone.link, point=cone.point, q=q, slope=slope, bend=bend
    )
    np.testing.assert_allclose(first, (place(u + h) - place(u - h)) / (2.0 * h), atol=1e-6)
    np.testing.assert_allclose(second, (place(u + h) - 2.0 * place(u) + place(u - h)) / h**2, atol=1e-5)
    twin = curve_of_point(kernels.robot, kernels.link_poses(q), (cone.link, cone.point), (slope, bend))
    np.testing.assert_allclose((first, second), twin, atol=1e-12)


def test_limits_violated_at_rest_are_reported(coffee: gp.Task) -> None:
    kernels, cone = compile_scene(coffee.scene).kernels, cone_of(coffee, 0.5)
    grid = curve(coffee, 3.0).grid(1)
    tilt = np.arccos(np.clip((kernels.link_poses(grid.q)[:, cone.link, :3, :3] @ cone.axis)[:, 2], -1.0, 1.0))
    steepest = float(np.arctan(np.tan(tilt).max() / np.cos(np.pi / FACETS)))
    assert held(coffee, curve(coffee, 3.0), replace(cone, angle=steepest + 0.01)).duration > 0.0
    tilted = replace(cone, angle=0.5 * float(tilt.max()))
    with pytest.raises(RetimingError, match="rest") as ours:
        held(coffee, curve(coffee, 3.0), tilted)
    with pytest.raises(RetimingError, match="rest") as twin:
        felt_limits([tilted], kernels)(grid)
    assert str(ours.value) == str(twin.value)


@given(st.integers(0, 100), st.floats(0.15, 0.8), st.sampled_from([1.0, 0.6]))
def test_timing_in_the_core_is_timing_within_all_rows(seed: int, angle: float, speed: float) -> None:
    """Compared with the twin, at both ends of every interval, including rows that the core omits."""
    task = gp.load_scene("dining_table").tasks["serve_stew"]
    scene, spline = task.scene, curve(task, 0.1, seed)
    carried = cone_of(task, angle), SceneConstraints(scene, [gp.GraspHolds(share=1.0)]).felt[0]
    restraint, grid = felt_limits(carried, compile_scene(scene).kernels), spline.grid(1)
    try:
        rows = restraint(grid)
    except RetimingError as error:
        with pytest.raises(RetimingError, match=str(error)):
            held(task, spline, *carried, speed=speed)
        return
    limits = scene.limits.velocity, scene.limits.acceleration
    x = fastest(grid, *limits, felt=level(task, *carried), speed=speed).speeds ** 2
    u = np.diff(x) / (2.0 * np.diff(grid.s))
    used = (rows[..., 0] * u[:, None] + rows[..., 1] * x[:-1, None]) / rows[..., 2] * speed**2
    assert used.max() == pytest.approx(1.0, abs=1e-6)
    twin = timed(spline, scene.limits, scene.joints, speed=speed, restraint=restraint)
    np.testing.assert_allclose(held(task, spline, *carried, speed=speed).t, twin.t, rtol=1e-9)


def test_timed_motions_keep_the_specific_force_in_its_cone(coffee: gp.Task) -> None:
    """The angle between vessel and specific force, by differences of positions."""
    scene, cone = coffee.scene, cone_of(coffee, 0.25)
    spline = curve(coffee)
    trajectory = held(coffee, spline, cone)
    free = timed(spline, scene.limits, scene.joints)
    assert trajectory.duration > 1.1 * free.duration
    assert specific_force_angle(trajectory, cone, coffee) < 0.26 < specific_force_angle(free, cone, coffee)


def test_the_object_is_never_near_free_fall(coffee: gp.Task, monkeypatch: pytest.MonkeyPatch) -> None:
    """A vertical motion with an increased limit: near free fall the direction of the specific force is undefined."""
    assert cone_of(coffee, 0.6).room[-1] == pytest.approx(-0.5 * cone_of(coffee, 0.6).gravity)
    monkeypatch.setattr(specific_force, "_LIGHTEST", 0.75)
    monkeypatch.setattr(specific_force, "_OF_REST", 1.0)
    scene, cone = coffee.scene, cone_of(coffee, 0.6)
    down = np.array([0.0, 0.35, 0.0, 0.0, 0.0, 0.35, 0.0])
    spline = Spline.through(np.array([coffee.start + share * down for share in (0.0, 0.5, 1.0, 0.5, 0.0)]))
    gentle = held(coffee, spline, cone)
    free = timed(spline, scene.limits, scene.joints)
    least = -cone.room[-1]
    assert felt_along(free, cone, coffee).min() < 0.95 * least < 0.99 * least <= felt_along(gentle, cone, coffee).min()


def test_a_nearly_full_vessel_is_lifted_gently(coffee: gp.Task) -> None:
    """The ratio of lateral to axial acceleration is limited, too, except at rest."""
    assert coffee.object_name is not None and coffee.scene.contents is not None
    vessel, heaves = find_vessel(coffee.scene), []
    assert vessel is not None
    whole = 1e3 * np.pi * vessel.radius**2 * vessel.height
    for fill in (0.5, 0.9, 0.98, 0.999):
        filled = replace(coffee.scene.contents, volume=fill * whole)
        scene = coffee.world.attach(coffee.object_name, support=coffee.support, contents=filled)
        cone = gp.KeepContents().felt(scene)
        heaves.append(cone.heave)
        assert -cone.room[-1] < cone.gravity * np.cos(cone.angle) <= cone.gravity < cone.room[-2]
        assert cone.room[-2] <= (1.0 + cone.heave + 1e-9) * cone.gravity
    assert all(fuller < emptier for emptier, fuller in pairwise(heaves[:-1])) and heaves[-1] == pytest.approx(0.1)


@pytest.mark.parametrize("liquid", [True, False])
def test_motions_are_slowed_down_until_the_surface_stays_below_the_rim(coffee: gp.Task, liquid: bool) -> None:
    """And almost no slower: by the twin's pendulum, or for granular contents by the specific force."""
    cone = replace(cone_of(coffee, 0.6), brim=0.4)
    cone = cone if liquid else replace(cone, slosh=None)
    for seed in range(4):
        spline = curve(coffee, 0.3, seed)
        swift = held(coffee, spline, replace(cone, brim=None))
        factor = held(coffee, spline, cone).duration / swift.duration
        stays = stays_below(cone, swift, coffee.scene, 0.97 * 0.4)
        assert factor > 1.05 and stays(1.02 * factor) and not stays(factor / 1.03)


def test_the_chosen_level_is_the_fastest(coffee: gp.Task) -> None:
    scene, chosen = coffee.scene, set()

    def duration(spline: Spline, felt: SpecificForceLevels) -> float:
        try:
            return timed(spline, scene.limits, scene.joints, felt=felt).duration
        except RetimingError:  # the strictest limits do not even hold at rest
            return np.inf

    for seed in range(6):
        spline = curve(coffee, 0.4, seed)
        constraints = SceneConstraints(scene, [gp.KeepContents()])
        levels = constraints.felt_levels
        assert levels is not None
        alone = [duration(spline, replace(levels, levels=(one,))) for one in levels.levels]
        assert constraints.timed(spline).duration == pytest.approx(min(alone), rel=1e-9)
        chosen.add(int(np.argmin(alone)))
    assert len(chosen) > 1 and chosen != {0}


def felt_along(trajectory: gp.Trajectory, cone: SpecificForceCone, task: gp.Task) -> np.ndarray:
    dt = 0.002
    X = compile_scene(task.scene).kernels.link_poses(trajectory.sample(dt).q[:-1])[:, cone.link]
    p = X[:, :3, 3] + X[:, :3, :3] @ cone.point
    felt = np.diff(p, 2, axis=0) / dt**2 + [0.0, 0.0, cone.gravity]
    return (felt * (X[:, :3, :3] @ cone.axis)[1:-1]).sum(axis=1)


def specific_force_angle(trajectory: gp.Trajectory, cone: SpecificForceCone, task: gp.Task) -> float:
    dt = 0.002
    X = compile_scene(task.scene).kernels.link_poses(trajectory.sample(dt).q[:-1])[:, cone.link]
    p = X[:, :3, 3] + X[:, :3, :3] @ cone.point
    felt = np.diff(p, 2, axis=0) / dt**2 + [0.0, 0.0, cone.gravity]
    axis = (X[:, :3, :3] @ cone.axis)[1:-1]
    cosine = (felt * axis).sum(axis=1) / np.linalg.norm(felt, axis=1)
    return float(np.arccos(cosine).max())


@settings(max_examples=15)
@given(st.floats(0.15, 0.8), st.floats(1.05, 3.0), st.integers(0, 100))
def test_tightening_never_makes_a_motion_faster(angle: float, wider: float, seed: int) -> None:
    task = gp.load_scene("desk").tasks["bring_coffee"]
    spline = curve(task, 0.05, seed)
    tight, loose = (held(task, spline, cone_of(task, most)) for most in (angle, min(angle * wider, 1.4)))
    assert tight.duration >= loose.duration * (1.0 - 1e-3)


@pytest.mark.parametrize("sloshing", [False, True])
def test_gradients_of_descents_include_specific_force(coffee: gp.Task, sloshing: bool) -> None:
    """Compare their share of J, as the difference to a descent without them, with finite differences."""
    scene = coffee.scene
    objective = Objective(w=0.0).bind(scene, search_paces())
    path = curve(coffee).controls
    clear = distance_kernels(scene, "monitor")  # the penalty of collisions is in single precision
    assert clear.clearance(path).min() > 0.05
    problem = SceneProblem(kernels=clear, start=path[0], goals=path[-1:], margin=0.002)
    cone = replace(cone_of(coffee, 0.3), brim=0.2)

    def descent(felt: list[_native.SpecificForceLimit]) -> _native.MotionDescent:
        return _native.MotionDescent(
            native_space(problem, objective),
            path=path,
            velocity=scene.limits.velocity,
            acceleration=scene.limits.acceleration,
            controls=10,
            density=6,
            time_price=5.0,
            felt=felt,
        )

    without = descent([] if not sloshing else [replace(cone, slosh=None).native])
    given = descent([replace(cone, slosh=None).native if not sloshing else cone.native])
    x = given.controls[1:-1].ravel()
    added = given.energy(x)[0] - without.energy(x)[0]
    assert added > 0.1
    gradient = (given.energy(x)[1] - without.energy(x)[1]).ravel()
    step = 1e-6
    by = np.array(
        [
            (given.energy(y)[0] - without.energy(y)[0] - given.energy(z)[0] + without.energy(z)[0]) / (2.0 * step)
            for y, z in ((x + step * e, x - step * e) for e in np.eye(len(x)))
        ]
    )
    error = np.abs(gradient - by) / np.abs(by).max()
    assert np.mean(error < 1e-5) > 0.9, np.sort(error)[-6:]  # the profile has kinks
    if sloshing:  # swings below the limit cost nothing
        wide = descent([replace(cone, brim=1.5).native])
        assert wide.energy(x)[0] == pytest.approx(without.energy(x)[0], abs=1e-12)


def test_a_pendulum_has_its_frequency_and_damping() -> None:
    slosh = Slosh(frequency=20.0, damping=0.02, length=G / 400.0)
    dt, n = 0.001, 4000
    felt = np.tile([0.0, 0.0, G], (n, 1))
    felt[:5, 0] = 0.5  # a perturbation
    angle = swing(felt, dt, slosh.length, slosh.drag)[:, 0]
    up = np.flatnonzero((angle[:-1] < 0.0) & (angle[1:] >= 0.0))
    period = np.diff(up).mean() * dt
    assert period == pytest.approx(2.0 * np.pi / 20.0, rel=0.01)
    peaks = [angle[a:b].max() for a, b in pairwise(up)]
    assert np.log(peaks[0] / peaks[10]) == pytest.approx(10 * 2.0 * np.pi * 0.02, rel=0.05)


def test_a_liquid_at_rest_stays_level_and_a_steady_push_tilts_it() -> None:
    slosh = Slosh(frequency=20.0, damping=0.3, length=G / 400.0)
    level = swing(np.tile([0.0, 0.0, G], (200, 1)), 0.005, slosh.length, slosh.drag)
    np.testing.assert_allclose(level, np.tile([0.0, 0.0, 1.0], (200, 1)), atol=1e-12)
    pushed = swing(np.tile([3.0, 4.0, G], (2000, 1)), 0.005, slosh.length, slosh.drag)
    np.testing.assert_allclose(pushed[-1], np.array([3.0, 4.0, G]) / np.linalg.norm([3.0, 4.0, G]), atol=1e-6)


@settings(max_examples=30)
@given(st.floats(0.02, 0.1), st.floats(0.05, 0.2), st.floats(0.55, 0.99))
def test_the_brim_is_reached_where_the_surface_meets_the_rim(R: float, H: float, fill: float) -> None:
    """A closed form if the surface does not reach the bottom: it falls by R tan(tilt) on one side."""
    vessel = Vessel(
        radius=R,
        height=H,
        volume=np.pi * R**2 * H * fill,
        axis=np.array([0.0, 0.0, 1.0]),
        p_BR=np.array([0.0, 0.0, H]),
        repose=0.0,
    )
    assert vessel.brim_tilt == pytest.approx(np.arctan(H * (1.0 - fill) / R), abs=1e-6)
    assert np.linalg.norm(vessel.p_BS - [0.0, 0.0, fill * H]) < 1e-12


def test_a_vessel_is_found_where_something_is_carried_in_one(coffee: gp.Task) -> None:
    assert find_vessel(gp.load_scene("desk")) is None
    vessel = find_vessel(coffee.scene)
    assert vessel is not None and 0.0 < vessel.brim_tilt < np.pi / 2
