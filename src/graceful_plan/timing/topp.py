r"""Time-optimal path parametrisation by reachability analysis (TOPP-RA) for a given curve.

With the squared path speed :math:`x = \dot s^2` and the path acceleration :math:`u = \ddot s`, constant on each
interval of the grid, every joint acceleration :math:`q' u + q'' x` is linear in (u, x) and
:math:`x_{i+1} = x_i + 2 \Delta_i u_i`. A backward pass finds the largest x from which the end can still be reached at
rest, or at no more than a given speed; a forward pass then goes as fast as that allows.

There are two implementations. `fastest` takes symmetric velocity and acceleration limits and limits on the specific
force of a carried object. It solves them in closed form in the core (`timing/curve_timing.hpp`) and avoids the second
that importing toppra takes. `fastest_with_toppra` passes the general problem, with gravity, to toppra.

References:
    H. Pham, Q.-C. Pham, "A New Approach to Time-Optimal Path Parameterization Based on Reachability Analysis",
    IEEE Transactions on Robotics 34 (2018).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Float
from graceful_plan.core import _native
from graceful_plan.exceptions import RetimingError
from graceful_plan.timing.blend import CurveGrid

InverseDynamics = Callable[[Array, Array, Array], Array]
"""Maps (q, qd, qdd) to joint torques [N m]."""
Restraint = Callable[[CurveGrid], Array]
"""Returns limits a u + b x <= c, c > 0, on path acceleration u and squared path speed x: [interval, limit, 3]."""


@final
@dataclass(frozen=True, eq=False)
class SpecificForceLevels:
    """Limits on the specific force of a carried object, from the most permissive level to the strictest.

    A liquid surface swings beyond the direction of the specific force. Stricter levels leave less of the brim tilt to
    the specific force and more to this swing.

    | field  | meaning                                      |
    |--------|----------------------------------------------|
    | core   | kinematics of the robot                      |
    | names  | names of the constraints behind the limits   |
    | levels | limits of each level, in the order of names  |
    """

    core: _native.Core | None
    names: tuple[str, ...]
    levels: tuple[tuple[_native.SpecificForceLimit, ...], ...]


class EndSpeeds(NamedTuple):
    """Sizes of the velocity at both ends of a motion [rad/s, Euclidean]; 0: at rest."""

    start: float = 0.0
    end: float = 0.0


AT_REST = EndSpeeds()


def fastest(
    grid: CurveGrid,
    velocity: Float[Array, " nq"],
    acceleration: Float[Array, " nq"],
    *,
    limit: Float[Array, "interval limit 3"] | None = None,
    felt: SpecificForceLevels | None = None,
    speed: float = 1.0,
    ends: EndSpeeds = AT_REST,
) -> _native.TimedCurve:
    """Compute the time-optimal motion along a curve, at rest at the grid's stops.

    Args:
        grid: The curve.
        velocity: Limits of the joint speeds [rad/s], > 0.
        acceleration: Limits of the joint accelerations [rad/s^2], finite and > 0.
        limit: Further limits, see `Restraint`.
        felt: Limits on the specific force of a carried object.
        speed: Fraction of full speed at which the motion will finally be executed; the other limits apply at that
            speed.
        ends: Speeds at both ends.

    Raises:
        RetimingError: If the motion comes to a halt, a limit is violated even at rest, the motion starts too fast for
            the curve, or the curve is too short to reach the speed at its end.
    """
    felt = SpecificForceLevels(None, (), ()) if felt is None else felt
    found = _native.fastest(
        **_arrays(grid, velocity, acceleration),
        stop=grid.stop,
        limit=limit,
        core=felt.core,
        levels=felt.levels,
        speed=speed,
        start=ends.start or None,
        end=ends.end or None,
    )
    if ends.end and found.failed_point == len(grid.s) - 1 and found.failed_limit < 0:
        raise RetimingError(f"no motion along the path reaches {ends.end:.3g} rad/s at its end within the limits")
    if ends != AT_REST and found.failed_point == 0 and found.failed_limit < 0:
        speeds = f"{ends.start:.3g} rad/s at the start and {ends.end:.3g} rad/s at the end"
        raise RetimingError(f"no motion with {speeds} follows the path within the limits")
    return _checked(found, grid, felt.names)


def travelled(
    grid: CurveGrid, speeds: Float[Array, " point"], velocity: Float[Array, " nq"], acceleration: Float[Array, " nq"]
) -> _native.TimedCurve:
    """Time a curve with given path speeds and constant path acceleration on each interval.

    Raises:
        RetimingError: If the motion comes to a halt.
    """
    found = _native.travelled(**_arrays(grid, velocity, acceleration), speeds=np.ascontiguousarray(speeds))
    return _checked(found, grid, ())


def _arrays(grid: CurveGrid, velocity: Float[Array, " nq"], acceleration: Float[Array, " nq"]) -> dict[str, Array]:
    given = {
        "step": np.diff(grid.s),
        "q": grid.q,
        "slope": grid.slope,
        "bend": grid.bend,
        "velocity": velocity,
        "acceleration": acceleration,
    }
    return {name: np.ascontiguousarray(value, dtype=np.float64) for name, value in given.items()}


def _checked(found: _native.TimedCurve, grid: CurveGrid, names: Sequence[str]) -> _native.TimedCurve:
    if found.failed_point < 0:
        return found
    s = grid.s[found.failed_point]
    if found.failed_limit < 0:
        raise RetimingError(f"the motion comes to a halt {s:.3g} rad along the path")
    raise RetimingError(f"{names[found.failed_limit]} does not hold at rest after {s / grid.s[-1]:.0%} of the path")


def fastest_with_toppra(
    grid: CurveGrid,
    velocity: Float[Array, " nq"],
    acceleration: Float[Array, " nq"],
    torque: Float[Array, " nq"] | None = None,
    inverse_dynamics: InverseDynamics | None = None,
) -> Float[Array, " point"]:
    """Compute the path speeds of `fastest` with toppra; with `inverse_dynamics` also within torque limits [N m].

    Raises:
        RetimingError: If toppra finds no parametrisation.
    """
    # Imported here because it loads matplotlib and scipy, which takes about a second.
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
    """The part of a grid between two stops, as a path object for toppra, evaluated at grid points only."""

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
