r"""Time-optimal path parametrisation by reachability analysis (TOPP-RA): how fast to go where on a given curve.

With the squared path speed :math:`x = \dot s^2` and the path acceleration :math:`u = \ddot s`, constant on each
interval of the grid, every joint acceleration :math:`q' u + q'' x` is linear in (u, x) and
:math:`x_{i+1} = x_i + 2 \Delta_i u_i`. A backward pass finds the largest x from which the end can still be reached at
rest, a forward pass then goes as fast as that allows.

Two implementations. `fastest` is for velocity and acceleration limits that are symmetric, between two rests: standing
still is feasible everywhere, so the controllable sets are [0, beta_i], both passes are a minimum over linear functions,
and no general LP solver is needed (nor the second that importing toppra takes). `fastest_with_toppra` hands the general
problem, with gravity, to toppra.

References:
    H. Pham, Q.-C. Pham, "A New Approach to Time-Optimal Path Parameterization Based on Reachability Analysis",
    IEEE Transactions on Robotics 34 (2018).
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Float
from graceful_plan.exceptions import RetimingError
from graceful_plan.timing.blend import CurveGrid

Array = np.ndarray
_UNBOUNDED = 1e12
"""Stands for an infinite squared path speed; infinity itself would make 0 * inf."""
InverseDynamics = Callable[[Array, Array, Array], Array]
"""Joint torques [N m] of (q, qd, qdd)."""


def fastest(
    grid: CurveGrid, velocity: Float[Array, " nq"], acceleration: Float[Array, " nq"]
) -> Float[Array, " point"]:
    """Compute the time-optimal path speed at each grid point, at rest where the grid says stop.

    Args:
        grid: The curve.
        velocity: Limits of the joint speeds [rad/s], > 0.
        acceleration: Limits of the joint accelerations [rad/s^2], finite and > 0.

    Returns:
        ds/dt [rad/s].
    """
    step = 2.0 * np.diff(grid.s)[:, None]
    # Rows |A u + B x| <= limit of each interval: at its beginning, and at its end, where x + step u holds.
    end_bend = grid.bend[:, 1]
    A = np.concatenate([grid.slope[:, 0], grid.slope[:, 1] + step * end_bend], axis=1)
    B = np.concatenate([grid.bend[:, 0], end_bend], axis=1)
    A = np.where(np.abs(A) < 1e-12, 1e-12, A)
    reach = np.concatenate([acceleration, acceleration]) / np.abs(A)
    tilt = B / A
    # The row allows -reach - tilt x <= u <= reach - tilt x.
    cap = np.minimum(_velocity_cap(grid, velocity), np.append(_row_cap(reach, tilt), _UNBOUNDED))
    cap[grid.stop] = 0.0

    gain = 1.0 - step * tilt
    shrink = np.where(gain > 0.0, 1.0 / np.where(gain > 0.0, gain, 1.0), 0.0)
    slack = np.where(gain > 0.0, step * reach * shrink, _UNBOUNDED)
    push = step * reach
    # Not to undershoot standing still within the interval.
    overturning = np.where(gain < 0.0, push / np.where(gain < 0.0, -gain, 1.0), _UNBOUNDED)
    cap[:-1] = np.minimum(cap[:-1], overturning.min(axis=1))
    controllable = cap.copy()
    for i in range(len(step) - 1, -1, -1):
        controllable[i] = min(cap[i], (shrink[i] * controllable[i + 1] + slack[i]).min())
    x = controllable.copy()
    for i in range(len(step)):
        x[i + 1] = min(controllable[i + 1], (gain[i] * x[i] + push[i]).min())
    return np.sqrt(np.maximum(x, 0.0))


def _velocity_cap(grid: CurveGrid, velocity: Float[Array, " nq"]) -> Float[Array, " point"]:
    """Largest squared path speed at which no joint exceeds its velocity limit."""
    slope = np.abs(grid.slope)
    fast = (velocity / np.where(slope > 0.0, slope, 1e-12)).min(axis=2) ** 2
    fast = np.minimum(fast, _UNBOUNDED)
    return np.minimum(np.append(fast[:, 0], _UNBOUNDED), np.append(_UNBOUNDED, fast[:, 1]))


def _row_cap(reach: Float[Array, "interval row"], tilt: Float[Array, "interval row"]) -> Float[Array, " interval"]:
    """Largest x for which some u meets all rows of an interval: no lower bound may pass an upper one."""
    closing = tilt[:, :, None] - tilt[:, None, :]
    room = reach[:, :, None] + reach[:, None, :]
    pairs = np.where(closing > 0.0, room / np.where(closing > 0.0, closing, 1.0), _UNBOUNDED)
    return pairs.min(axis=(1, 2))


def fastest_with_toppra(
    grid: CurveGrid,
    velocity: Float[Array, " nq"],
    acceleration: Float[Array, " nq"],
    torque: Float[Array, " nq"] | None = None,
    inverse_dynamics: InverseDynamics | None = None,
) -> Float[Array, " point"]:
    """Do what `fastest` does by toppra, with torque limits [N m] too if `inverse_dynamics` is given.

    Raises:
        RetimingError: If toppra finds no parametrisation.
    """
    # Imported here: it pulls in matplotlib and scipy, about a second.
    from toppra.algorithm import TOPPRA
    from toppra.constraint import DiscretizationType, JointAccelerationConstraint, JointVelocityConstraint
    from toppra.constraint import SecondOrderConstraint as Torque

    scheme = DiscretizationType.Interpolation
    constraints: list[Any] = [
        JointVelocityConstraint(np.stack([-velocity, velocity], axis=1)),
        JointAccelerationConstraint(np.stack([-acceleration, acceleration], axis=1), discretization_scheme=scheme),
    ]
    if inverse_dynamics is not None and torque is not None:
        bounds = np.stack([-torque, torque], axis=1)
        none = np.zeros(len(torque))
        constraints.append(Torque.joint_torque_constraint(inverse_dynamics, bounds, none, discretization_scheme=scheme))
    speeds = np.zeros(len(grid.s))
    stops = np.flatnonzero(grid.stop).tolist()
    for first, last in pairwise(stops):
        section = _Section(grid, first, last)
        solver = TOPPRA(constraints, section, gridpoints=section.s, solver_wrapper="seidel")
        found = solver.compute_parameterization(0.0, 0.0)[1]
        if found is None or not np.all(np.isfinite(found)):
            raise RetimingError(
                f"toppra found no timing from {grid.s[first]:.3g} to {grid.s[last]:.3g} rad of the path"
            )
        speeds[first : last + 1] = found
    return speeds


class _Section:
    """The part of a grid between two stops, as the kind of path that toppra asks at grid points."""

    def __init__(self, grid: CurveGrid, first: int, last: int) -> None:
        self.s = grid.s[first : last + 1] - grid.s[first]
        self.values = (
            grid.q[first : last + 1],
            np.concatenate([grid.slope[first:last, 0], grid.slope[last - 1 : last, 1]]),
            np.concatenate([grid.bend[first:last, 0], grid.bend[last - 1 : last, 1]]),
        )
        self.dof = grid.q.shape[1]
        self.path_interval = np.array([self.s[0], self.s[-1]])

    def __call__(self, s: ArrayLike, order: int = 0) -> Float[Array, "*n nq"]:
        index = np.clip(np.searchsorted(self.s, np.asarray(s) - 1e-12), 0, len(self.s) - 1)
        return self.values[order][index]
