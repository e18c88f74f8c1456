"""The judge: finds violations and their places, accepts valid motions, agrees with python-fcl and with itself."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from graceful_plan import ImpactCost, Objective, plan
from graceful_plan.exceptions import SettingError, ShapeError
from graceful_plan.judge.exact import Judge, Touch, first_collision, state_contacts
from graceful_plan.judge.motion_samples import motion_samples, reach
from graceful_plan.judge.reference_cost import reference_cost, reference_probability
from graceful_plan.judge.second_opinion import fcl_touches
from graceful_plan.judge.verification import MOST_SAMPLES, verify
from graceful_plan.path import Path
from graceful_plan.result import CostBreakdown
from graceful_plan.scene.elements import AllowedContact
from graceful_plan.scene.loading.bundled import load_scene
from graceful_plan.scene.placement import Placement
from graceful_plan.scene.pose_goal import PoseGoal
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.dynamics import RobotDynamics
from graceful_plan.timing.retiming import retime, slowed
from graceful_plan.timing.trajectory import Trajectory

_ARM = """
<mujoco>
  <compiler angle="radian"/>
  <option integrator="implicitfast"/>
  <asset><mesh name="wedge" vertex="0 0 0  .1 0 0  0 .1 0  0 0 .1  .1 .1 .05"/></asset>
  <worldbody>
    <geom name="ground" type="plane" size="3 3 .1"/>
    <body name="arm/base" pos="0 0 .5">
      <geom name="arm/base" type="cylinder" size=".05 .05" mass="1"/>
      <body name="arm/upper" pos="0 0 .1">
        <joint name="arm/pan" axis="0 0 1" range="-3 3" armature=".1"/>
        <geom name="arm/upper" type="capsule" fromto=".08 0 0 .4 0 0" size=".03" mass="2"/>
        <body name="arm/fore" pos=".45 0 0">
          <joint name="arm/lift" axis="0 1 0" range="-2 2" damping=".5"/>
          <geom name="arm/fore" type="capsule" fromto=".06 0 0 .3 0 0" size=".025" mass="1"/>
          <site name="arm/tool" pos=".36 0 0"/>
        </body>
      </body>
    </body>
    <body name="vase" pos="0 .6 .6"><geom name="vase" type="sphere" size=".08"/></body>
    <body name="bowl" pos=".3 -.6 .3"><geom name="bowl" type="ellipsoid" size=".1 .1 .05"/></body>
    <body name="wedge" pos="-.5 -.5 .5"><geom name="wedge" type="mesh" mesh="wedge"/></body>
    <body name="shelf" pos=".8 0 .54"><geom name="shelf" type="box" size=".1 .1 .02"/></body>
    <body name="mug" pos="2 2 1">
      <freejoint/>
      <geom name="mug" type="box" size=".04 .04 .04" mass=".3"/>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.fixture(scope="module")
def empty_handed() -> Scene:
    return Scene.from_mjcf(
        _ARM,
        robot="arm/",
        tool="arm/tool",
        velocity=[2.0, 2.0],
        acceleration=[10.0, 10.0],
        torque=[50.0, 20.0],
        entities={"vase": "glass", "bowl": "glass", "shelf": "table"},
        allowed_contacts=[AllowedContact("arm/upper", "arm/base")],
    )


@pytest.fixture(scope="module")
def scene(empty_handed: Scene) -> Scene:
    return empty_handed.attach("mug", X_TO=np.eye(4), support=["shelf"])


def _path(*q: tuple[float, float]) -> Path:
    return Path(np.array(q))


_FREE = _path((0.5, 0.0), (1.0, -0.3))
_THROUGH_VASE = _path((0.5, 0.0), (2.5, 0.0))


def _timed(path: Path, scene: Scene) -> Trajectory:
    return retime(path, scene.limits, scene.joints)


def test_a_good_trajectory_passes(scene: Scene) -> None:
    trajectory = _timed(_FREE, scene)
    verdict = verify(
        trajectory, scene, start=_FREE.q[0], goal=_FREE.q[1:], cost=reference_cost(_FREE, scene), second_opinion=True
    )
    assert verdict.passed, verdict.failures
    assert set(verdict.checks) == {
        "collision", "position_limits", "velocity_limits", "acceleration_limits", "consistency", "rest", "start",
        "goal", "cost", "second_opinion", "torque",
    }  # fmt: skip


