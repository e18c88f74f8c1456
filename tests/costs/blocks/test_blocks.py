"""Cost blocks: against oracles, gradients, sums, and evaluation in the core."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.costs.objective import search_paces
from graceful_plan.exceptions import CostError, SettingError, ShapeError, UnknownNameError
from graceful_plan.scene.pose_goal import pose_error
from graceful_plan.testing import ContractError, check_cost
from graceful_plan.timing.dynamics import RobotDynamics
from support.costs.own_costs import Bowl

Array = np.ndarray
STEP = 1e-3
_TOLERANCE = 5e-3  # central differences of single-precision clearances; the nearest pair may change within a step


@pytest.fixture(scope="module")
def task() -> gp.Task:
    return gp.load_scene("desk").tasks["bring_coffee"]


@pytest.fixture(scope="module")
def scene(task: gp.Task) -> gp.Scene:
    return task.scene


def goal(scene: gp.Scene, *, free_yaw: bool = False) -> gp.PoseGoal:
    return gp.PoseGoal.from_tool(
        scene.limits.position.mean(axis=1), scene, rotation=np.array([0.3, -0.5, 1.0]), free_yaw=free_yaw
    )


BLOCKS: dict[str, Callable[[gp.Scene], gp.Cost]] = {
    "surroundings": lambda scene: gp.ClearanceCost(0.15),
    "self": lambda scene: gp.ClearanceCost(0.1, to="self"),
    "entity": lambda scene: gp.ClearanceCost(0.4, to="laptop"),
    "pose": lambda scene: gp.costs.PoseCost(goal(scene)),
    "axis": lambda scene: gp.costs.PoseCost(goal(scene, free_yaw=True), distance=None),
    "middle": lambda scene: gp.costs.JointCost(),
    "posture": lambda scene: gp.costs.JointCost(centre=(0.1,) * 7, scale=(0.5, 1.0, 1.0, 2.0, 1.0, 1.0, 3.0)),
    "energy": lambda scene: gp.costs.EnergyCost((90.0, 90.0, 90.0, 90.0, 12.0, 12.0, 12.0)),
    "manipulability": lambda scene: gp.costs.ManipulabilityCost(0.12),
    "sum": lambda scene: 2.0 * gp.ClearanceCost(0.2) + 0.5 * (gp.costs.JointCost() + gp.costs.ManipulabilityCost()),
    "with the impact": lambda scene: gp.ImpactCost() + 0.3 * gp.ClearanceCost(0.2),
}
each = pytest.mark.parametrize("block", BLOCKS)


def states(scene: gp.Scene, n: int, seed: int = 0) -> Array:
    lower, upper = scene.limits.position.T
    return np.random.default_rng(seed).uniform(lower, upper, (n, len(lower)))


def values(cost: gp.Cost, scene: gp.Scene, q: Array) -> Array:
    return cost.state(gp.StateBatch(scene, q))


@each
def test_blocks_keep_the_contract_of_costs_with_gradients(scene: gp.Scene, block: str) -> None:
    cost = BLOCKS[block](scene)
    assert cost.gradient(gp.StateBatch(scene, states(scene, 3))) is not None
    check_cost(cost, scene)


@each
@pytest.mark.parametrize("exposure", ["time", "length"])
def test_the_core_charges_edges_as_python_does(scene: gp.Scene, block: str, exposure: str) -> None:
    cost = BLOCKS[block](scene)
    native = gp.Objective(impact=cost, exposure=exposure).bind(scene, search_paces())
    asked = gp.Objective(impact=Told(cost), exposure=exposure).bind(scene, search_paces())
    assert native.kernel is not None and asked.kernel is None
    q0 = states(scene, 20)
    q1 = q0 + 0.1 * np.random.default_rng(1).normal(size=q0.shape)
    rough = 2e-3 if block == "with the impact" else 1e-6  # the error of the drop kernel alone
    np.testing.assert_allclose(native.edges(q0, q1), asked.edges(q0, q1), rtol=rough, atol=1e-6)


@pytest.mark.parametrize("block", [name for name in BLOCKS if name != "with the impact"])
def test_slopes_of_edges_equal_differences(scene: gp.Scene, block: str) -> None:
    bound = gp.Objective(impact=BLOCKS[block](scene), w=1.0, exposure="length").bind(scene)
    q0 = states(scene, 40)
    q1 = q0 + 0.05 * np.random.default_rng(1).normal(size=q0.shape)
    found = bound.edge_gradients(q0, q1, step=1.0)
    assert found is not None
    for j, e in enumerate(STEP * np.eye(q0.shape[1])):
        for end in (0, 1):
            sides = [bound.edge_gradients(q0 + (s if end == 0 else 0), q1 + (s if end else 0), 1.0) for s in (e, -e)]
            up, down = (side[0].sum(axis=1) for side in sides if side is not None)
            wanted = (up - down) / (2.0 * STEP)
            error = np.abs(found[1 + end][:, j] - wanted) / max(1.0, np.abs(wanted).max())
            assert np.mean(error < _TOLERANCE) > 0.9, np.sort(error)[-6:]


def test_clearance_costs_only_below_the_distance(scene: gp.Scene) -> None:
    q = states(scene, 200)
    nearest = 9.0 * (
        1.0 - np.maximum(values(gp.ClearanceCost(9.0), scene, q), values(gp.ClearanceCost(9.0, "self"), scene, q))
    )
    np.testing.assert_allclose(nearest, gp.StateBatch(scene, q).clearance, atol=1e-5)
    assert (values(gp.ClearanceCost(9.0, "laptop"), scene, q) <= values(gp.ClearanceCost(9.0), scene, q) + 1e-6).all()
    near, far = values(gp.ClearanceCost(0.05), scene, q), 9.0 * (1.0 - values(gp.ClearanceCost(9.0), scene, q))
    np.testing.assert_allclose(near, np.maximum(0.0, 1.0 - far / 0.05), atol=1e-4)
    assert (near == 0.0).any() and (near > 0.0).any()


def test_manipulability_equals_that_of_mujocos_jacobian(scene: gp.Scene) -> None:
    q, cost = states(scene, 30), gp.costs.ManipulabilityCost(least=10.0)
    site = scene.model.site(scene.tool).id
    dofs = [int(scene.model.jnt_dofadr[scene.model.joint(name).id]) for name in scene.joints]
    for row, value in zip(q, values(cost, scene, q), strict=True):
        data, J = scene.data_at(row), np.zeros((6, scene.model.nv))
        mujoco.mj_comPos(scene.model, data)
        mujoco.mj_jacSite(scene.model, data, J[:3], J[3:], site)
        J = J[:, dofs]
        assert (1.0 - np.sqrt(value)) * 10.0 == pytest.approx(np.sqrt(max(0.0, np.linalg.det(J @ J.T))), abs=1e-6)


def test_energy_equals_that_of_torques_by_mujoco(scene: gp.Scene) -> None:
    q, at_rest, limit = states(scene, 20), np.zeros(7), np.arange(10.0, 80.0, 10.0)
    dynamics = RobotDynamics(scene)
    expected = [np.mean((dynamics(row, at_rest, at_rest) / limit) ** 2) for row in q]
    np.testing.assert_allclose(values(gp.costs.EnergyCost(tuple(limit.tolist())), scene, q), expected, rtol=1e-4)


@pytest.mark.parametrize("free_yaw", [False, True])
def test_a_pose_costs_distance_and_angle(scene: gp.Scene, free_yaw: bool) -> None:
    q, wanted = states(scene, 30), goal(scene, free_yaw=free_yaw)
    away = [pose_error(wanted, X) for X in gp.StateBatch(scene, q).tool_poses]
    charged = [(d / 0.2) ** 2 + 2.0 * (1.0 - np.cos(a)) / 0.7**2 for d, a in away]
    np.testing.assert_allclose(values(gp.costs.PoseCost(wanted, 0.2, 0.7), scene, q), charged, rtol=1e-6, atol=1e-9)


def test_the_middle_of_the_joints_costs_nothing_and_their_limits_one(scene: gp.Scene) -> None:
    limits = scene.limits.position
    np.testing.assert_allclose(
        values(gp.costs.JointCost(), scene, np.stack([limits.mean(axis=1), *limits.T])), [0, 1, 1]
    )


def test_sums_are_sums(scene: gp.Scene) -> None:
    batch = gp.StateBatch(scene, states(scene, 10))
    a, b = gp.costs.JointCost(), Bowl(told=True)
    np.testing.assert_allclose((2.0 * a + b * 3.0).state(batch), 2.0 * a.state(batch) + 3.0 * b.state(batch))
    assert (a + b).gradient(batch) is not None and (a + Bowl(told=False)).gradient(batch) is None
    assert 2.0 * (a + 3.0 * b) == 2.0 * a + 6.0 * b and hash(a + b) == hash(a + b)
    native, mixed = (gp.Objective(impact=cost).bind(scene).kernel for cost in (a + a, a + b))
    assert native is not None and mixed is None
    with pytest.raises(TypeError):
        _ = a + 1.0  # pyright: ignore[reportOperatorIssue]


def test_a_broken_term_is_named(scene: gp.Scene) -> None:
    with pytest.raises(CostError, match="Broken"):
        values(gp.costs.JointCost() + Broken(), scene, states(scene, 3))


class Broken(gp.Cost):
    """Returns an array of the wrong length."""

    def state(self, batch: gp.StateBatch) -> Array:
        """Return one value too many."""
        return np.ones(len(batch) + 1)


class Told(gp.Cost):
    """Hides the type of the wrapped cost, so planners call it through Python."""

    def __init__(self, held: gp.Cost) -> None:
        self.held = held

    def state(self, batch: gp.StateBatch) -> Array:
        """Return the cost of the wrapped cost."""
        return self.held.state(batch)


@pytest.mark.parametrize("step", [1e-5, 1e-2])
def test_wrong_gradients_are_found_beside_kinks_and_rounding(scene: gp.Scene, step: float) -> None:
    class Wrong(Told):
        def gradient(self, batch: gp.StateBatch) -> Array:
            found = self.held.gradient(batch)
            assert found is not None
            return found * (1.0 + 10.0 * step) if step > 1e-3 else found

    cost = Wrong(gp.ClearanceCost(0.3))
    if step < 1e-3:
        return check_cost(cost, scene)
    with pytest.raises(ContractError, match="central differences"):
        check_cost(cost, scene)
    return None


@pytest.mark.long
def test_planning_stays_in_the_core(task: gp.Task) -> None:
    objective = gp.Objective(impact=gp.ClearanceCost(0.1) + 0.1 * gp.costs.JointCost(), w=2.0, exposure="length")
    plain = gp.plan(task.start, task.goal, task.scene, w=0.0, iterations=200)
    found = gp.plan(task.start, task.goal, task.scene, objective=objective, iterations=200)
    assert found.status is gp.PlanStatus.SOLVED and "estimated_total" in found.stats
    assert found.cost.total < gp.evaluate(plain.trajectory, task.scene, objective).total


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: gp.ClearanceCost(0.0), "distance = 0.0, expected a finite number > 0"),
        (lambda: gp.costs.ManipulabilityCost(np.inf), "least = inf"),
        (lambda: gp.costs.JointCost(centre=(np.nan,)), "centre"),
        (lambda: gp.costs.EnergyCost((0.0,)), "torque"),
        (lambda: gp.costs.JointCost(scale=-1.0), "scale = -1.0"),
        (lambda: gp.costs.JointCost(scale=(1.0, 0.0)), "scale"),
        (lambda: gp.costs.PoseCost(gp.PoseGoal(np.eye(4)), None, None), "distance = None"),
        (lambda: gp.costs.PoseCost(gp.PoseGoal(np.eye(4)), 0.1, 0.0), "angle = 0.0"),
        (lambda: -1.0 * gp.costs.JointCost(), "factor = -1.0, expected a finite number >= 0 before JointCost"),
    ],
)
def test_settings_are_checked(make: Callable[[], gp.Cost], message: str) -> None:
    with pytest.raises(SettingError, match=message):
        make()


def test_settings_that_do_not_fit_a_scene_are_named(scene: gp.Scene) -> None:
    with pytest.raises(UnknownNameError, match=r"'lamp'.*laptop.*self, stapler, surround"):
        values(gp.ClearanceCost(to="lamp"), scene, states(scene, 1))
    with pytest.raises(ShapeError, match=r"EnergyCost\.torque.*\(2,\)"):
        values(gp.costs.EnergyCost((1.0, 1.0)), scene, states(scene, 1))
    with pytest.raises(ShapeError, match=r"JointCost\.centre has shape"):
        values(gp.costs.JointCost(centre=(0.0, 1.0)), scene, states(scene, 1))


def test_kernels_of_named_impacts_are_cached_by_scene_and_pace(scene: gp.Scene) -> None:
    def kernel(of: gp.Scene, cost: gp.ImpactCost, paces: tuple[float, float] = search_paces()) -> object:
        return gp.Objective(impact=cost, exposure="length").bind(of, paces).kernel

    first = kernel(scene, gp.ImpactCost())
    assert kernel(scene, gp.ImpactCost()) is first
    others = [kernel(scene, gp.ImpactCost(), (0.5, 0.5)), kernel(scene, gp.ImpactCost(own_loss=False))]
    severe = scene.with_severity({"laptop": 1000.0})
    assert all(other is not first for other in [*others, kernel(severe, gp.ImpactCost())])
