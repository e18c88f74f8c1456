"""Roadmaps: stored values are correct, and queries equal a full computation."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import graceful_plan as gp
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import COST_STEP, FINE_STEP
from graceful_plan.costs.cost import NonFiniteCostError
from graceful_plan.costs.objective import search_paces
from graceful_plan.exceptions import NonFiniteError, SettingError, ShapeError, UnknownNameError
from graceful_plan.planners.roadmaps.edge_prices import Edges
from graceful_plan.roadmap import QueryStatus
from graceful_plan.roadmap.exposure import Exposure
from graceful_plan.roadmap.ground import MARGIN

NODES = 160

GANTRY = """
<mujoco>
  <worldbody>
    <body name="x" pos="0 0 1">
      <joint name="x" type="slide" axis="1 0 0" range="-1 1"/>
      <geom size=".01" mass=".1" contype="0" conaffinity="0"/>
      <body name="y">
        <joint name="y" type="slide" axis="0 1 0" range="-1 1"/>
        <geom size=".05" mass=".1"/>
        <site name="tool"/>
      </body>
    </body>
    <body name="wall" pos="0 0 1"><geom type="box" size=".05 {wall} .2"/></body>
    <body name="vase" pos="-.4 .5 .5"><geom type="box" size=".1 .1 .1"/></body>
    <body name="thing" pos="0 0 3">
      <freejoint/>
      <geom type="box" size=".04 .04 .04" mass=".2"/>
    </body>
  </worldbody>
