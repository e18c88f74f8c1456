"""Costs and the objective: closed forms, exposures, breakdowns, the contract."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import graceful_plan as gp
from graceful_plan.costs.consequence import Damage
from graceful_plan.costs.cost import NonFiniteCostError, StateBatch, checked_state
from graceful_plan.costs.models.published.box_overlap import BoxOverlap
from graceful_plan.costs.objective import MEAN_PACE, search_paces
from graceful_plan.exceptions import CostError, SettingError, ShapeError, UnknownNameError


@dataclass(frozen=True)
class Constant(gp.Cost):
    value: float = 2.0

    def state(self, batch):
        return np.full(len(batch), self.value)


@dataclass(frozen=True)
class Speed(gp.Cost):
    def state(self, batch):
        return batch.speed


@dataclass(frozen=True)
class Height(gp.Cost):
    """A custom cost, which forces the generic evaluation instead of kernels."""

    def state(self, batch):
        return np.abs(batch.object_poses[:, 2, 3])


@dataclass(frozen=True)
class Twin(gp.InteractionModel):
    """Algorithm 1 as a custom model, so the objective cannot use the kernel's edge costs."""

    def probability(self, batch):
        return batch.compiled.kernels.interaction(batch.q)


def _path(task, n=6, seed=0):
    rng = np.random.default_rng(seed)
    middle = rng.uniform(*task.scene.limits.position.T, size=(n, 7)) * 0.3 + 0.7 * task.start
    return gp.Path(np.concatenate([task.start[None], middle, task.goal[:1]]))


def test_sums_over_states_do_not_depend_on_how_many_are_in_memory(task, monkeypatch):
    path = _path(task)
    whole = gp.evaluate(path, task.scene)
    monkeypatch.setattr("graceful_plan.costs.breakdown._AT_A_TIME", 7)
    parts = gp.evaluate(path, task.scene)
    assert parts.impact == pytest.approx(whole.impact, rel=1e-12) and whole.impact > 0.0


@pytest.mark.parametrize("far", [1e4, 1e150])
def test_a_path_of_too_many_states_is_refused(task, far):
    with pytest.raises(SettingError, match=r"states.*150000"):
        gp.evaluate(np.stack([task.start, task.start + far]), task.scene)


def test_a_constant_impact_is_proportional_to_length(task):
    path = _path(task)
    cost = gp.evaluate(path, task.scene, gp.Objective(impact=Constant(2.0), w=3.0, exposure="length"))
    assert cost.motion == pytest.approx(path.length, rel=1e-12)
    assert cost.impact == pytest.approx(2.0 * path.length, rel=1e-12)
    assert cost.total == pytest.approx(7.0 * path.length, rel=1e-12)


def test_kernel_and_generic_evaluation_agree(task):
    path = _path(task)
    native = gp.Objective(impact=gp.ImpactCost(model="box_overlap")).bind(task.scene)
    generic = gp.Objective(impact=gp.ImpactCost(model=Twin())).bind(task.scene)
    assert native.kernel is not None and generic.kernel is None
    a, b = (o.edges(path.q[:-1], path.q[1:]) for o in (native, generic))
    np.testing.assert_allclose(a[:, 0], b[:, 0], rtol=1e-12)
    assert a[:, 1].sum() == pytest.approx(b[:, 1].sum(), rel=5e-3)


def test_breakdown_adds_up(task):
    path = _path(task)
    objective = gp.Objective(impact=gp.ImpactCost(components=("body", "carried")), w=0.7)
    cost = gp.evaluate(path, task.scene, objective)
    assert sum(cost.impact_by_entity.values()) == pytest.approx(cost.impact)
    assert sum(cost.impact_by_component.values()) == pytest.approx(cost.impact)
    assert cost.total == pytest.approx(cost.motion + 0.7 * cost.impact)
    edges = objective.bind(task.scene).edges(path.q[:-1], path.q[1:]).sum(axis=0)
    assert cost.impact == pytest.approx(edges[1], rel=5e-3)


@given(st.integers(0, 99))
@settings(max_examples=10, deadline=None)
def test_more_vertices_and_the_reversed_path_cost_the_same(seed):
    task = gp.load_scene("tabletop_l1").tasks["green_to_blue"]
    path, boxes = _path(task, seed=seed), gp.Objective(impact=gp.ImpactCost(model="box_overlap"))
    for objective in (gp.Objective(), boxes):
        cost = gp.evaluate(path, task.scene, objective)
        assert gp.evaluate(path.resampled(0.05), task.scene, objective).total == pytest.approx(cost.total, rel=5e-3)
    # Objects dropped on the reversed path fly the other way; the box model ignores velocity.
    assert gp.evaluate(path.reversed(), task.scene, boxes).total == pytest.approx(cost.total, rel=5e-3)


