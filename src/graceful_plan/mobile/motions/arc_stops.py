"""Stops of a moving base along its present arc or nearly straight, and the limits on its velocity."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.constraints.scene_constraints import SceneConstraints
from graceful_plan.judge.drive_checks import SIDEWAYS
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import State, Trajectory

_BASE = 3
"""Number of joints of the base, which precede those of the arm."""
_KEPT = 0.99
"""Share of the acceleration limits that a stop uses; between its samples they are exceeded by less than 1 %."""
_PIECES = 64
"""Least number of pieces of a stop; with them, the sideways speed between samples stays below 0.1 mm/s."""
_GENTLER = (1.0, 0.5, 0.25, 0.12)
"""Shares of the hardest deceleration to try with a carried object whose specific force is limited."""
_TOLERANCE = 1e-2
"""Largest relative excess of a velocity over a limit of the base, as between the samples of its motions."""
_APART = 1e-6
"""Least time between two samples [s]."""
_NODES, _WEIGHTS = (0.5 * part for part in np.polynomial.legendre.leggauss(4))
_NODES = _NODES + 0.5


def speed_and_turn(state: State) -> tuple[float, float, float]:
    """Return the speed along the heading, the sideways speed [m/s], and the turning rate of a base [rad/s]."""
    along = np.array([np.cos(state.q[2]), np.sin(state.q[2])])
    x, y, turn = state.qd[:_BASE].tolist()
    return float(along @ (x, y)), float(along[0] * y - along[1] * x), turn


def impossible_velocity(state: State, scene: Scene, speed: float) -> str:
    """Return why a base cannot have a velocity within a fraction `speed` of its limits; empty if it can."""
    assert scene.base is not None
    base, (v, side, turn) = scene.base, speed_and_turn(state)
    if abs(side) > SIDEWAYS:
        return f"start: the base moves sideways at {side:.3g} m/s, which its wheels cannot"
    if not base.reverse and v < -SIDEWAYS:
        return f"start: the base drives backwards at {-v:.3g} m/s, which it must not"
    share = "" if speed == 1.0 else f"{speed:g} of "
    for name, value, limit, unit in (
        ("speed", abs(v), speed * base.v_max, "m/s"),
        ("rate of turning", abs(turn), speed * base.omega_max, "rad/s"),
        ("acceleration across", abs(v * turn), speed**2 * base.lateral_max, "m/s^2"),
        ("rim of a wheel", abs(v) + base.lever * abs(turn), speed * base.rim_max, "m/s"),
    ):
        if value > (1.0 + _TOLERANCE) * limit:
            return f"start: {name} of the base {value:.6g} {unit}, above {share}its limit {limit / speed:.6g}"
    return ""


def arc_stops(state: State, held: SceneConstraints, speed: float) -> Iterator[Trajectory]:
    """Yield stops of a moving base: with constant curvature, then with turning and driving braked separately.

    Joints of the arm brake evenly. With a carried object whose specific force is limited, gentler stops follow.

    Args:
        state: Position and velocity.
        held: Constraints and scene.
        speed: Fraction of the velocity limits to use; accelerations are limited to its square.
    """
    for share in _GENTLER if held.felt else _GENTLER[:1]:
        for on_arc in (True, False):
            yield _stop(state, held.scene, share * speed**2 * _KEPT, on_arc=on_arc)


def _stop(state: State, scene: Scene, share: float, *, on_arc: bool) -> Trajectory:
    """Return the stop with a share of the largest decelerations."""
    assert scene.base is not None
    v, _, turn = speed_and_turn(state)
    seconds = np.abs(state.qd) / (share * scene.limits.acceleration)
    seconds[:2], seconds[2] = abs(v) / (share * scene.base.a_max), abs(turn) / (share * scene.base.alpha_max)
    if on_arc:
        seconds[:_BASE] = seconds[:_BASE].max()
    t = np.union1d(np.linspace(0.0, float(seconds.max()), _PIECES + 1), seconds)
    t = t[np.append(True, np.diff(t) > _APART)]
    left = _left(t, seconds)
    q = state.q + (np.minimum(t[:, None], seconds) * 0.5 * (1.0 + left)) * state.qd
    qd, qdd = left * state.qd, np.where(left > 0.0, -state.qd / np.maximum(seconds, _APART), 0.0)
    # Positions of the base: Gaussian quadrature of its velocity on each piece.
    inner = t[:-1, None] + np.diff(t)[:, None] * _NODES
    then = _left(inner.ravel(), seconds)
    heading = state.q[2] + np.minimum(inner.ravel(), seconds[2]) * 0.5 * (1.0 + then[:, 2]) * turn
    step = v * then[:, :1] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    steps = np.diff(t)[:, None] * np.einsum("pgx,g->px", step.reshape(*inner.shape, 2), _WEIGHTS)
    q[:, :2] = state.q[:2] + np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    along = np.stack([np.cos(q[:, 2]), np.sin(q[:, 2])], axis=1)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    braking = np.where(left[:, :1] > 0.0, -v / max(float(seconds[0]), _APART), 0.0)
    qd[:, :2] = v * left[:, :1] * along
    qdd[:, :2] = braking * along + v * turn * left[:, :1] * left[:, 2:3] * across
    qd[0] = state.qd
    return Trajectory(t, q, qd, qdd, scene.joints)


def _left(t: Float[Array, " n"], seconds: Float[Array, " nq"]) -> Float[Array, "n nq"]:
    """Return the share of each joint's first velocity that is left if it falls to 0 within some time [s]."""
    past = np.minimum(t[:, None], seconds)
    return 1.0 - np.divide(past, seconds, out=np.ones_like(past), where=seconds > _APART)