def test_sampled_evenly_cubics_blur_jumps_of_the_acceleration(scene: Scene) -> None:
    """From full acceleration to full braking, the cubic of one piece brakes with up to 5/3 of it."""
    verdict = verify(_timed(_path((0.5, 0.0), (0.8, -0.3), (1.0, 0.0)), scene).sample(0.01), scene)
    assert verdict.failures == ("acceleration_limits",)
    assert 1.0 < verdict.checks["acceleration_limits"].worst <= 5.0 / 3.0 + 1e-6


@pytest.mark.parametrize("share", [0.95, 1.49])
def test_cubics_are_judged_by_their_own_extremes(scene: Scene, share: float) -> None:
    """One cubic from rest to rest: neither its samples nor means show its greatest speed and acceleration."""
    limit = float(scene.limits.acceleration[0])
    duration, far = 0.2, 0.2**2 * share * limit / 6.0
    q = np.array([[0.5, 0.0], [0.5 + far, 0.0]])
    still = np.zeros_like(q)
    verdict = verify(Trajectory(np.array([0.0, duration]), q, still, still, scene.joints), scene)
    assert verdict.checks["acceleration_limits"].worst == pytest.approx(share)
    assert verdict.checks["velocity_limits"].worst == pytest.approx(1.5 * far / duration / scene.limits.velocity[0])
    assert verdict.failures == (() if share < 1.0 else ("acceleration_limits",))


def test_a_motion_too_long_to_be_looked_at_does_not_pass(scene: Scene) -> None:
    """Far beyond all limits, a year at rest, or a million rows."""
    q = np.zeros((2, 2)) + [0.5, 0.0]
    far = verify(Path(q + [[0.0, 0.0], [1e7, 0.0]]), scene)
    assert far.failures == ("collision", "position_limits") and "not checked" in far.checks["collision"].detail
    slow = verify(Trajectory(np.array([0.0, 3e7]), q, 0.0 * q, 0.0 * q, scene.joints), scene)
    assert slow.failures == ("collision",)
    many = np.repeat(q[:1], MOST_SAMPLES + 1, axis=0)
    t = 1e-4 * np.arange(len(many))
    assert verify(Trajectory(t, many, 0.0 * many, 0.0 * many, scene.joints), scene).failures == ("collision",)


def test_a_collision_is_found_where_it_is(scene: Scene) -> None:
    for motion in (_THROUGH_VASE, _timed(_THROUGH_VASE, scene)):
        verdict = verify(motion, scene)
        assert verdict.failures == ("collision",)
        check, found = verdict.checks["collision"], first_collision(motion, scene)
        assert found is not None and found.at == check.first
        assert found.contact.second == "vase" and "vase" in check.detail
        assert state_contacts(found.q, scene)[0].second == "vase"
        assert -0.2 < check.worst < 0.0
        # The carried box comes near first, at 90 degrees minus the angle of its corner and the sphere.
        assert 1.2 < found.q[0] < 1.57


def test_collision_distance_is_that_of_mujoco(scene: Scene) -> None:
    q = np.array([1.5, 0.0])
    data = scene.data_at(q)
    mujoco.mj_collision(scene.model, data)
    vase = scene.model.geom("vase").id
    depth = -min(d for pair, d in zip(data.contact.geom.tolist(), data.contact.dist, strict=True) if vase in pair)
    assert state_contacts(q, scene)[0].depth == pytest.approx(depth, rel=1e-9)


def test_the_judge_finds_the_contacts_of_mujoco() -> None:
    """With changed masks it finds the same contacts as the scene's own model, in a scene with many geoms."""
    scene = load_scene("tabletop").tasks["lift_to_goal"].scene
    pairs = {tuple(sorted(pair)) for pair in scene.collision_pairs().tolist()}
    rng = np.random.default_rng(0)
    lower, upper = scene.limits.position.T
    judge, met = Judge(scene), 0
    for q in rng.uniform(lower, upper, size=(150, len(lower))):
        data = scene.data_at(q)
        mujoco.mj_collision(scene.model, data)
        contacts = zip(np.sort(data.contact.geom, axis=1).tolist(), data.contact.dist, strict=True)
        expected = sorted((a, b, round(d, 9)) for (a, b), d in contacts if d < 0.0 and (a, b) in pairs)
        found = sorted((t.first, t.second, round(t.distance, 9)) for t in judge.touches(q[None]))
        assert [t[:2] for t in found] == [t[:2] for t in expected]
        np.testing.assert_allclose([t[2] for t in found], [t[2] for t in expected], atol=1e-6)
        met += bool(found)
    assert met > 50