def test_waypoint_exposure_is_the_plain_sum(task):
    path = _path(task)
    cost = gp.evaluate(path, task.scene, gp.Objective(exposure="waypoints"))
    states = gp.Objective().bind(task.scene).states(path.q)
    assert cost.impact == pytest.approx(states.sum())
    edges = gp.Objective(exposure="waypoints").bind(task.scene).edges(path.q[:-1], path.q[1:])
    assert edges[:, 1].sum() == pytest.approx(states[1:].sum())


def test_time_exposure_of_a_path_is_at_the_velocity_limits(task):
    path = _path(task)
    cost = gp.evaluate(path, task.scene, gp.Objective(impact=Constant(1.0), exposure="time"))
    fastest = np.max(np.abs(np.diff(path.q, axis=0)) / task.scene.limits.velocity, axis=1).sum()
    assert cost.impact == pytest.approx(fastest, rel=1e-12)
    speed = gp.evaluate(path, task.scene, gp.Objective(impact=Speed(), exposure="time"))
    assert speed.impact == pytest.approx(path.length, rel=1e-12), "speed integrated over time is length"


def test_time_exposure_of_a_trajectory_is_its_duration(task):
    trajectory = gp.retime(_path(task), task.scene.limits, task.scene.joints)
    cost = gp.evaluate(trajectory, task.scene, gp.Objective(impact=Constant(1.0), exposure="time"))
    assert cost.impact == pytest.approx(trajectory.duration, rel=1e-9)
    speed = gp.evaluate(trajectory, task.scene, gp.Objective(impact=Speed(), exposure="time"))
    assert speed.impact == pytest.approx(trajectory.sample(0.001).path.length, rel=1e-3)


def test_weighted_length():
    task = gp.load_scene("tabletop_l1").tasks["green_to_blue"]
    weights = (1.0, 2.0, 3.0, 1.0, 0.5, 1.0, 4.0)
    path = _path(task)
    cost = gp.evaluate(path, task.scene, gp.Objective(motion=gp.JointLength(weights), w=0.0))
    assert cost.motion == pytest.approx(np.linalg.norm(np.diff(path.q, axis=0) * weights, axis=1).sum())


def test_harmless_entities_and_absent_components_add_nothing(task):
    path = _path(task)
    boxes = gp.Objective(impact=gp.ImpactCost(model="box_overlap"))  # this model ignores obstacles below the object
    cost = gp.evaluate(path, task.scene, boxes)
    added = task.scene.add_box("ghost", [0.3, 0.3, 0.01], [0.0, -0.3, 0.1], entity="none")
    assert gp.evaluate(path, added, boxes).impact == pytest.approx(cost.impact, rel=1e-9)
    assert gp.evaluate(path, task.scene, gp.Objective(impact=gp.ImpactCost(components=("contents",)))).impact == 0.0


def test_more_severity_never_lowers_impact(task):
    path = _path(task)
    worse = task.scene.with_severity({"red1": 50.0})
    assert gp.evaluate(path, worse).impact >= gp.evaluate(path, task.scene).impact


def test_w_zero_does_not_hide_the_impact(task):
    cost = gp.evaluate(_path(task), task.scene, gp.Objective(w=0.0))
    assert cost.impact > 0.0 and cost.total == cost.motion


def test_batch_offers_poses(task):
    batch = gp.StateBatch(task.scene, np.stack([task.start, task.goal[0]]))
    data = task.scene.data_at(task.goal[0])
    body = data.body(task.scene.carried.body)
    np.testing.assert_allclose(batch.object_poses[1, :3, 3], body.xpos, atol=1e-9)
    np.testing.assert_allclose(batch.tool_poses[1, :3, 3], data.site(task.scene.tool).xpos, atol=1e-9)
    assert np.all(batch.qd == 0.0)
    with pytest.raises(ShapeError, match="carried"):
        _ = gp.StateBatch(task.world, batch.q).object_poses


@pytest.mark.parametrize(
    ("value", "error", "message"),
    [
        (lambda n: np.zeros((n, 1)), CostError, "returned shape"),
        (lambda n: np.full(n, -1.0), CostError, "< 0"),
        (lambda n: np.full(n, np.nan), NonFiniteCostError, "nan"),
        (lambda n: np.full(n, np.inf), NonFiniteCostError, "inf"),
    ],
)
def test_errors_of_broken_costs_name_the_problem(task, value, error, message):
    class Broken(gp.Cost):
        def state(self, batch):
            return value(len(batch))

    with pytest.raises(error, match=message):
        checked_state(Broken(), gp.StateBatch(task.scene, task.goal))


