"""Moving entities in the core: the NumPy twin, derivatives by differences, gaps by MuJoCo, and a whole plan."""

import mujoco
import numpy as np
import pytest
from moving_twin import moving_probability
from test_drop import BOX, gantry

import graceful_plan as gp
from graceful_plan.core import _native
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import Kernels, instruction_sets
from graceful_plan.costs.cost import moving_batch
from graceful_plan.costs.models.drop.constants import DropSettings
from graceful_plan.costs.models.drop.kernel import DropKernel
from graceful_plan.costs.models.drop.tables import drop_tables
from graceful_plan.costs.models.moving.drops import moving_arm, moving_table
from graceful_plan.costs.models.moving.model import MovingModel
from graceful_plan.costs.models.moving.position_samples import PLACES, cell_of, normal_places
from graceful_plan.planners.native import native_space
from graceful_plan.planners.scene_problem import SceneProblem
from hall import hall

_SAME = 1e-8
"""Absolute error of probabilities: the same formulas, except for tails that the core omits."""
_SPHERES = 1e-5
"""The same where spheres of links matter, which the core has in single precision."""
_NUDGE = 1e-6
"""Step of central differences."""

_ROUND = gp.MovingEntity(
    "ann", "adult", size=[0.2, 0.6], t=[-1.0, 0.0, 0.5, 1.5],
    position=[[-0.4, -0.3, 0.6], [0.2, 0.0, 0.6], [0.4, 0.2, 0.6], [0.4, 0.7, 0.55]], spread=0.08, growth=0.1,
)  # fmt: skip
_BOX = gp.MovingEntity(
    "cart", "adult", size=[0.25, 0.12, 0.15], t=[-1.0, 1.0], position=[[0.6, -0.3, 0.15], [-0.1, 0.3, 0.15]],
    yaw=[0.3, 1.1], spread=0.05,
)  # fmt: skip
_SURE = gp.MovingEntity(
    "cat", "pet", size=[0.1, 0.08, 0.1], t=[-1.0, 1.0], position=[[0.5, 0.0, 0.1], [0.1, 0.1, 0.1]], yaw=[0.0, 0.4]
)
_TABLE = {"table": (0.1, 0.1, 0.3, 'type="box" size="0.3 0.25 0.02"')}
_WALKERS = {"round": _ROUND, "box": _BOX, "sure": _SURE}


def states(scene, n, seed=0, speed=0.5):
    rng = np.random.default_rng(seed)
    low, high = np.maximum(scene.limits.position.T, [[-3.0], [-3.0]])[:, : len(scene.joints)]
    if len(scene.joints) == 4:
        low, high = np.array([-0.3, -0.4, -0.35, -3.0]), np.array([0.7, 0.5, 0.2, 3.0])
    q = rng.uniform(low, np.minimum(high, 3.0), size=(n, len(scene.joints)))
    return q, speed * rng.normal(size=q.shape), rng.uniform(-1.2, 1.7, n)


def arm_scene(*walkers):
    """The Panda at a table among entities that move near its hand."""
    scene = gp.load_scene("tabletop").tasks["right_to_left"].scene
    return scene.with_moving(*walkers)


def raised(entity, by):
    return gp.MovingEntity(
        entity.name, entity.category, size=entity.size, t=entity.t, position=entity.position + by, yaw=entity.yaw,
        spread=entity.spread, growth=entity.growth,
    )  # fmt: skip


def among(scene, severity=1.0):
    """Impact with all failure modes, and equal severities for all entities and components."""
    model = MovingModel(coast=0.0)
    return model.impact(scene, np.full((len(scene.components), len(scene.moving)), severity))


