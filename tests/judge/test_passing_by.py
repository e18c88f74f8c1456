"""The judge of moving entities, against distances in closed form."""

import mujoco
import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.judge import passing_by
from graceful_plan.judge.passing_by import passing_check
from graceful_plan.scene.placement import Placement
from hall import hall
from sizes import first_quick

SCENE = hall(extra="").edit(remove=["person", "pillar"])


def straight(speed=1.0, length=4.0):
    n = 41
    t = np.linspace(0.0, length / speed, n)
    q = np.zeros((n, 3))
    q[:, 0] = speed * t
    return gp.Trajectory(t, q, np.tile([speed, 0.0, 0.0], (n, 1)), np.zeros((n, 3)), SCENE.joints)


def at(position, t=None, **given):
    t = [0.0] if t is None else t
    return SCENE.with_moving(gp.MovingEntity("ann", "adult", size=[0.25, 0.85], t=t, position=position, **given))


def test_the_least_clearance_is_that_of_the_closed_form():
    check = passing_check(straight(), at([[2.0, 0.8, 0.85]]))
    assert check.passed
    assert check.worst == pytest.approx(0.8 - 0.25 - (0.1878 + 0.02), abs=2e-3)


def test_hit_entities_are_named_with_the_time():
    check = passing_check(straight(), at([[3.0, 0.0, 0.85]]))
    assert not check.passed and "'ann'" in check.detail
    assert check.first == pytest.approx(3.0 - 0.25 - (0.131 + 0.098), abs=0.05)


def test_entities_that_left_or_arrive_later_are_not_hit():
    times = [0.0, 1.0, 2.0, 4.0]
    gone = [[2.0, 0.0, 0.85], [2.0, 0.0, 0.85], [2.0, 1.9, 0.85], [2.0, 1.9, 0.85]]
    assert passing_check(straight(), at(gone, times)).passed
    assert not passing_check(straight(), at(gone[::-1], times)).passed


def test_a_base_at_rest_hits_no_entity():
    still = gp.Trajectory(np.array([0.0, 5.0]), np.zeros((2, 3)), np.zeros((2, 3)), np.zeros((2, 3)), SCENE.joints)
    assert passing_check(still, at([[0.0, -2.0, 0.85], [0.0, 2.0, 0.85]], [0.0, 5.0])).passed


def test_corners_of_a_turning_base_hit_entities_beside_it():
    t = np.linspace(0.0, 2.0, 41)
    q = np.column_stack([np.zeros((41, 2)), t])
    turning = gp.Trajectory(t, q, np.tile([0.0, 0.0, 1.0], (41, 1)), np.zeros((41, 3)), SCENE.joints)
    beside = at([[0.0, 0.49, 0.85]])  # 3 cm from the wheels of a base at rest
    assert not passing_check(turning, beside).passed
    assert passing_check(turning, at([[0.0, 0.7, 0.85]])).passed


def test_only_verdicts_among_moving_entities_have_the_check():
    trajectory = straight()
    assert "passing_by" not in gp.verify(trajectory, SCENE).checks
    assert "passing_by" in gp.verify(trajectory, at([[2.0, 0.8, 0.85]])).checks
    path = gp.Path(trajectory.q[[0, -1]])
    assert "passing_by" not in gp.verify(path, at([[2.0, 0.8, 0.85]])).checks


ARM = """
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <body name="arm/base">
      <geom type="cylinder" size=".1 .2" pos="0 0 .2"/>
      <body name="arm/link" pos="0 0 .5">
        <joint name="arm/turn" type="hinge" axis="0 0 1" range="-3 3"/>
        <geom type="capsule" fromto="0 0 0 .8 0 0" size=".03" mass="1"/>
        <site name="arm/tip" pos=".8 0 0"/>
      </body>
    </body>
  </worldbody>
</mujoco>"""


def arm_among(*entities):
    arm = gp.Scene.from_mjcf(ARM, robot="arm/", tool="arm/tip", velocity=[2.0], acceleration=[20.0])
    return arm.with_moving(*entities)


def adult(position, t=(0.0,)):
    return gp.MovingEntity("ann", "adult", size=[0.25, 0.85], t=list(t), position=position)


def test_an_arm_that_sweeps_through_an_entity_is_warned_about_by_depth_name_and_time():
    scene = arm_among(adult([[0.9 * np.cos(0.8), 0.9 * np.sin(0.8), 0.85]]))
    trajectory = gp.retime(gp.Path(np.array([[0.0], [1.6]])), scene.limits, scene.joints)
    verdict = gp.verify(trajectory, scene)
    assert verdict.passed and verdict.warnings == ("passing_by",)
    check = verdict.checks["passing_by"]
    assert check.worst == pytest.approx(0.1 - 0.25 - 0.03, abs=2e-3) and "'ann'" in check.detail
    # The first contact is where the link, seen from the base, is tangent to the entity.
    first = trajectory.t[np.argmax(trajectory.q[:, 0] > 0.8 - np.arcsin(0.28 / 0.9))]
    assert check.first == pytest.approx(first, abs=0.05)


