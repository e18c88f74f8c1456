"""The arm moves with the base: against an exhaustive dynamic program, and as motions of the front door."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.constraints.scene_constraints import SceneConstraints
from graceful_plan.costs.objective import search_paces
from graceful_plan.mobile.motions.drive_curve import Drive, Roll, Straight, connected
from graceful_plan.mobile.motions.moving_curve import MovingCurve
from graceful_plan.mobile.motions.posture_program import Stations, chosen, nearest
from graceful_plan.mobile.motions.reposed import _TakenApart, reposed
from graceful_plan.mobile.motions.smoothing import Smoother
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.timing.bspline import basis
from hall import BASE, hall

# Beside the pillar's south side, where the person is not; the arm sticks out 0.5 m.
SCENE = hall(arm=True)
REST = [0.0]


def smoother(w: float = 0.3) -> Smoother:
    objective = gp.Objective(w=w).bind(SCENE, search_paces())
    return Smoother(objective=objective, base=BASE, clearance=problem().clearance_gradient, time_price=0.2, speed=1.0)


def problem() -> SceneProblem:
    held = SceneConstraints(SCENE, [])
    start = np.array([-4.0, -1.2, 0.0, 0.0])
    return SceneProblem(kernels=held.kernels, start=start, goals=start[None], constraints=held, margin=0.002)


def roll(end: float = 0.0) -> Roll:
    x = np.linspace(-4.0, 4.0, 12)
    controls = np.column_stack([x, np.full(12, -1.2)])
    return Roll(controls, np.array([-4.0, -1.2, 0.0, 0.0]), np.array([4.0, -1.2, 0.0, end]), forward=True)


def stations(n: int) -> Stations:
    x = np.linspace(-4.0, 4.0, n)
    base = np.column_stack([x, np.full(n, -1.2), np.zeros(n)])
    aside = np.arange(n) % (n - 1) > 0
    return Stations(base, np.ones(n), np.where(aside, 1.5, 0.0), np.zeros(n), aside)


def test_the_program_is_as_good_as_trying_everything():
    along, offsets, postures = stations(5), np.array([0.0, 0.3]), np.array([[0.0], [-0.6], [0.5]])
    what, of = smoother(), problem()
    room = what.room(np.stack([of.start, of.start]), moves_arm=True)
    best = chosen(along, offsets, postures, (0, 0), room, (what, of))
    assert best is not None
    # Each way along the stations alone: one offset and one posture at each of them, all others left out.
    values = []
    for ways in product(range(2), range(3), repeat=3):
        o, p = ways[::2], ways[1::2]
        line = Stations(
            along.base + np.array([[0, of_, 0] for of_ in (0.0, *offsets[list(o)], 0.0)]),
            along.forward,
            along.speed,
            along.rate,
            np.zeros(5, dtype=bool),
        )
        values.append(_value(line, postures[[0, *p, 0]], what, of, room))
    assert best.value == pytest.approx(min(values), rel=1e-9)


def _value(line: Stations, arms: np.ndarray, what: Smoother, of: SceneProblem, room: object) -> float:
    """Charge one way along stations, step by step, with none of the program's arrays."""
    total, price = 0.0, []
    for k in range(len(line)):
        q, qd = np.array([[*line.base[k], *arms[k]]]), np.zeros((1, 4))
        qd[0, :3] = line.velocity()[k]
        if not of.states_free(q)[0]:
            return np.inf
        harm = what.objective.w * float(what.objective.quick_states(q, qd)[0])
        price.append(what.time_price + harm + line.speed[k] * float(room.charge(what.clearance(q)[0])[0]))
    for k in range(1, len(line)):
        metres, arm = np.linalg.norm(np.diff(line.base[k - 1 : k + 1, :2], axis=0)), abs(arms[k, 0] - arms[k - 1, 0])
        seconds = max(metres / (0.5 * (line.speed[k] + line.speed[k - 1])), arm / 1.5)
        total += np.hypot(metres, arm) + 0.5 * seconds * (price[k] + price[k - 1])
    return float(total)