# --- the twin ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("walker", sorted(_WALKERS))
@pytest.mark.parametrize("targets", [{}, BOX, _TABLE], ids=["ground", "box", "table"])
@pytest.mark.parametrize("timed", [True, False])
def test_drops_equal_the_twin(walker, targets, timed):
    scene = gantry(targets).with_moving(_WALKERS[walker])
    q, qd, t = states(scene, 150)
    batch = moving_batch(scene, q, qd, t if timed else None)
    expected = moving_probability(batch, DropSettings.shipped(), ("carried",))
    found = MovingModel().sources(batch, ("carried",))["drop"]
    assert expected.max() > 0.1
    np.testing.assert_allclose(found, expected, atol=_SAME)


@pytest.mark.parametrize("shape", ["cylinder", "plate", "ball"])
def test_shapes_fall_as_in_the_twin(shape):
    scene = gantry(BOX | _TABLE, shape).with_moving(_ROUND, _BOX)
    q, qd, t = states(scene, 200, seed=1, speed=1.0)
    batch = moving_batch(scene, q, qd, t)
    expected = moving_probability(batch, DropSettings.shipped(), ("carried",))
    np.testing.assert_allclose(MovingModel().sources(batch, ("carried",))["drop"], expected, atol=_SAME)


@pytest.mark.parametrize("timed", [True, False])
def test_arms_equal_the_twin(timed):
    scene = arm_scene(*(raised(entity, [0.0, 0.0, 0.4]) for entity in _WALKERS.values()))
    q, qd, t = states(scene, 60)
    batch = moving_batch(scene, q, qd, t if timed else None)
    expected = moving_probability(batch, DropSettings.shipped())
    found = MovingModel().sources(batch)
    assert expected[:, list(scene.components).index("body")].max() > 0.5
    np.testing.assert_allclose(sum(found.values()), expected, atol=_SPHERES)


def test_each_state_stands_for_itself():
    scene = gantry(BOX).with_moving(_ROUND, _SURE)
    q, qd, t = states(scene, 40)
    impact = among(scene)
    whole = impact.impact(q, qd, t)
    each = [impact.impact(q[i : i + 1], qd[i : i + 1], t[i : i + 1])[0] for i in range(len(q))]
    np.testing.assert_allclose(whole, each, atol=1e-12)


def test_severities_weigh_entities():
    scene = gantry(BOX).with_moving(_ROUND, _BOX)
    q, qd, t = states(scene, 80)
    severity = np.arange(1.0, 2.0 * len(scene.components) + 1.0).reshape(len(scene.components), 2)
    P = sum(MovingModel().sources(moving_batch(scene, q, qd, t)).values())
    found = MovingModel().impact(scene, severity)
    np.testing.assert_allclose(found.impact(q, qd, t), np.einsum("nce,ce->n", P, severity), atol=1e-9)
    np.testing.assert_allclose(found.slopes(q, qd, t)[0], found.impact(q, qd, t), atol=1e-9)


@pytest.mark.parametrize("isa", instruction_sets())
def test_instruction_sets_agree(isa):
    scene = gantry(BOX | _TABLE).with_moving(_ROUND, _BOX, _SURE)
    compiled, tables = compile_scene(scene), drop_tables(scene)
    kernels = Kernels(compiled.robot, compiled.world, compiled.impact_tables, isa=isa)
    model = DropKernel(tables, DropSettings.shipped().box, kernels, scene.limits.velocity, len(scene.entities)).native
    table = moving_table(scene)
    places = {"places": np.ascontiguousarray(normal_places()), "cell": cell_of(PLACES)}
    drop = _native.MovingDrop(table, model, protrusion=compiled.robot.protrusion, **places)
    impact = _native.MovingImpact(kernels.core, table)
    for source in (drop, _native.MovingArm(table, kernels.core)):
        impact.add(source, np.array([1.0, 2.0, 3.0]))
    q, qd, t = states(scene, 61)
    weighed = MovingModel().impact(scene, np.tile([[1.0, 2.0, 3.0]], (len(scene.components), 1)))
    falling = sum(name != "body" for name in scene.components)
    assert falling == 1 and weighed.impact(q, qd, None).max() > 0.1
    np.testing.assert_allclose(impact.impact(q, qd, t), weighed.impact(q, qd, t), atol=1e-9)
    np.testing.assert_allclose(impact.impact(q, qd, None), weighed.impact(q, qd, None), atol=1e-9)
    for found, known in zip(impact.slopes(q, qd, t), weighed.slopes(q, qd, t), strict=True):
        np.testing.assert_allclose(found, known, atol=1e-6)
    for found, known in zip(impact.gaps(q, t, np.inf), weighed.gaps(q, t, np.inf), strict=True):
        np.testing.assert_allclose(found, known, atol=1e-9)