def test_an_arm_meets_an_entity_only_where_it_is_at_that_time():
    place, away = [0.9 * np.cos(0.8), 0.9 * np.sin(0.8), 0.85], [3.0, 3.0, 0.85]
    scene = arm_among(adult([place, away, away], (0.0, 0.01, 9.0)))
    trajectory = gp.retime(gp.Path(np.array([[0.0], [1.6]])), scene.limits, scene.joints)
    assert gp.verify(trajectory, scene).warnings == ()


def test_an_entity_may_walk_into_the_fixed_pedestal_of_an_arm():
    scene = arm_among(adult([[-0.3, 0.0, 0.85]]))
    trajectory = gp.retime(gp.Path(np.array([[0.0], [1.6]])), scene.limits, scene.joints)
    assert gp.verify(trajectory, scene).warnings == ()


def test_a_plan_through_an_entity_is_solved_with_a_warning():
    scene = arm_among(adult([[0.9 * np.cos(0.8), 0.9 * np.sin(0.8), 0.85]]))
    result = gp.plan([0.0], [1.6], scene, iterations=10)
    assert result.status is gp.PlanStatus.SOLVED
    assert result.verdict.warnings == ("passing_by",) and "'ann'" in result.detail


def dense_passing(motion, scene):
    """Measure every geom at every time: least clearance [m], at most 1, its entity, and first time of overlap [s]."""
    t = passing_by._times(motion, scene)
    state = motion.at(t)
    model = passing_by._with_walkers(scene)
    placement, robot = Placement(scene, model), passing_by._robot_geoms(scene)
    worst, whom, first = 1.0, "", np.inf
    for name, entity in scene.moving.items():
        geom, mocap = int(model.body_geomadr[model.body(name).id]), int(model.body_mocapid[model.body(name).id])
        there = entity.at(t)
        for k in np.flatnonzero(passing_by.is_moving(state.qd)):
            half = 0.5 * float(there.yaw[k])
            placement.data.mocap_pos[mocap] = there.position[k]
            placement.data.mocap_quat[mocap] = [np.cos(half), 0.0, 0.0, np.sin(half)]
            data = placement.place(state.q[k])
            distance = min(mujoco.mj_geomDistance(model, data, own, geom, 1.0, None) for own in robot)
            if distance < 0.0:
                first = min(first, float(t[k]))
            if distance < worst:
                worst, whom = distance, name
    return worst, whom, first


def random_drive(seed, length=4.0):
    """Return a motion of an arm's base along a winding path, with all joints moving."""
    scene = gp.load_scene("hallway").without_moving()
    rng, t, nq = np.random.default_rng(seed), np.linspace(0.0, 6.0, 121), len(scene.joints)
    middle, half = scene.limits.position.mean(axis=1), np.minimum(0.5 * np.ptp(scene.limits.position, axis=1), 1.0)
    size, rate, phase = rng.uniform(0.1, 0.6, nq) * half, rng.uniform(0.3, 0.8, nq), rng.uniform(0, 6, nq)
    size[:2], middle[:2] = (0.5 * length, 0.3), scene.limits.position[:2].mean(axis=1)
    wave = rate * t[:, None] + phase
    q, qd, qdd = middle + size * np.sin(wave), size * rate * np.cos(wave), -size * rate**2 * np.sin(wave)
    return scene, gp.Trajectory(t, q, qd, qdd, scene.joints)


@pytest.mark.parametrize("seed", first_quick(range(4)))
@pytest.mark.parametrize("gap", [0.0, 0.35, 0.5, 0.7, 1.5])
def test_bounds_change_nothing(seed, gap):
    """Compared with every geom at every time: through a person, grazing, near, far."""
    scene, motion = random_drive(seed)
    rng = np.random.default_rng(seed)
    on_the_way = motion.q[60, :2] + gap * np.array([np.cos(seed), np.sin(seed)])
    walks = on_the_way + rng.uniform(-0.5, 0.5, 2)
    many = (
        gp.MovingEntity("ann", "adult", size=[0.25, 0.85], t=[0.0], position=[[*on_the_way, 0.85]]),
        gp.MovingEntity("cart", "adult", size=[0.3, 0.2, 0.4], t=[0.0, 6.0], yaw=[0.0, 2.0],
                        position=[[*walks, 0.4], [*(walks + 1.0), 0.4]]),
    )  # fmt: skip
    scene = scene.with_moving(*many)
    check = passing_check(motion, scene)
    worst, whom, first = dense_passing(motion, scene)
    assert check.worst == pytest.approx(worst, abs=1e-5)
    assert check.passed == (worst >= 0.0)
    if 0.0 <= worst < 1.0:  # in deep overlaps two entities may be equally deep
        assert repr(whom) in check.detail
    assert check.first == (None if first == np.inf else pytest.approx(first))


@pytest.mark.parametrize(("grazes", "passed"), [(-2e-4, False), (2e-4, True)])
def test_grazing_and_near_misses_are_distinguished(grazes, passed):
    beside = 0.25 + 0.1878 + 0.02 + grazes
    assert passing_check(straight(), at([[2.0, beside, 0.85]])).passed == passed