def test_fcl_agrees_with_mujoco(scene: Scene) -> None:
    rng = np.random.default_rng(1)
    q = rng.uniform(*scene.limits.position.T, size=(400, 2))
    deep = {(t.sample, t.first, t.second) for t in Judge(scene).touches(q) if t.distance < -1e-3}
    assert len({pair[1:] for pair in deep}) >= 5
    theirs = fcl_touches(q, scene)
    assert deep <= {(t.sample, t.first, t.second) for t in theirs}
    every = {(t.sample, t.first, t.second) for t in Judge(scene).touches(q)}
    assert {(t.sample, t.first, t.second) for t in theirs if t.distance < -1e-3} <= every


def test_second_opinion_finds_the_collision(scene: Scene) -> None:
    check = verify(_THROUGH_VASE, scene, second_opinion=True).checks["second_opinion"]
    assert not check.passed and "vase" in check.detail


# --- contacts allowed at the ends -------------------------------------------------------------------------------------

_STANDING = np.arcsin(0.0001 / 0.36)
"""Lift angle at which the mug is about 0.1 mm in the shelf (its bottom is at the height of the shelf's top at 0)."""


def test_an_object_may_stand_on_its_support_at_the_ends(scene: Scene) -> None:
    stand, lifted = (0.0, _STANDING), (0.0, -0.5)
    assert state_contacts(np.array(stand), scene) == []
    assert "shelf" in [c.second for c in state_contacts(np.array(stand), scene, at_end=False)]
    assert verify(_path(stand, lifted), scene).passed
    assert verify(_path(lifted, stand), scene).passed
    assert verify(_path(stand, lifted, stand), scene).passed


def test_but_not_in_between(scene: Scene) -> None:
    verdict = verify(_path((0.0, -0.5), (0.0, _STANDING), (0.0, -0.5)), scene)
    assert verdict.failures == ("collision",)
    assert "shelf" in verdict.checks["collision"].detail


def test_and_not_deeply(scene: Scene) -> None:
    deep = (0.0, np.arcsin(0.005 / 0.36))
    assert not verify(_path(deep, (0.0, -0.5)), scene).passed
    assert state_contacts(np.array(deep), scene)[0].depth > 0.003


# --- samples ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["path", "trajectory"])
def test_no_point_moves_farther_than_the_step_between_samples(scene: Scene, kind: str) -> None:
    path = _path((0.5, 0.0), (-1.0, 0.8), (2.0, -1.0))
    motion = path if kind == "path" else _timed(path, scene)
    samples = motion_samples(motion, scene, 0.01)
    placement, geoms = Placement(scene), [*scene.components["body"].geoms, *scene.components["carried"].geoms]
    model, corners = scene.model, np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    points = []
    for q in samples.q:
        data = placement.place(q)
        box = model.geom_aabb[geoms, :3][:, None] + corners * model.geom_aabb[geoms, 3:][:, None]
        R = data.geom_xmat[geoms].reshape(-1, 3, 3)
        points.append(data.geom_xpos[geoms][:, None] + np.einsum("gij,gcj->gci", R, box))
    moved = np.linalg.norm(np.diff(points, axis=0), axis=-1)
    assert 0.001 < moved.max() <= 0.01
    np.testing.assert_allclose(samples.q[[0, -1]], path.q[[0, -1]], atol=1e-12)
    assert (np.diff(samples.at) > 0.0).all()


def test_reach_of_a_known_arm(empty_handed: Scene, scene: Scene) -> None:
    # Forearm: capsule centre at 0.18, bounding radius 0.12 + 0.025. Upper arm: the forearm begins 0.45 away.
    np.testing.assert_allclose(reach(empty_handed), [0.45 + 0.325, 0.325], atol=1e-9)
    # The mug's bounding sphere, at the tool.
    assert reach(scene)[1] == pytest.approx(0.36 + 0.04 * np.sqrt(3.0))