# --- derivatives ------------------------------------------------------------------------------------------------------


def differences(value, q, qd, t):
    """Return central differences, and where two step sizes agree, that is, away from kinks."""
    found = []
    for step in (_NUDGE, 4.0 * _NUDGE):
        columns = []
        for j in range(2 * q.shape[1] + 1):
            at = [np.concatenate([q, qd, t[:, None]], axis=1) for _ in range(2)]
            at[0][:, j] -= step
            at[1][:, j] += step
            n = q.shape[1]
            low, high = (value(*(np.ascontiguousarray(x) for x in (a[:, :n], a[:, n:-1], a[:, -1]))) for a in at)
            columns.append((high - low) / (2.0 * step))
        found.append(np.stack(columns, axis=1))
    return found[0], np.isclose(found[0], found[1], rtol=1e-3, atol=1e-4).all(axis=1)


def assert_slopes(impact, q, qd, t, least, tolerance=2e-3):
    _, by_q, by_qd, by_t = impact.slopes(q, qd, t)
    expected, smooth = differences(impact.impact, q, qd, t)
    felt = (np.abs(expected).max(axis=1) > 0.05) & smooth
    assert felt.sum() >= least
    found = np.concatenate([by_q, by_qd, by_t[:, None]], axis=1)
    scale = np.abs(expected).max(axis=1, keepdims=True) + 1.0
    off = np.abs(found - expected) / scale
    # Differences are invalid where contact starts, or the target of a fall changes, within a step.
    assert np.quantile(off[smooth].max(axis=1), 0.95) < tolerance
    assert np.median(off[felt].max(axis=1)) < 1e-4


@pytest.mark.parametrize("walker", sorted(_WALKERS))
@pytest.mark.parametrize("targets", [{}, BOX | _TABLE], ids=["ground", "table"])
def test_slopes_of_drops_are_differences(walker, targets):
    scene = gantry(targets).with_moving(_WALKERS[walker])
    assert_slopes(among(scene), *states(scene, 120, seed=2), least=10)


@pytest.mark.parametrize("shape", ["cylinder", "ball"])
def test_slopes_of_other_shapes_are_differences(shape):
    scene = gantry(BOX | _TABLE, shape).with_moving(_ROUND, _BOX)
    assert_slopes(among(scene), *states(scene, 120, seed=3, speed=1.0), least=10)


def test_slopes_of_arms_are_differences():
    scene = arm_scene(*(raised(entity, [0.0, 0.0, 0.4]) for entity in _WALKERS.values()))
    assert_slopes(among(scene), *states(scene, 60, seed=4), least=20)


def test_slopes_of_failing_bases_are_differences():
    bob = gp.MovingEntity(
        "bob", "adult", size=[0.25, 0.85], t=[0.0, 4.0], position=[[0.0, -1.6, 0.85], [0.0, 1.6, 0.85]], spread=0.1
    )
    scene = hall().with_moving(bob)
    rng = np.random.default_rng(5)
    q = np.column_stack([rng.uniform(-1.5, 1.5, (80, 2)), rng.uniform(-3.0, 3.0, 80)])
    v, omega = rng.uniform(0.3, 1.5, 80), rng.uniform(-1.0, 1.0, 80)
    qd = np.column_stack([v * np.cos(q[:, 2]), v * np.sin(q[:, 2]), omega])
    impact = MovingModel(coast=1.0).impact(scene, np.ones((len(scene.components), 1)))
    value, by_q, by_qd, by_t = impact.slopes(q, qd, rng.uniform(0.5, 3.5, 80))
    assert (value > 0.05).sum() > 10 and all(np.isfinite(d).all() for d in (by_q, by_qd, by_t))
    # Zero is the minimum of the impact, so its derivative by time is zero there, too.
    assert not by_t[value == 0.0].any()