</mujoco>
"""


def gantry(wall: float = 0.5, **severity: float) -> gp.Scene:
    """A point above a vase, on a plane with a wall across."""
    return gp.Scene.from_mjcf(
        GANTRY.format(wall=wall),
        robot="x",
        tool="tool",
        carried="thing",
        X_TO=gp.FROM_ABOVE,
        entities={"vase": "glass"},
        velocity=[1.0, 1.0],
        acceleration=[2.0, 2.0],
        severity=severity,
    )


@pytest.fixture(scope="module")
def task():
    return gp.load_scene("tabletop").tasks["green_to_blue"]


@pytest.fixture(scope="module")
def roadmap(task):
    return gp.Roadmap.build(task.scene, nodes=NODES, seed=3)


@pytest.fixture(scope="module")
def answer(task, roadmap):
    return roadmap.query(task.start, task.goal)


# --- stored values ----------------------------------------------------------------------------------------------------


def test_nodes_and_edges_are_free(task, roadmap):
    kernels = compile_scene(task.scene).kernels
    lower, upper = task.scene.limits.position.T
    assert len(roadmap) == NODES
    assert ((roadmap.q >= lower) & (roadmap.q <= upper)).all()
    assert kernels.free(roadmap.q, MARGIN).all()
    assert kernels.edges_free(roadmap.q[roadmap.edges.tail], roadmap.q[roadmap.edges.head], FINE_STEP, MARGIN).all()


def test_every_edge_is_there_in_both_directions_and_once(roadmap):
    there = list(zip(roadmap.edges.tail.tolist(), roadmap.edges.head.tolist(), strict=True))
    assert len(there) > 4 * NODES
    assert len(set(there)) == len(there)
    assert sorted(there) == sorted((b, a) for a, b in there)


def test_stored_costs_equal_the_objective(task, roadmap):
    edges = slice(None, None, 7)
    q0, q1 = roadmap.q[roadmap.edges.tail[edges]], roadmap.q[roadmap.edges.head[edges]]
    exact = roadmap.objective.bind(task.scene, search_paces()).edges(q0, q1)
    severity = roadmap.severity()
    assert roadmap.edges.prices.motion[edges] == pytest.approx(exact[:, 0])
    fine = Exposure(roadmap.objective, task.scene, COST_STEP).price(q0, q1).impact(severity)
    assert fine == pytest.approx(exact[:, 1], rel=0.03, abs=2e-3)
    stored = roadmap.edges.prices.impact(severity)[edges]
    assert np.abs(stored - exact[:, 1]).sum() < 0.05 * exact[:, 1].sum()


def test_directions_differ_where_velocity_matters(task, roadmap):
    count = len(roadmap.edges)
    impact = {
        (a, b): s
        for a, b, s in zip(
            roadmap.edges.tail, roadmap.edges.head, roadmap.edges.prices.impact(roadmap.severity()), strict=True
        )
    }
    differ = sum(abs(s - impact[b, a]) > 1e-3 * (s + 1e-3) for (a, b), s in impact.items())
    assert differ > 0.3 * count
    flat = gp.Roadmap.build(task.scene, objective=gp.Objective(impact=gp.ImpactCost("box_overlap")), nodes=60)
    prices = flat.edges.prices.impact(flat.severity())
    pairs = {(a, b): s for a, b, s in zip(flat.edges.tail, flat.edges.head, prices, strict=True)}
    assert prices.max() > 0.0
    assert all(s == pairs[b, a] for (a, b), s in pairs.items())


def test_builds_depend_on_the_seed_alone(task, roadmap, monkeypatch):
    monkeypatch.setattr("graceful_plan.roadmap.ground.os.cpu_count", lambda: 1)
    again = gp.Roadmap.build(task.scene, nodes=NODES, seed=3)
    assert np.array_equal(again.q, roadmap.q)
    for name in ("tail", "head"):
        assert np.array_equal(getattr(again.edges, name), getattr(roadmap.edges, name))
    assert np.array_equal(again.edges.prices.exposure, roadmap.edges.prices.exposure)
    other = gp.Roadmap.build(task.scene, nodes=NODES, seed=4)
    assert not np.array_equal(other.q, roadmap.q)


def test_a_build_without_time_can_still_be_queried(task):
    roadmap = gp.Roadmap.build(task.scene, time_limit=0.0)
    assert len(roadmap.edges) == 0
    result = roadmap.query(task.start, task.goal)
    assert result.status in (QueryStatus.FOUND, QueryStatus.NOT_CONNECTED)


# --- queries ----------------------------------------------------------------------------------------------------------


def test_an_answer_is_a_free_path_at_its_price(task, roadmap, answer):
    assert answer.status is QueryStatus.FOUND
    q = answer.path.q
    np.testing.assert_array_equal(q[0], task.start)
    np.testing.assert_array_equal(q[-1], task.goal[answer.goal_index])
    kernels = compile_scene(task.scene).kernels
    assert kernels.edges_free(q[:-1], q[1:], FINE_STEP).all()
    expected = gp.evaluate(answer.path, task.scene, gp.Objective(w=1.0))
    assert answer.cost.motion == pytest.approx(expected.motion)
    assert answer.cost.impact == pytest.approx(expected.impact)
    assert answer.cost.impact_by_entity == pytest.approx(expected.impact_by_entity)
    assert answer.cost.impact_by_component == pytest.approx(expected.impact_by_component)
    assert roadmap.query(task.start, task.goal).cost == answer.cost


def test_other_severities_equal_a_new_roadmap(task, roadmap):
    entity = next(iter(task.scene.entities))
    severity = {entity: {"carried": 37.0}}
    other = task.scene.with_severity(severity)
    q0, q1 = roadmap.q[roadmap.edges.tail], roadmap.q[roadmap.edges.head]
    anew = Exposure(roadmap.objective, other).price(q0, q1)
    prices = Edges(roadmap.edges.tail, roadmap.edges.head, anew)
    rebuilt = gp.Roadmap(other, roadmap.objective, roadmap.q, prices, roadmap.constraints)
    expected = rebuilt.query(task.start, task.goal, w=2.0)
    for result in (
        roadmap.query(task.start, task.goal, other, w=2.0),
        roadmap.query(task.start, task.goal, w=2.0, severity=severity),
    ):
        np.testing.assert_array_equal(result.path.q, expected.path.q)
        assert result.cost == expected.cost
    assert expected.cost.impact == pytest.approx(gp.evaluate(expected.path, other, gp.Objective(w=2.0)).impact)


@pytest.mark.long
@settings(max_examples=25, deadline=None)
@given(w=st.floats(0.0, 50.0), factor=st.floats(0.1, 20.0))
def test_no_path_of_the_front_is_cheaper_than_the_answer(task, roadmap, w, factor):
    severity = {name: factor * max(e.severity.values()) for name, e in task.scene.entities.items()}
    front = roadmap.front(task.start, task.goal, epsilon=0.0, severity=severity)
    answer = roadmap.query(task.start, task.goal, w=w, severity=severity)

    def stored(q):
        prices = roadmap.exposure.price(q[:-1], q[1:])
        return prices.motion.sum() + w * prices.impact(roadmap.severity(severity=severity)).sum()

    assert stored(answer.path.q) <= min(stored(point.q) for point in front) * (1.0 + 1e-6) + 1e-9
    # Reported costs are computed differently; no point outside of the front dominates by them.
    assert min(point.motion + w * point.impact for point in front) <= answer.cost.total * (1.0 + 1e-6) + 1e-9


def test_more_weight_means_less_impact_and_more_motion(task, roadmap):
    found = [roadmap.query(task.start, task.goal, w=w).cost for w in (0.0, 0.1, 0.5, 1.0, 3.0, 10.0, 100.0)]
    for less, more in pairwise(found):
        assert more.motion >= less.motion * (1.0 - 1e-3)
        assert more.impact <= less.impact * 1.1  # 1.02 by a query's own cost; here joint limits set the pace
    assert found[-1].impact < 0.9 * found[0].impact


def test_empty_severities_change_nothing(task):
    pose = np.eye(4)
    pose[:3, 3] = (5.0, 5.0, 0.2)
    ghost = task.scene.add_box("ghost", [0.1, 0.1, 0.1], pose, entity="glass").with_severity({"ghost": 0.0})
    plain, haunted = (gp.Roadmap.build(scene, nodes=60, seed=1) for scene in (task.scene, ghost))
    np.testing.assert_allclose(plain.q, haunted.q)
    first, second = (roadmap.query(task.start, task.goal) for roadmap in (plain, haunted))
    np.testing.assert_allclose(first.path.q, second.path.q)
    assert second.cost.impact == pytest.approx(first.cost.impact)
    assert second.cost.impact_by_entity["ghost"] == 0.0


def test_a_motion_to_where_the_robot_is_costs_nothing(task, roadmap):
    result = roadmap.query(task.start, task.start)
    assert result.status is QueryStatus.FOUND
    assert (len(result.path), result.cost.total) == (1, 0.0)


def test_the_nearest_of_several_goals_is_taken(task, roadmap):
    far, near = roadmap.q[np.argsort(np.linalg.norm(roadmap.q - task.start, axis=1))[[-1, 3]]]
    result = roadmap.query(task.start, np.stack([far, near]), w=0.0)
    assert result.goal_index == 1


def test_a_pose_is_a_goal(task, roadmap):
    site = task.scene.data_at(roadmap.q[-1]).site(task.scene.tool)
    X_WT = np.eye(4)
    X_WT[:3, :3], X_WT[:3, 3] = site.xmat.reshape(3, 3), site.xpos
    result = roadmap.query(task.start, gp.PoseGoal(X_WT))
    assert result.status is QueryStatus.FOUND
    reached = task.scene.data_at(result.path.q[-1]).site(task.scene.tool).xpos
    np.testing.assert_allclose(reached, site.xpos, atol=2e-3)


@pytest.mark.parametrize("motions", [[], "start to start", "from a collision"])
def test_motions_that_cannot_be_used_are_skipped(task, motions):
    if isinstance(motions, str):
        blocked = task.scene.limits.position[:, 1]
        motions = [(task.start, task.start) if "start to" in motions else (blocked, task.goal)]
    roadmap = gp.Roadmap.build(task.scene, motions=motions, nodes=40)
    assert len(roadmap) == 40
    assert roadmap.query(task.start, task.goal).status is QueryStatus.FOUND


def test_any_two_configurations_can_be_queried(roadmap):
    rng = np.random.default_rng(5)
    pairs = roadmap.q[rng.integers(len(roadmap), size=(12, 2))]
    found = [roadmap.query(*pair).status for pair in pairs if np.any(pair[0] != pair[1])]
    assert found.count(QueryStatus.FOUND) == len(found)


def test_ends_that_cannot_be_used(task, roadmap):
    inside_table = task.start.copy()
    for joint in (1, 3):
        inside_table[joint] = task.scene.limits.position[joint, 1]
    assert roadmap.query(inside_table, task.goal).status is QueryStatus.INVALID_START
    assert roadmap.query(task.start, inside_table).status is QueryStatus.INVALID_GOAL
    beyond = task.start + 10.0
    result = roadmap.query(beyond, task.goal)
    assert result.status is QueryStatus.INVALID_START and "limit" in result.detail
    assert roadmap.front(inside_table, task.goal) == roadmap.front(task.start, beyond) == []


@dataclass(frozen=True)
class Low(gp.Constraint):
    """The tool stays below a height: a custom constraint."""

    height: float

    def residual(self, batch: gp.StateBatch) -> np.ndarray:
        """Return the height above the limit [m]."""
        return batch.tool_poses[:, 2, 3] - self.height


@pytest.mark.parametrize("asked", [gp.Upright(0.1), Low(0.9)])
def test_nodes_edges_and_answers_keep_constraints(task, asked):
    roadmap = gp.Roadmap.build(task.scene, nodes=60, seed=3, constraints=[asked])
    assert len(roadmap) == 60
    t = np.linspace(0.0, 1.0, 60)[:, None, None]
    for q in (roadmap.q, roadmap.q[roadmap.edges.tail] * (1.0 - t) + roadmap.q[roadmap.edges.head] * t):
        assert np.all(asked.residual(gp.StateBatch(task.scene, q.reshape(-1, 7))) <= 0.0)
    answer = roadmap.query(task.start, task.goal)
    assert answer.status is QueryStatus.FOUND
    drawn = np.random.default_rng(1).uniform(*task.scene.limits.position.T, (500, 7))
    drawn = drawn[compile_scene(task.scene).kernels.free(drawn, MARGIN)]
    tilted = drawn[asked.residual(gp.StateBatch(task.scene, drawn)) > 0.0][0]
    refused = roadmap.query(tilted, task.goal)
    assert refused.status is QueryStatus.INVALID_START and asked.name in refused.detail


def test_roadmaps_keep_the_constraints_of_plans():
    coffee = gp.load_scene("desk").tasks["lift_coffee"]
    ends = [(coffee.start, coffee.goal)]
    kept, free = (gp.Roadmap.build(coffee.scene, motions=ends, nodes=60, constraints=asked) for asked in (None, []))
    assert max(_tilts(kept)) < np.radians(40.0) < max(_tilts(free))


def _tilts(roadmap: gp.Roadmap) -> np.ndarray:
    """Return the tilt of the carried object in each node [rad]."""
    scene = roadmap.scene
    poses = gp.StateBatch(scene, roadmap.q).tool_poses @ scene.carried.X_TO
    return np.arccos(np.clip(poses[:, 2, 2], -1.0, 1.0))


def test_a_wall_without_a_way_around():
    roadmap = gp.Roadmap.build(gantry(wall=1.2), nodes=80, motions=[([-0.8, 0.0], [0.8, 0.0])])
    assert len(roadmap) == 80
    result = roadmap.query([-0.8, 0.0], [0.8, 0.0])
    assert result.status is QueryStatus.NOT_CONNECTED
    assert result.path is None and result.cost.total == np.inf
    assert roadmap.front([-0.8, 0.0], [0.8, 0.0]) == []
    assert roadmap.query([-0.8, 0.0], [-0.3, 0.5]).status is QueryStatus.FOUND


def test_a_wall_with_a_way_around_and_a_vase_beside_it():
    ends = [-0.8, 0.4], [0.8, 0.4]
    roadmap = gp.Roadmap.build(gantry(vase=5.0), nodes=400, motions=[ends])
    short = roadmap.query(*ends, w=0.0)
    taut = 2.0 * (np.hypot(0.8 - 0.1, 0.15) + 0.1)  # around the wall's upper end, at the distance of the moving box
    assert 0.95 * taut < short.cost.motion < 1.15 * taut
    safe = roadmap.query(*ends, w=20.0)
    assert 0.0 <= safe.cost.impact < 0.5 * short.cost.impact


@pytest.mark.parametrize(
    ("ask", "error"),
    [
        (lambda r, t: r.query(t.start * np.nan, t.goal), NonFiniteError),
        (lambda r, t: r.query(t.start, t.goal[0] * np.inf), NonFiniteError),
        (lambda r, t: r.query(t.start[:3], t.goal), ShapeError),
        (lambda r, t: r.query("nowhere", t.goal), UnknownNameError),
        (lambda r, t: r.query(t.start, t.goal, w=-1.0), SettingError),
        (lambda r, t: r.query(t.start, t.goal, w=np.nan), SettingError),
        (lambda r, t: r.query(t.start, t.goal, severity={"unicorn": 1.0}), UnknownNameError),
        (lambda r, t: r.query(t.start, t.goal, severity={"child": -1.0}), SettingError),
        (lambda r, t: r.query(t.start, t.goal, gp.load_scene("desk")), SettingError),
        (lambda r, t: r.query(t.start, t.goal, t.world), SettingError),
        (lambda r, t: r.query(t.start, t.goal, gp.load_scene("tabletop_l1").tasks[t.name].scene), SettingError),
        (lambda r, t: r.query(t.start, t.goal, t.scene.add_box("crate", [0.05] * 3, [0.6, 0.6, 0.05])), SettingError),
        (lambda r, t: r.front(t.start, t.goal, epsilon=-1.0), SettingError),
        (lambda r, t: r.front(t.start, t.goal, max_points=0), SettingError),
        (lambda r, t: gp.Roadmap.build(t.scene, nodes=0), SettingError),
        (lambda r, t: gp.Roadmap.build(t.scene, neighbours=0), SettingError),
        (lambda r, t: gp.Roadmap.build(t.scene, neighbours=1001), SettingError),
        (lambda r, t: gp.Roadmap.build(t.scene, nodes=10**400), SettingError),
        (lambda r, t: gp.Roadmap.build(t.scene, seed=-1), SettingError),
        (lambda r, t: gp.Roadmap.build(t.scene, time_limit=-1.0), SettingError),
        (lambda r, t: gp.Roadmap.build(t.scene, motions=[(t.start[:2], t.goal)]), ShapeError),
        (lambda r, t: gp.Roadmap.build(t.scene, objective=gp.Objective(exposure="waypoints")), SettingError),
    ],
)
def test_misuse_is_refused(task, roadmap, ask, error):
    with pytest.raises(error):
        ask(roadmap, task)


# --- fronts -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("epsilon", [0.0, 0.01, 0.3])
def test_fronts_go_down(task, roadmap, epsilon):
    front = roadmap.front(task.start, task.goal, epsilon=epsilon)
    assert len(front) >= (3 if epsilon < 0.1 else 2)
    motion, impact = (np.array([getattr(p, name) for p in front]) for name in ("motion", "impact"))
    assert (np.diff(motion) > 0.0).all() and (np.diff(impact) < 0.0).all()
    for point in front:
        np.testing.assert_array_equal(point.q[0], task.start)
        assert (point.q[-1] == task.goal).all(axis=1).any()
        cost = gp.evaluate(point.q, task.scene)
        assert (point.motion, point.impact) == (pytest.approx(cost.motion), pytest.approx(cost.impact))
    kernels = compile_scene(task.scene).kernels
    assert all(kernels.edges_free(p.q[:-1], p.q[1:], FINE_STEP).all() for p in front)


def test_a_front_of_few_points_keeps_its_ends(task, roadmap):
    every = roadmap.front(task.start, task.goal, epsilon=0.0)
    few = roadmap.front(task.start, task.goal, epsilon=0.0, max_points=3)
    assert len(few) == 3 < len(every)
    assert (few[0].motion, few[-1].impact) == (every[0].motion, every[-1].impact)
    assert [p.motion for p in few] == sorted(p.motion for p in few)


# --- custom costs, and moving entities --------------------------------------------------------------------------------


@dataclass(frozen=True)
class Height(gp.Cost):
    """Impact that grows with the first joint."""

    scale: float = 1.0

    def state(self, batch: gp.StateBatch) -> np.ndarray:
        return self.scale * np.abs(batch.q[:, 0])


def test_a_custom_cost():
    scene, objective = gantry(), gp.Objective(impact=Height(2.0))
    roadmap = gp.Roadmap.build(scene, objective=objective, nodes=60, motions=[([-0.8, 0.0], [0.8, 0.0])])
    result = roadmap.query([-0.8, 0.0], [0.8, 0.0])
    assert result.cost.total == pytest.approx(gp.evaluate(result.path, scene, objective).total)
    with pytest.raises(SettingError, match="severities"):
        roadmap.query([-0.8, 0.0], [0.8, 0.0], severity={"vase": 1.0})
    with pytest.raises(NonFiniteCostError):
        gp.Roadmap.build(scene, objective=gp.Objective(impact=Height(np.nan)), nodes=30)


@pytest.mark.parametrize("exposure", ["length", "time"])
def test_entities_that_move_count(task, exposure):
    place = task.scene.data_at(0.5 * (task.start + task.goal[0])).site(task.scene.tool).xpos
    walker = gp.MovingEntity(
        "walker", "adult", size=[0.3, 0.5], t=[0.0, 1.0], position=[place - [0, 0.1, 0.3], place + [0, 0.1, -0.3]]
    )
    scene = task.scene.with_moving(walker)
    objective = gp.Objective(exposure=exposure)
    roadmap = gp.Roadmap.build(scene, objective=objective, nodes=40)
    result = roadmap.query(task.start, task.goal)
    expected = gp.evaluate(result.path, scene, objective)
    assert expected.impact_by_entity["walker"] > 0.0
    assert result.cost.impact_by_entity == pytest.approx(expected.impact_by_entity)
    other = scene.with_moving(gp.MovingEntity("walker", "adult", size=[0.3, 0.5], t=[0.0], position=[place]))
    with pytest.raises(SettingError, match="the roadmap's scene"):
        roadmap.query(task.start, task.goal, other)


def test_removed_moving_entities_do_not_count(task):
    place = task.scene.data_at(0.5 * (task.start + task.goal[0])).site(task.scene.tool).xpos
    walker = gp.MovingEntity("walker", "adult", size=[0.3, 0.3], t=[0.0], position=[place - [0.0, 0.0, 0.4]])
    scene = task.scene.with_moving(walker)
    roadmap = gp.Roadmap.build(scene, nodes=60)
    result = roadmap.query(task.start, task.goal, task.scene)
    assert result.cost.impact_by_entity["walker"] == 0.0
    assert result.cost.impact == pytest.approx(gp.evaluate(result.path, task.scene).impact)
    with pytest.raises(SettingError, match="the roadmap's scene"):
        gp.Roadmap.build(task.scene, nodes=10).query(task.start, task.goal, scene)


def test_nothing_carried_means_no_impact(task):
    roadmap = gp.Roadmap.build(task.world, nodes=40)
    result = roadmap.query(task.start, task.goal[0])
    assert result.status in (QueryStatus.FOUND, QueryStatus.INVALID_START, QueryStatus.INVALID_GOAL)
    assert len(roadmap.edges) > 0 and roadmap.edges.prices.impact(roadmap.severity()).max() == 0.0
