"""Many poses at once: every solution reaches its pose and is free, and reachable poses are found."""

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.judge.exact import exactly_free
from graceful_plan.query.endpoints.goals import resolve_goal
from graceful_plan.query.endpoints.pose_sets import reach_poses
from graceful_plan.query.endpoints.travel import Travel
from graceful_plan.scene.placement import Placement
from graceful_plan.scene.pose_goal import PoseGoal, pose_error
from graceful_plan.scene.scene import Scene

_CELL = """<mujoco model="cell"><worldbody>
  <body name="cell">{walls}</body>
  <body name="cart/x"><joint name="cart/x" type="slide" axis="1 0 0" range="-1 1"/>
    <joint name="cart/y" type="slide" axis="0 1 0" range="-1 1"/>
    <joint name="cart/z" type="slide" axis="0 0 1" range="-1 1"/>
    <geom type="sphere" size=".05" mass="1"/><site name="cart/tool"/></body>
</worldbody></mujoco>"""


@pytest.fixture(scope="module")
def scene(scene: Scene) -> Scene:
    return scene.tasks["lift_to_goal"].scene


@pytest.fixture(scope="module")
def start(scene: Scene) -> np.ndarray:
    return np.asarray(scene.tasks["lift_to_goal"].start)


def _error(goal: PoseGoal, q: np.ndarray, scene: Scene) -> tuple[float, float]:
    site, X = Placement(scene).place(q).site(scene.tool), np.eye(4)
    X[:3, :3], X[:3, 3] = site.xmat.reshape(3, 3), site.xpos
    return pose_error(goal, X)


def _around(scene: Scene, start: np.ndarray, n: int, **given: bool) -> list[PoseGoal]:
    """Return poses around the tool: some are in the table, some out of reach."""
    rng, tip = np.random.default_rng(0), PoseGoal.from_tool(start, scene).X_WT[:3, 3]
    return [
        PoseGoal.at(tip + rng.normal(0.0, 0.3, 3), np.array([0.0, 1.0, 0.0, 0.0]) + rng.normal(0.0, 0.3, 4), **given)
        for _ in range(n)
    ]


@pytest.mark.parametrize("free_yaw", [False, True])
def test_solutions_are_at_their_poses_and_free(scene: Scene, start: np.ndarray, free_yaw: bool) -> None:
    goals = _around(scene, start, 100, free_yaw=free_yaw)
    found = reach_poses(goals, scene, Travel(start))
    assert 10 < len(found.index) < 100 and (np.diff(found.index) > 0).all()
    lower, upper = scene.limits.position.T
    assert ((found.q >= lower) & (found.q <= upper)).all() and exactly_free(found.q, scene).all()
    turned = []
    for q, k in zip(found.q, found.index, strict=True):
        distance, angle = _error(goals[k], q, scene)
        assert distance <= goals[k].position_tolerance and angle <= goals[k].orientation_tolerance
        turned.append(_error(PoseGoal(goals[k].X_WT), q, scene)[1])
    assert (max(turned) > 0.1) is free_yaw
    again = reach_poses(goals, scene, Travel(start))
    np.testing.assert_array_equal(again.q, found.q)


def test_hardly_any_is_missed_that_is_found_one_by_one(scene: Scene, start: np.ndarray) -> None:
    goals = _around(scene, start, 24)
    alone = {k for k, goal in enumerate(goals) if len(resolve_goal(goal, scene, start).q)}
    together = set(reach_poses(goals, scene, Travel(start)).index.tolist())
    assert 5 < len(alone) < 20
    assert len(alone - together) <= 0.2 * len(alone)


def test_solving_can_be_cancelled(scene: Scene, start: np.ndarray) -> None:
    goals = _around(scene, start, 200)
    assert len(reach_poses(goals, scene, Travel(start), cancelled=lambda: True).index) == 0
    some, every = (reach_poses(goals, scene, Travel(start), hurried=lambda now=now: now).index for now in (True, False))
    assert 0 < len(some) < len(every) and set(some) <= set(every)
    assert len(reach_poses([PoseGoal.at([3.0, 0.0, 0.5])] * 10, scene, Travel(start), hurried=lambda: True).index) == 0


def test_the_only_reachable_pose_is_found(scene: Scene, start: np.ndarray) -> None:
    rng, tip = np.random.default_rng(0), PoseGoal.from_tool(start, scene).X_WT[:3, 3]
    goals = [PoseGoal.at([0.55, 0.0, -0.25] + rng.normal(0.0, 0.02, 3), rng.normal(size=4)) for _ in range(300)]
    goals[217] = PoseGoal.at(tip + [0.0, 0.1, 0.05], [0.0, 1.0, 0.0, 0.0])
    assert set(resolve_goal(goals, scene, start).index) == {217}
    result = gp.plan(start, goals, scene, w=0.0, iterations=50)
    assert (result.status, result.goal_index) == (gp.PlanStatus.SOLVED, 217)
    # If the batch reached no pose, each is tried singly and reported with its reason.
    nothing = resolve_goal(goals[:9], scene, start)
    assert not nothing.index and len(nothing.problems) == 9


def test_the_one_outside_of_a_closed_cell_is_found() -> None:
    """All others are nearer, free and within the limits, but no path leads to them."""
    sides = [(axis, sign) for axis in range(3) for sign in (-0.28, 0.28)]
    size, place = np.full((6, 3), 0.3), np.zeros((6, 3))
    for k, (axis, sign) in enumerate(sides):
        size[k, axis], place[k, axis] = 0.02, sign
    walls = "".join(
        f'<geom type="box" size="{" ".join(map(str, s))}" pos="{" ".join(map(str, p))}"/>'
        for s, p in zip(size, place, strict=True)
    )
    cell = Scene.from_mjcf(
        _CELL.format(walls=walls),
        robot="cart/",
        tool="cart/tool",
        entities={"cell": "robust"},
        velocity=[1.0] * 3,
        acceleration=[2.0] * 3,
    )
    inside = np.random.default_rng(0).uniform(-0.15, 0.15, (99, 3))
    goals = [PoseGoal.at(p) for p in (*inside, [0.9, 0.1, 0.1])]
    start = [-0.5, 0.0, 0.0]
    assert set(reach_poses(goals, cell, Travel(np.array(start))).index) == set(range(100))
    result = gp.plan(start, goals, cell, w=0.0, iterations=2000)
    assert (result.status, result.goal_index) == (gp.PlanStatus.SOLVED, 99)