def test_placement_equals_the_scene(scene: Scene) -> None:
    placement = Placement(scene)
    for q in np.random.default_rng(0).uniform(*scene.limits.position.T, size=(5, 2)):
        data, expected = placement.place(q), scene.data_at(q)
        np.testing.assert_allclose(data.geom_xpos, expected.geom_xpos, atol=1e-12)
        np.testing.assert_allclose(data.geom_xmat, expected.geom_xmat, atol=1e-12)


def test_a_motion_without_motion(scene: Scene) -> None:
    path = Path(_FREE.q[:1])
    assert verify(path, scene, start=path.q[0], goal=path.q[0]).passed
    assert verify(_timed(path, scene), scene, start=path.q[0], goal=path.q[0]).passed


# --- limits, ends, cost -----------------------------------------------------------------------------------------------


def _changed(trajectory: Trajectory, **arrays: np.ndarray) -> Trajectory:
    values = {name: getattr(trajectory, name) for name in ("t", "q", "qd", "qdd")} | arrays
    return Trajectory(**values, joints=trajectory.joints)


def test_too_fast_is_found(scene: Scene) -> None:
    verdict = verify(slowed(_timed(_path((0.5, 0.0), (1.1, 0.0)), scene), 0.9), scene)
    assert "acceleration_limits" in verdict.failures
    assert "arm/pan" in verdict.checks["acceleration_limits"].detail
    assert verdict.checks["acceleration_limits"].worst == pytest.approx(1.0 / 0.81, rel=1e-3)
    long = _timed(_path((-1.0, -1.2), (1.1, -1.2)), scene)
    assert verify(slowed(long, 1.0 - 1e-5), scene).failures == ("velocity_limits", "acceleration_limits")


def test_velocities_that_do_not_belong_to_the_positions_are_found(scene: Scene) -> None:
    trajectory = _timed(_FREE, scene)
    zero = np.zeros_like(trajectory.qd)
    assert "consistency" in verify(_changed(trajectory, qd=zero, qdd=zero), scene).failures


def test_not_at_rest_is_found(scene: Scene) -> None:
    trajectory = _timed(_FREE, scene)
    half = len(trajectory) // 2
    part = Trajectory(*(x[:half] for x in (trajectory.t, trajectory.q, trajectory.qd, trajectory.qdd)), scene.joints)
    verdict = verify(part, scene)
    assert verdict.failures == ("rest",)
    assert verdict.checks["rest"].first == part.t[-1]


def test_beyond_position_limits_is_found(scene: Scene) -> None:
    check = verify(_path((0.5, 0.0), (0.5, -2.2), (0.5, 0.0)), scene).checks["position_limits"]
    assert not check.passed and "arm/lift" in check.detail
    assert check.worst == pytest.approx(0.2)
    assert check.first == pytest.approx(2.0, abs=0.05)


def test_wrong_ends_are_found(scene: Scene) -> None:
    verdict = verify(_FREE, scene, start=_FREE.q[0] + 1e-5, goal=_FREE.q[1] + [[0.2, 0.0], [1e-4, 0.0]])
    assert verdict.failures == ("start", "goal")
    assert verdict.checks["goal"].worst == pytest.approx(1e-4)


def test_pose_goal_is_checked_by_its_tolerances(scene: Scene) -> None:
    site = scene.data_at(_FREE.q[1]).site("arm/tool")
    X_WT = np.eye(4)
    X_WT[:3, :3], X_WT[:3, 3] = site.xmat.reshape(3, 3), site.xpos
    assert verify(_FREE, scene, goal=PoseGoal(X_WT)).passed
    X_WT[0, 3] += 0.0009
    assert verify(_FREE, scene, goal=PoseGoal(X_WT)).checks["goal"].detail == "of the tolerance: 0.9 mm, 0 rad"
    X_WT[0, 3] += 0.0011
    assert verify(_FREE, scene, goal=PoseGoal(X_WT)).failures == ("goal",)
    assert verify(_FREE, scene, goal=PoseGoal(X_WT, position_tolerance=0.003)).passed