def test_a_later_motion_meets_entities_at_their_later_place():
    scene = gantry({}).with_moving(_ROUND)
    over = np.array([[0.25, 0.0, 0.0, 0.0]])
    value, _, _, by_t = among(scene).slopes(over, np.zeros_like(over), np.array([0.2]))
    later = among(scene).impact(over, np.zeros_like(over), np.array([0.2 + 1e-5]))
    assert value[0] > 0.1 and by_t[0] == pytest.approx((later[0] - value[0]) / 1e-5, abs=1e-3)


# --- gaps -------------------------------------------------------------------------------------------------------------


def oracle(scene, entity, q, t):
    """Return the least distance between covering spheres and the entity, by MuJoCo."""
    robot, there = compile_scene(scene).robot, entity.at(t)
    X = compile_scene(scene).kernels.link_poses(q[None])[0]
    moves = np.flatnonzero(robot.sphere_link > 0)
    kind = "cylinder" if entity.is_round else "box"
    spec = mujoco.MjSpec()
    half = np.cos(0.5 * float(there.yaw)), 0.0, 0.0, np.sin(0.5 * float(there.yaw))
    size = [*entity.size, 0.0][:3]
    body = spec.worldbody.add_body(pos=there.position, quat=half)
    body.add_geom(type=getattr(mujoco.mjtGeom, f"mjGEOM_{kind.upper()}"), size=size)
    for k in moves:
        place = X[robot.sphere_link[k]] @ [*robot.sphere[k, :3], 1.0]
        spec.worldbody.add_body(pos=place[:3]).add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[robot.sphere[k, 3], 0, 0]
        )
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return min(mujoco.mj_geomDistance(model, data, 0, k, 10.0, None) for k in range(1, model.ngeom))


def test_gaps_are_mujocos():
    entities = [raised(entity, [0.1, 0.0, 0.5]) for entity in (_ROUND, _BOX)]
    scene = arm_scene(*entities)
    q, _, t = states(scene, 40, seed=6)
    gap, _, _ = among(scene).gaps(q, t, np.inf)
    expected = [min(oracle(scene, entity, q[i], t[i]) for entity in entities) for i in range(len(q))]
    outside = np.array(expected) > 0.0
    assert outside.sum() > 10
    np.testing.assert_allclose(gap[outside], np.array(expected)[outside], atol=1e-5)
    # MuJoCo computes penetration depths iteratively, per convex pair.
    np.testing.assert_allclose(gap, expected, atol=5e-3)


def test_gaps_beyond_the_cutoff_are_infinite_and_others_exact():
    scene = arm_scene(*(raised(entity, [0.8, 0.3, 0.5]) for entity in (_ROUND, _BOX)))
    q, _, t = states(scene, 300, seed=7)
    whole, by_q, by_t = among(scene).gaps(q, t, np.inf)
    near, near_q, near_t = among(scene).gaps(q, t, 0.15)
    wanted = whole < 0.15
    assert 20 < wanted.sum() < 280
    np.testing.assert_array_equal(near[wanted], whole[wanted])
    np.testing.assert_array_equal(near_q[wanted], by_q[wanted])
    np.testing.assert_array_equal(near_t[wanted], by_t[wanted])
    assert np.isinf(near[~wanted]).all() and not near_q[~wanted].any() and not near_t[~wanted].any()


