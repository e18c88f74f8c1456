r"""How fast to go where on a given curve, if the robot may fail on the way: slower where speed does harm.

A failure is as probable in any second as in any other. Going faster leaves less time to fail, but what is let go flies
farther and what swings out of control has more energy. The time-optimal timing asks neither; this one minimises

.. math:: F = \int_0^T (1 + w\, I(q, \dot q))\, dt

the objective J = V + w S with seconds in place of radians, for motion and impact alike: a second under an impact of
1 / w costs as much as two seconds under none. No place is passed faster than by the time-optimal timing, nor slower
than `SLOWEST` of it.

Dynamic programming over a lattice: at every grid point of the curve, levels between `SLOWEST` and 1 of the time-optimal
speed; between neighbouring points, all pairs of levels that keep the acceleration limits. The impact of all points at
all levels is one batch. A second lattice, finer and around the result of the first, takes off its steps. Speeds are
optimal on the lattice, not beyond.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.exceptions import NonFiniteError, SettingError, ShapeError
from graceful_plan.timing.blend import CurveGrid
from graceful_plan.timing.trajectory import Trajectory

Array = np.ndarray

ImpactOfStates = Callable[[Array, Array], Array]
"""Impact of a failure at each of n states (q [n, nq], qd [n, nq]), finite and at least 0."""
SLOWEST = 0.05
"""Least share of the time-optimal speed."""
_LEVELS = 32
"""Speeds of the first lattice, in geometric steps."""
_FINE_LEVELS = 17
"""Speeds of the second, over two steps of the first to either side."""
_MOMENTS = 800
"""Moments of a trajectory at which its cost is sampled."""
_ROUNDING = 1e-7
"""Relative excess of an acceleration over its limit that is rounding."""


def timed_cost(trajectory: Trajectory, impact: ImpactOfStates, w: float) -> float:
    """Return F of a trajectory [s], by the midpoint rule in time."""
    if not trajectory.duration > 0.0:
        return 0.0
    state = trajectory.at(trajectory.t[0] + (np.arange(_MOMENTS) + 0.5) / _MOMENTS * trajectory.duration)
    return trajectory.duration * (1.0 + w * float(checked_impact(impact, state.q, state.qd).mean()))


def checked_impact(impact: ImpactOfStates, q: Float[Array, "n nq"], qd: Float[Array, "n nq"]) -> Float[Array, " n"]:
    """Evaluate an impact and hold it to its contract.

    Raises:
        ShapeError: If it returns anything but one number a state.
        NonFiniteError: If one of them is NaN or infinite.
        SettingError: If one of them is negative.
    """
    value = np.asarray(impact(q, qd), dtype=np.float64)
    if value.shape != (len(q),):
        raise ShapeError("impact(q, qd)", value.shape, f"({len(q)},)")
    bad = np.flatnonzero(~np.isfinite(value))
    if len(bad):
        raise NonFiniteError("impact(q, qd)", (int(bad[0]),))
    if np.any(value < 0.0):
        raise SettingError("impact(q, qd)", float(value.min()), "at least 0")
    return value


def graded(
    grid: CurveGrid,
    fastest: Float[Array, " point"],
    acceleration: Float[Array, " nq"],
    impact: ImpactOfStates,
    w: float,
) -> Float[Array, " point"]:
    """Return path speeds of least F [rad/s], none above `fastest` and all within the acceleration limits.

    Args:
        grid: The curve.
        fastest: Path speeds of the time-optimal timing, zero at stops.
        acceleration: Limits of the joint accelerations [rad/s^2], finite and > 0.
        impact: Impact of a failure.
        w: Safety weight.
    """
    steps = np.geomspace(SLOWEST, 1.0, _LEVELS)
    coarse = np.broadcast_to(steps, (len(fastest), _LEVELS))
    share = _least_cost(grid, fastest, coarse, acceleration, impact, w)
    ratio = steps[1] / steps[0]
    # The middle level is the first result itself, so the second cannot be worse.
    fine = np.clip(share[:, None] * ratio ** np.linspace(-2.0, 2.0, _FINE_LEVELS), SLOWEST, 1.0)
    return fastest * _least_cost(grid, fastest, fine, acceleration, impact, w)


def _least_cost(
    grid: CurveGrid,
    fastest: Float[Array, " point"],
    level: Float[Array, "point level"],
    acceleration: Float[Array, " nq"],
    impact: ImpactOfStates,
    w: float,
) -> Float[Array, " point"]:
    """Return the cheapest level at each point, by dynamic programming from the end to the start."""
    n, count = level.shape
    speed = fastest[:, None] * level
    slope = np.concatenate([grid.slope[:, 0], grid.slope[-1:, 1]])
    qd = (slope[:, None, :] * speed[:, :, None]).reshape(n * count, -1)
    price = 1.0 + w * checked_impact(impact, np.repeat(grid.q, count, axis=0), qd).reshape(n, count)
    step = np.diff(grid.s)
    best = np.zeros(count)
    choice = np.zeros((n - 1, count), dtype=int)
    for i in range(n - 2, -1, -1):
        time = 2.0 * step[i] / np.maximum(speed[i][:, None] + speed[i + 1], 1e-12)
        cost = 0.5 * time * (price[i][:, None] + price[i + 1]) + best
        cost[_excess(grid, i, speed, acceleration) > 1.0 + _ROUNDING] = np.inf
        choice[i] = np.argmin(cost, axis=1)
        best = cost[np.arange(count), choice[i]]
    chosen = np.empty(n, dtype=int)
    chosen[0] = np.argmin(best)
    for i in range(n - 1):
        chosen[i + 1] = choice[i, chosen[i]]
    return level[np.arange(n), chosen]


def _excess(
    grid: CurveGrid, i: int, speed: Float[Array, "point level"], acceleration: Float[Array, " nq"]
) -> Float[Array, "level level"]:
    """Return by what factor the accelerations of all pairs of speeds around an interval reach their limits."""
    before, after = speed[i][:, None] ** 2, speed[i + 1] ** 2
    push = 0.5 * (after - before) / (grid.s[i + 1] - grid.s[i])
    if not grid.bend[i].any():  # a line
        return np.abs(push) * (np.abs(grid.slope[i]) / acceleration).max()
    parts = [
        np.abs(slope * push[:, :, None] + bend * np.broadcast_to(x, push.shape)[:, :, None]) / acceleration
        for slope, bend, x in zip(grid.slope[i], grid.bend[i], (before, after), strict=True)
    ]
    return np.maximum(*parts).max(axis=2)