def test_drives_are_within_two_percent_of_an_exhaustive_program():
    """All offsets and postures of a fine grid at every station; ours has the few that it drew, and its descent."""
    what, of = smoother(1.0), problem()
    drive = Drive((roll(), Straight(roll().end, np.array([4.0, -1.2, 0.0, -0.9]))))
    line = _TakenApart.of(drive)
    assert line is not None
    offsets, postures = np.linspace(-0.6, 0.6, 13), np.linspace(-1.5, 1.5, 61)[:, None]
    ends = nearest(postures, line.known[0]), nearest(postures, line.known[-1])
    room = what.room(np.stack([line.start, line.end]), moves_arm=True)
    best = chosen(line.stations(what), offsets, postures, ends, room, (what, of))
    assert best is not None
    (found,) = reposed(drive, what, of, Budget(iterations=10_000), np.random.default_rng(0))
    ours, exhaustive, before = (_cost(one, what) for one in (found, connected(line.along(best)), drive))
    assert ours <= 1.02 * exhaustive and ours < before


def _cost(drive: Drive, what: Smoother) -> float:
    held = SceneConstraints(SCENE, [])
    trajectory = held.timed(drive)
    return what.objective.breakdown(trajectory).total + what.time_price * trajectory.duration


def test_slopes_of_a_curve_are_those_of_its_charge():
    what, rng = smoother(1.0), np.random.default_rng(3)
    controls = np.column_stack([roll().controls, 0.2 * rng.normal(size=12)])
    controls[[0, -1], 2] = 0.0
    moving = MovingCurve(Roll(controls, roll().begin, roll().end, forward=True), SCENE.limits.position)
    room = what.room(np.stack([roll().begin, roll().end]), moves_arm=True)
    x = moving.first + 0.01 * rng.normal(size=len(moving.first))
    slope = what._slope(moving, x, room)
    nudges = 1e-4 * np.eye(len(x))
    values = what._values(moving, np.concatenate([x + nudges, x - nudges]), room).reshape(2, -1)
    np.testing.assert_allclose(slope, (values[0] - values[1]) / 2e-4, atol=2e-2 * np.abs(slope).max())


def test_an_arm_moves_along_its_own_spline_and_stays_within_limits():
    controls = np.column_stack([roll().controls, np.linspace(0.0, 1.2, 12)])
    curve = Roll(controls, roll().begin, roll(1.2).end, forward=True)
    u, (q, first, _) = curve.samples(1)
    np.testing.assert_allclose(q[:, 3], basis(12, tuple(u.tolist()))[0] @ controls[:, 2], atol=1e-12)
    np.testing.assert_allclose(np.gradient(q[10:-10, 3], u[10:-10])[5:-5], first[15:-15, 3], atol=5e-3)
    moved = MovingCurve(curve, SCENE.limits.position)
    far = moved.controls(moved.first[None] + 100.0)[0]
    assert far[:, 2].max() <= SCENE.limits.position[3, 1] + 1e-12 and far[-1, 2] == 1.2


def test_where_the_arm_had_to_move_while_the_base_stood_it_moves_before():
    drive = Drive((roll(), Straight(roll().end, np.array([4.0, -1.2, 0.0, -0.9]))))
    (found,) = reposed(drive, smoother(0.0), problem(), Budget(iterations=10_000), np.random.default_rng(0))
    q = found.grid(1).q
    np.testing.assert_allclose(q[[0, -1]], [[-4.0, -1.2, 0.0, 0.0], [4.0, -1.2, 0.0, -0.9]], atol=1e-9)
    moving = np.abs(np.diff(q[:, 3])) > 1e-6
    assert (np.linalg.norm(np.diff(q[:, :2], axis=0), axis=1)[moving] > 0.0).all()


def test_drives_that_stand_or_have_no_arm_are_left_alone():
    standing = Drive((Straight(roll().end, np.array([4.0, -1.2, 0.0, -0.9])),))
    means = smoother(), problem(), Budget(iterations=10), np.random.default_rng(0)
    assert list(reposed(standing, *means)) == []


def test_postures_are_found_among_themselves():
    postures = np.array([[0.0, 1.0], [0.5, 0.5], [1.0, 0.0]])
    assert [nearest(postures, arm) for arm in postures] == [0, 1, 2]


@pytest.mark.long
def test_base_and_arm_move_at_once_and_the_judge_agrees():
    goal = [4.0, -1.2, 0.0, -0.9]
    both, apart = (
        gp.plan(
            [-4.0, -1.2, 0.0, 0.0],
            goal,
            SCENE,
            iterations=1_000_000,
            planner=gp.DriveLattice(cells=(0.4,), moves_arm=moves),
        )
        for moves in (True, False)
    )
    assert both.status is apart.status is gp.PlanStatus.SOLVED
    assert gp.verify(both.trajectory, SCENE, goal=goal).passed
    assert both.trajectory.duration < apart.trajectory.duration - 0.3
    assert both.cost.total < apart.cost.total