def test_slopes_of_gaps_are_differences():
    scene = arm_scene(*(raised(entity, [0.1, 0.0, 0.5]) for entity in _WALKERS.values()))
    q, qd, t = states(scene, 150, seed=8)
    impact = among(scene)
    _, by_q, by_t = impact.gaps(q, t, np.inf)
    expected, smooth = differences(lambda q, _, t: impact.gaps(q, t, np.inf)[0], q, qd, t)
    n = q.shape[1]
    assert smooth.sum() > 100 and not expected[:, n:-1].any()
    np.testing.assert_allclose(by_q[smooth], expected[smooth, :n], atol=1e-4)
    np.testing.assert_allclose(by_t[smooth], expected[smooth, -1], atol=1e-4)


# --- motions ----------------------------------------------------------------------------------------------------------


def test_a_plan_avoids_a_pedestrian():
    task = gp.load_scene("tabletop").tasks["right_to_left"]
    hands = [task.scene.data_at(q).site(task.scene.tool).xpos.copy() for q in (task.start, task.goal[0])]
    middle = np.mean(hands, axis=0)
    ann = gp.MovingEntity(
        "ann", "adult", size=[0.15, 0.2], t=[0.0, 6.0], spread=0.05,
        position=[middle + [0.1, -0.3, -0.4], middle + [0.1, 0.6, -0.4]],
    )  # fmt: skip
    scene = task.scene.with_moving(ann)
    careful = gp.Objective(w=3.0)
    given = {"seed": 0, "iterations": 150, "time_limit": 60.0}
    blind = gp.plan(task.start, task.goal, scene, objective=gp.Objective(w=0.0), **given).unwrap()
    aware = gp.plan(task.start, task.goal, scene, objective=careful, **given)
    found, harm = gp.evaluate(aware.unwrap(), scene, careful), gp.evaluate(blind, scene, careful)
    assert found.total == pytest.approx(aware.cost.total)
    assert harm.impact_by_entity["ann"] > 0.05
    assert found.impact_by_entity["ann"] < 0.5 * harm.impact_by_entity["ann"]


def test_motions_descend_by_where_entities_are_at_their_times():
    along = np.linspace(0.0, 1.0, 12)[:, None]
    path = np.array([-0.3, -0.3, 0.0, 0.0]) + along * [0.9, 0.8, 0.0, 0.3]
    path = path + np.sin(np.pi * along) ** 2 * [0.1, -0.2, 0.05, 0.4]  # a straight one has kinks in its speed
    limits = {"velocity": np.ones(4), "acceleration": np.ones(4), "time_price": 0.02}

    def energy(begins):
        objective = gp.Objective(w=10.0).bind(gantry({}).with_moving(_ROUND.later(-begins)))
        assert objective.timed_impact is not None and objective.descended() is objective
        problem = SceneProblem(kernels=objective.kernels, start=np.zeros(4), goals=np.ones((1, 4)))
        descent = _native.MotionDescent(native_space(problem, objective), path=path, controls=8, density=6, **limits)
        value, slope = descent.energy(descent.inner)
        return descent, value, slope

    _, late, _ = energy(50.0)  # the pedestrian has passed
    descent, now, slope = energy(-0.5)
    assert now > 1.02 * late
    flat = descent.inner.ravel()
    steps = 1e-6 * np.eye(len(flat))
    ends = [[descent.energy(flat + sign * step)[0] for step in steps] for sign in (1.0, -1.0)]
    expected, found = (np.array(ends[0]) - ends[1]) / 2e-6, np.ravel(slope)
    error = np.abs(found - expected) / np.abs(expected).max()
    assert np.mean(error < 1e-3) > 0.9, np.sort(error)[-6:]
    assert found @ expected > 0.999 * np.linalg.norm(found) * np.linalg.norm(expected)


def test_kernels_of_other_scenes_are_refused():
    here, there = (gantry(BOX).with_moving(_ROUND) for _ in range(2))
    impact = among(here)
    with pytest.raises(ValueError, match="different scenes"):
        impact.add(moving_arm(there), np.ones(1))
    q, qd, t = states(here, 3)
    with pytest.raises(ValueError, match="time"):
        impact.impact(q, qd, t[:2])