def test_misuse_names_the_culprit():
    with pytest.raises(UnknownNameError, match=r"'magic'.*box_overlap"):
        gp.ImpactCost(model="magic")
    with pytest.raises(UnknownNameError, match="body, carried, contents"):
        gp.ImpactCost(components=("arm",))
    for w in (-1.0, np.nan, np.inf):
        with pytest.raises(SettingError, match="w = "):
            gp.Objective(w=w)
    with pytest.raises(SettingError, match="exposure"):
        gp.Objective(exposure="distance")
    with pytest.raises(SettingError, match="weights"):
        gp.JointLength((1.0, 0.0))


def test_a_custom_cost_plugs_in(task):
    objective = gp.Objective(impact=Height(), w=1.0, exposure="length")
    low = gp.plan(task.start, task.goal, task.scene, objective=objective, iterations=200)
    assert low.status is gp.PlanStatus.SOLVED
    straight = gp.evaluate(gp.Path(np.stack([task.start, low.path.q[-1]])), task.scene, objective)
    assert low.cost.total <= straight.total + 1e-9


def test_paces_have_their_mean_and_need_speeds_only(task):
    path = _path(task)
    by_length = gp.Objective(impact=Speed(), exposure="length")
    slow, fast = (gp.evaluate(path, task.scene, by_length, speed=speed).impact for speed in (0.2, 0.4))
    limit = np.linalg.norm(np.diff(path.q, axis=0), axis=1)
    limit /= np.max(np.abs(np.diff(path.q, axis=0)) / task.scene.limits.velocity, axis=1)
    at_limit = float(limit @ np.linalg.norm(np.diff(path.q, axis=0), axis=1))
    assert fast == pytest.approx(2.0 * slow, rel=1e-12)
    assert slow == pytest.approx(0.2 * at_limit, rel=0.02)
    found = {
        model: {
            gp.evaluate(
                path, task.scene, gp.Objective(impact=gp.ImpactCost(model=model), exposure="length"), speed=speed
            ).impact
            for speed in (0.1, 0.3, 1.0)
        }
        for model in ("box_overlap", "mixture")
    }
    assert len(found["box_overlap"]) == 1 and len(found["mixture"]) == 3
    with pytest.raises(SettingError, match=r"speed = 1\.5"):
        gp.evaluate(path, task.scene, speed=1.5)
    assert np.mean(search_paces(0.5)) == pytest.approx(0.5 * MEAN_PACE)


LEAVES = (gp.ImpactCost, gp.JointLength, gp.FailureMixture, BoxOverlap, Damage)


@pytest.mark.parametrize("leaf", LEAVES, ids=lambda leaf: leaf.__name__)
def test_final_classes_cannot_be_extended(leaf):
    with pytest.raises(TypeError, match=f"Mine.*{leaf.__name__}"):
        type("Mine", (leaf,), {})


def test_contracts_can_be_extended_in_several_steps():
    class Doubled(Constant):
        pass

    assert isinstance(Doubled(2.0), gp.Cost) and isinstance(Twin(), gp.InteractionModel)


def test_cached_values_of_states_do_not_depend_on_time(task):
    batch = StateBatch(task.scene, task.start[None])
    made = []

    def make():
        made.append(None)
        return [3.0]

    first = batch.kept.get(list, "a", make)
    assert batch.at(np.ones(1)).kept.get(list, "a", make) is first and len(made) == 1
    assert batch.kept.get(list, "b", make) is not first and len(made) == 2
    assert batch.kept.get(tuple, "a", lambda: (1,)) == (1,)
    assert StateBatch(task.scene, task.start[None]).kept.get(list, "a", make) is not first


@pytest.mark.parametrize("ask", [gp.evaluate, gp.explain])
def test_cubics_that_overshoot_beyond_all_bounds_are_refused(ask):
    task = gp.load_scene("tabletop_l1").tasks["green_to_blue"]
    q = np.stack([task.start] * 3)
    qd = np.zeros_like(q)
    qd[1, 2] = 1e9
    wild = gp.Trajectory(np.array([0.0, 0.1, 0.2]), q, qd, np.zeros_like(q), task.scene.joints)
    with pytest.raises(SettingError, match="1000"):
        ask(wild, task.scene)


def test_a_trajectory_with_its_joints_in_another_order_is_refused():
    task = gp.load_scene("tabletop").tasks["lift_to_goal"]
    scene = task.scene
    motion = gp.retime(gp.Path(np.array([task.start, task.start + 0.1])), scene.limits, scene.joints)
    turned = gp.Trajectory(motion.t, *(x[:, ::-1] for x in (motion.q, motion.qd, motion.qdd)), scene.joints[::-1])
    for judged in (gp.evaluate, gp.explain, gp.risk):
        with pytest.raises(SettingError, match="the order of the scene"):
            judged(turned, scene)
    other = gp.Trajectory(motion.t, motion.q, motion.qd, motion.qdd, tuple(f"joint{k}" for k in range(7)))
    assert gp.evaluate(other, scene) == gp.evaluate(motion, scene)