@pytest.mark.parametrize("off", [0.5, 1.0 + 5e-7, 1.0 + 2e-6, 5.0])
def test_a_pose_goal_may_be_turned_by_its_tolerance(scene: Scene, off: float) -> None:
    site = scene.data_at(_FREE.q[1]).site("arm/tool")
    X_WT, (c, s) = np.eye(4), (np.cos(off * 0.01), np.sin(off * 0.01))
    X_WT[:3, :3] = site.xmat.reshape(3, 3) @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    X_WT[:3, 3] = site.xpos
    check = verify(_FREE, scene, goal=PoseGoal(X_WT, orientation_tolerance=0.01)).checks["goal"]
    assert check.worst == pytest.approx(off, rel=1e-9) and check.passed == (off < 1.0 + 1e-6)


@pytest.mark.parametrize("change", [{"motion": 0.5}, {"impact": 0.1}, {"impact_by_entity": {"vase": 1.0}}])
def test_a_wrong_cost_is_found(scene: Scene, change: dict) -> None:
    own = reference_cost(_FREE, scene, w=0.0)
    values = {name: getattr(own, name) for name in ("motion", "impact", "w", "impact_by_entity", "impact_by_component")}
    assert verify(_FREE, scene, cost=CostBreakdown(**values)).passed
    assert verify(_FREE, scene, cost=CostBreakdown(**(values | change))).failures == ("cost",)
    assert verify(_FREE, scene, cost=CostBreakdown()).failures == ("cost",)


def test_no_verdict_speaks_of_a_cost_that_was_not_recomputed() -> None:
    """The judge has an independent implementation of Algorithm 1 only, so only that cost is verified."""
    task = load_scene("tabletop_l1").tasks["green_to_blue"]
    quick: dict = {"iterations": 30, "seed": 1}
    checks = plan(task.start, task.goal, task.scene, w=1.0, **quick).verdict.checks
    assert checks and not [name for name, check in checks.items() if "cost" in name or "impact" in check.detail]

    objective = Objective(impact=ImpactCost(model="box_overlap"), w=1.0, exposure="length")
    result = plan(task.start, task.goal, task.scene, objective=objective, **quick)
    assert result.verdict.checks["cost"].passed and "Algorithm 1" in result.verdict.checks["cost"].detail
    assert result.trajectory is not None and result.path is not None
    falsified = replace(result.cost, motion=0.9 * result.cost.motion)
    for cost, failures in ((result.cost, ()), (falsified, ("cost",))):
        assert verify(result.trajectory, task.scene, cost=cost, exposure="length").failures == failures


def test_a_motion_of_another_robot_is_refused(scene: Scene) -> None:
    with pytest.raises(ShapeError, match="motion has shape"):
        verify(Path(np.zeros((2, 3))), scene)


# --- the slow cost ----------------------------------------------------------------------------------------------------


def test_probability_of_boxes_above_each_other(scene: Scene) -> None:
    """The carried box, 8 cm, above the bowl, 20 cm: all of the box's ground area lies in that of the bowl."""
    bowl = list(scene.entities).index("bowl")
    q = np.array([[np.arctan2(-0.6, 0.3), 0.0]])
    # The tool is 0.81 m out, the bowl 0.67 m: bend the arm until the box is above the bowl's middle.
    bend = -np.arccos((np.hypot(0.3, 0.6) - 0.45) / 0.36)
    q[0, 1] = bend
    P = reference_probability(scene, q, ["carried"])
    assert P.shape == (1, 1, len(scene.entities))
    assert P[0, 0, bowl] == pytest.approx(1.0)
    # Bent down, the box is as high as the bowl and inside it, and wholly below a plate.
    plated = scene.add_box("plate", [0.1, 0.1, 0.01], [0.3, -0.6, 0.5], entity="glass")
    low = np.array([[q[0, 0], -bend]])
    plate = list(plated.entities).index("plate")
    assert reference_probability(plated, low, ["carried"])[0, 0, [bowl, plate]] == pytest.approx([1.0, 0.0])
    assert reference_probability(plated, q, ["carried"])[0, 0, [bowl, plate]] == pytest.approx([1.0, 1.0])


