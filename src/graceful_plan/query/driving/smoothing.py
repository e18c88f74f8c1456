"""Curves of a base that descend along J: control points move together, so that what is smooth stays smooth.

A curve is charged for its length, for the time that it takes at speeds that the bends allow, for the impact at these
speeds, for coming too close to something and for its curvature. All candidates of a step are evaluated in one batch;
slopes are differences. Steps are measured by curvature, as in CHOMP: a slope at one place bends the whole curve.

N. Ratliff et al., "CHOMP: gradient optimization techniques for efficient motion planning", ICRA 2009.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.planners.planner import Budget
from graceful_plan.scene.mobile.diff_drive import DiffDrive
from graceful_plan.timing.bspline import basis
from graceful_plan.timing.drive_curve import Roll, rolled

Array = np.ndarray

_PLACES = 64
"""Where a curve is looked at, at least; four by control point."""
_NUDGE = 1e-4
"""Of a control point, for a slope [m]."""
_STEPS = 0.3 * 0.5 ** np.arange(8)
"""How far control points move at most in a step [m]; the best of these is taken."""
_ROUNDS = 40
_WORTH = 1e-3
"""Relative gain of a round below which a descent ends."""
_CLEAR = 0.05
"""Clearance below which a curve is charged for being close [m]."""
_BENT = 0.02
"""Price of curvature squared over length [m]: the time law needs its rate of change to be small."""
_WALL = 1e3
"""Price of being closer than the margin, by the square of the lack over the margin and length."""


@dataclass(frozen=True, eq=False)
class Smoother:
    """What curves descend along.

    Args:
        objective: V and w I.
        base: How the robot drives.
        clearance: Signed clearance of configurations [m].
        time_price: What a second costs besides.
        speed: Fraction of the limits of speed to use.
    """

    objective: SceneObjective
    base: DiffDrive
    clearance: Callable[[Float[Array, "n nq"]], Float[Array, " n"]]
    time_price: float
    speed: float

    def shortest(self) -> Smoother:
        """Return the same for an objective in which no impact counts."""
        objective = self.objective
        return replace(self, objective=objective.objective.with_weight(0.0).bind(objective.scene, objective.paces))

    def descended(self, roll: Roll, budget: Budget) -> Roll:
        """Return a better curve with the same ends and headings there."""
        moving = _Moving(roll)
        x = moving.first
        value, gained = float(self._values(moving, x[None])[0]), np.inf
        for _ in range(_ROUNDS):
            if budget.exhausted or gained < _WORTH or len(x) == 0:
                break
            nudged = self._values(moving, x + _NUDGE * np.eye(len(x)))
            direction = -moving.metric @ ((nudged - value) / _NUDGE)
            longest = float(np.abs(direction).max())
            if longest < 1e-9:
                break
            tried = x + (_STEPS / longest)[:, None] * direction
            values = self._values(moving, tried)
            best = int(np.argmin(values))
            if values[best] >= value:
                break
            gained = (value - values[best]) / max(abs(value), 1e-9)
            x, value = tried[best], float(values[best])
        return moving.roll(x)

    def _values(self, moving: _Moving, x: Float[Array, "curve variable"]) -> Float[Array, " curve"]:
        """Charge curves."""
        n = max(_PLACES, 4 * len(moving.of.controls))
        u = (np.arange(n) + 0.5) / n
        controls = moving.controls(x)
        P = np.einsum("duc,kcx->dkux", basis(controls.shape[1], tuple(u.tolist())), controls)
        flat = rolled(P, moving.of.forward)
        length, turn = np.linalg.norm(flat[1, ..., :2], axis=-1), np.abs(flat[1, ..., 2])
        bend = turn / np.maximum(length, 1e-9)
        pace = self._pace(bend, np.cumsum(length, axis=1) / n)
        q = np.broadcast_to(moving.of.begin, (*bend.shape, len(moving.of.begin))).copy()
        q[..., :3] = flat[0]
        qd = np.zeros_like(q)
        qd[..., :3] = flat[1] * (pace / np.maximum(length, 1e-9))[..., None]
        rows, rates = q.reshape(-1, q.shape[-1]), qd.reshape(-1, q.shape[-1])
        duration = length / pace
        total = np.hypot(length, turn) + self.time_price * duration + _BENT * length * bend**2
        if self.objective.w > 0.0:
            total += self.objective.w * duration * self.objective.quick_states(rows, rates).reshape(bend.shape)
        lack = np.maximum(0.0, 1.0 - self.clearance(rows).reshape(bend.shape) / _CLEAR)
        return (total + _WALL * length * lack**2).mean(axis=1)

    def _pace(self, bend: Float[Array, "curve u"], done: Float[Array, "curve u"]) -> Float[Array, "curve u"]:
        """Return speeds along the heading that bends allow, and acceleration from rest to rest [m/s]."""
        base, least = self.base, 1e-3
        left = np.minimum(done, done[:, -1:] - done) + least
        fastest = np.minimum.reduce(
            [
                np.full_like(bend, base.v_max),
                base.omega_max / np.maximum(bend, 1e-9),
                np.sqrt(base.lateral_max / np.maximum(bend, 1e-9)),
                base.rim_max / (1.0 + base.lever * bend),
                np.sqrt(2.0 * base.a_max * left),
            ]
        )
        return self.speed * fastest


class _Moving:
    """A curve, and what of it may move: inner control points, and how far those next to the ends are from these."""

    def __init__(self, roll: Roll) -> None:
        self.of = roll
        C = roll.controls
        self._first, self._last = C[1] - C[0], C[-1] - C[-2]
        n = max(0, len(C) - 4)
        self._inner = n
        self.first = np.concatenate([C[2:-2].ravel(), [0.0, 0.0]])
        bending = np.zeros((n + 2, n))
        for k in range(n):
            bending[k : k + 3, k] = 1.0, -2.0, 1.0
        stiffness = bending.T @ bending + 1e-3 * np.eye(n)
        inverse = np.linalg.inv(stiffness) if n else np.zeros((0, 0))
        self.metric = np.zeros((2 * n + 2, 2 * n + 2))
        self.metric[: 2 * n, : 2 * n] = np.kron(inverse, np.eye(2))
        self.metric[2 * n :, 2 * n :] = np.eye(2)

    def controls(self, x: Float[Array, "curve variable"]) -> Float[Array, "curve control 2"]:
        """Return the control points of curves; the ends and the directions there stay."""
        C = np.broadcast_to(self.of.controls, (len(x), *self.of.controls.shape)).copy()
        n = self._inner
        C[:, 2 : 2 + n] = x[:, : 2 * n].reshape(len(x), n, 2)
        first, last = (np.exp(np.clip(x[:, k], -2.0, 2.0))[:, None] for k in (2 * n, 2 * n + 1))
        C[:, 1], C[:, -2] = C[:, 0] + first * self._first, C[:, -1] - last * self._last
        return C

    def roll(self, x: Float[Array, " variable"]) -> Roll:
        """Return one of the curves."""
        return Roll(self.controls(x[None])[0], self.of.begin, self.of.end, self.of.forward)