def test_partial_overlap_by_hand(scene: Scene) -> None:
    """At q = 0 the carried box and the shelf are aligned; the box overlaps it by a known part."""
    shelf = list(scene.entities).index("shelf")
    angle = -0.7
    X = 0.45 + 0.36 * np.cos(angle)
    half = 0.04 * (np.cos(angle) + np.sin(-angle))
    overlap = max(0.0, min(X + half, 0.9) - max(X - half, 0.7)) * 0.08
    P = reference_probability(scene, np.array([[0.0, angle]]), ["carried"])[0, 0, shelf]
    assert 0.0 < overlap < 2 * half * 0.08
    assert P == pytest.approx(overlap / (2 * half * 0.08), rel=1e-9)


def test_exposures(scene: Scene) -> None:
    path = _path((0.0, -0.7), (0.0, -0.6))
    length = reference_cost(path, scene, exposure="length")
    time = reference_cost(path, scene, exposure="time")
    # One joint at its limit of 2 rad/s: half a second per radian.
    assert length.impact > 0.0
    assert time.impact == pytest.approx(0.5 * length.impact)
    ends = [reference_cost(Path(path.q[i : i + 1]), scene, exposure="waypoints").impact for i in (0, 1)]
    assert reference_cost(path, scene, exposure="waypoints").impact == pytest.approx(sum(ends))
    assert reference_cost(path.reversed(), scene, exposure="length").impact == pytest.approx(length.impact)
    along = reference_cost(_timed(path, scene), scene, exposure="length")
    assert (along.motion, along.impact) == pytest.approx((length.motion, length.impact), rel=1e-3)
    assert sum(length.impact_by_entity.values()) == pytest.approx(length.impact)
    with pytest.raises(SettingError, match=r"exposure = 'distance'.*time, length, waypoints"):
        reference_cost(path, scene, exposure="distance")


# --- torques ----------------------------------------------------------------------------------------------------------


def test_torques_equal_those_of_a_model_with_the_load_welded_on(scene: Scene) -> None:
    fore = '<site name="arm/tool" pos=".36 0 0"/>'
    load = '<geom type="box" size=".04 .04 .04" mass=".3" pos=".36 0 0" contype="0" conaffinity="0"/>'
    model = mujoco.MjModel.from_xml_string(_ARM.replace(fore, fore + load))
    data = mujoco.MjData(model)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    dynamics, rng = RobotDynamics(scene), np.random.default_rng(0)
    for q, qd, qdd in rng.normal(size=(20, 3, 2)):
        data.qpos[:2], data.qvel[:2], data.qacc[:2] = q, qd, qdd
        mujoco.mj_inverse(model, data)
        np.testing.assert_allclose(dynamics(q, qd, qdd), data.qfrc_inverse[:2], atol=1e-9)


def test_torque_limits_are_kept(scene: Scene) -> None:
    path, dynamics = _path((0.5, 0.5), (2.0, -1.5)), RobotDynamics(scene)
    trajectory = retime(path, scene.limits, scene.joints, inverse_dynamics=dynamics)
    torques = np.array([dynamics(*state) for state in zip(trajectory.q, trajectory.qd, trajectory.qdd, strict=True)])
    assert (np.abs(torques) / scene.limits.torque).max() <= 1.0 + 1e-6


def test_short_pieces_are_not_refused_for_rounded_positions(scene: Scene) -> None:
    """In steps of 0.1 us, the last digit of a position is a quarter of the acceleration limit."""
    limit = 0.999 * scene.limits.acceleration
    t = 1e-7 * np.arange(50)
    q = 0.9 + 0.5 * limit * t[:, None] ** 2
    motion = Trajectory(t, q, limit * t[:, None], np.tile(limit, (50, 1)), scene.joints)
    blamed = np.abs(np.concatenate(motion.piece_accelerations)).max()
    assert blamed > 1.001 * limit.max()
    assert verify(motion, scene).checks["acceleration_limits"].passed


def test_contacts_allowed_at_the_ends_may_graze_on_the_way(scene: Scene) -> None:
    """By less than a micrometre, the rounding error of an object that slides along its support."""
    judge = Judge(scene)
    first, second = (int(geom) for geom in np.argwhere(judge._ends)[0])
    for depth, at_end, wrong in ((5e-7, False, False), (5e-6, False, True), (5e-6, True, False), (0.1, True, True)):
        assert judge.is_violation(Touch(0, first, second, -depth), at_end=at_end) == wrong
