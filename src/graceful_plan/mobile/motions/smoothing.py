"""Curves of a base that descend along J: control points move together, so that what is smooth stays smooth.

A curve is charged for its length, for the time that it takes at speeds that bends and arm allow, for the impact at
these speeds, for coming too close to something and for its curvature. The arm moves with the base where the curve has
control points for it too. All candidates of a step are evaluated in one batch; slopes are differences of the geometry,
times the derivatives of impact and clearance at the states of the curve. Steps are measured by curvature, as in CHOMP:
a slope at one place bends the whole curve.

N. Ratliff et al., "CHOMP: gradient optimization techniques for efficient motion planning", ICRA 2009.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.mobile.among.walkers import KEPT, Walkers
from graceful_plan.mobile.motions.drive_curve import Roll, rolled
from graceful_plan.mobile.motions.moving_curve import Curvature, MovingCurve
from graceful_plan.planners.planner import Budget
from graceful_plan.scene.mobile.diff_drive import DiffDrive
from graceful_plan.timing.bspline import basis

Array = np.ndarray

_PLACES = 64
"""Where a curve is looked at, at least; four by control point."""
_NUDGE = 1e-4
"""Of a control point, for a slope [m or rad]."""
_STEPS = 0.3 * 0.5 ** np.arange(8)
"""How far control points move at most in a step [m or rad]; the best of these is taken."""
_ROUNDS = 40
_WORTH = 1e-3
"""Relative gain of a round below which a descent ends."""
_CLEAR = 0.05
"""Clearance below which a curve is charged for being close [m]."""
_ROOM, _LEAST_ROOM = 0.03, 1e-3
"""The same if the arm moves, and what it is at least where the ends are closer [m]."""
_BENT = 0.02
"""Price of curvature squared over length [m]: the time law needs its rate of change to be small."""
_WALL, _ARM_WALL = 1e3, 30.0
"""Price of being closer, by the square of the lack over that clearance and length: of curves whose arm stays and moves.
"""


@dataclass(frozen=True, eq=False)
class _Travelled:
    """Curves as they are travelled, at the same parameters; derivatives are by these.

    | field    | meaning                                | unit       | shape      |
    |----------|----------------------------------------|------------|------------|
    | q        | configurations                         | rad or m   | curve u nq |
    | qd       | their velocities                       | rad/s, m/s | curve u nq |
    | length   | of base and arm in all joints          |            | curve u    |
    | metres   | of the base                            | m          | curve u    |
    | bend     | curvature                              | rad/m      | curve u    |
    | duration |                                        | s          | curve u    |
    | time     | since the curve began                  | s          | curve u    |
    """

    q: Float[Array, "curve u nq"]
    qd: Float[Array, "curve u nq"]
    length: Float[Array, "curve u"]
    metres: Float[Array, "curve u"]
    bend: Float[Array, "curve u"]
    duration: Float[Array, "curve u"]
    time: Float[Array, "curve u"]


@dataclass(frozen=True)
class Closeness:
    """What is charged for being close to something.

    Args:
        clear: Clearance from which on nothing is [m].
        price: Of a metre of the base without any.
    """

    clear: float
    price: float

    def charge(self, clearance: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """Return what a metre of the base costs."""
        return self.price * np.maximum(0.0, 1.0 - clearance / self.clear) ** 2


@dataclass(frozen=True, eq=False)
class Smoother:
    """What curves descend along.

    Args:
        objective: V and w I.
        base: How the robot drives.
        clearance: Signed clearance of configurations [m], and its gradient.
        time_price: What a second costs besides.
        speed: Fraction of the limits of speed to use.
        walkers: Those who move; the objective is then that as if nobody did.
        begins: When the base sets out [s].
    """

    objective: SceneObjective
    base: DiffDrive
    clearance: Callable[[Float[Array, "n nq"]], tuple[Float[Array, " n"], Float[Array, "n nq"]]]
    time_price: float
    speed: float
    walkers: Walkers | None = None
    begins: float = 0.0

    def shortest(self) -> Smoother:
        """Return the same for an objective in which no impact counts."""
        objective = self.objective
        return replace(self, objective=objective.objective.with_weight(0.0).bind(objective.scene, objective.paces))

    def descended(self, roll: Roll, budget: Budget) -> Roll:
        """Return a better curve with the same ends and headings there."""
        moving = MovingCurve(roll, self.objective.scene.limits.position)
        x, room = moving.first, self.room(np.stack([roll.begin, roll.end]), moves_arm=roll.controls.shape[1] > 2)
        value, gained = float(self._values(moving, x[None], room)[0]), np.inf
        curved = Curvature(moving.metric)
        for _ in range(_ROUNDS):
            if budget.exhausted or gained < _WORTH or len(x) == 0:
                break
            direction = curved.direction(x, self._slope(moving, x, room))
            longest = float(np.abs(direction).max())
            if longest < 1e-9:
                break
            tried = x + np.append(_STEPS / longest, min(1.0, _STEPS[0] / longest))[:, None] * direction
            values = self._values(moving, tried, room)
            best = int(np.argmin(values))
            if values[best] >= value:
                if curved.known:
                    curved = Curvature(moving.metric)
                    continue
                break
            gained = (value - values[best]) / max(abs(value), 1e-9)
            x, value = tried[best], float(values[best])
        return moving.roll(x)

    def room(self, ends: Float[Array, "n nq"], *, moves_arm: bool) -> Closeness:
        """Return what is charged for being close: links of an arm may be as close to each other as at the ends.

        Args:
            ends: Configurations at the ends of a curve.
            moves_arm: Whether the arm moves along it.
        """
        most, price = (_ROOM, _ARM_WALL) if moves_arm else (_CLEAR, _WALL)
        has_arm = ends.shape[1] > len(self.base.joints)
        return Closeness(float(np.clip(self.clearance(ends)[0].min(), _LEAST_ROOM, most)) if has_arm else most, price)

    def pace(
        self, bend: Float[Array, "*curve u"], done: Float[Array, "*curve u"], length: Float[Array, "*curve"]
    ) -> Float[Array, "*curve u"]:
        """Return speeds along the heading that bends allow, and acceleration from rest to rest [m/s].

        Args:
            bend: Curvature [rad/m].
            done: How far the base has come [m].
            length: Of the whole curve [m].
        """
        base, least = self.base, 1e-3
        left = np.minimum(done, length[..., None] - done) + least
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

    def _slope(self, moving: MovingCurve, x: Float[Array, " variable"], room: Closeness) -> Float[Array, " variable"]:
        """Return the derivative of the charge: geometry by differences, impact and clearance by their gradients."""
        at, near = self._travelled(moving, x[None]), self._travelled(moving, x + _NUDGE * np.eye(len(x)))
        rows, rates = at.q[0], at.qd[0]
        dq, dqd = near.q - rows, near.qd - rates
        dq[..., 2] = np.remainder(dq[..., 2] + np.pi, 2.0 * np.pi) - np.pi
        clearance, steeper = self.clearance(rows)
        close = clearance + np.einsum("kun,un->ku", dq, steeper)
        impact, harm = np.zeros(len(rows)), np.zeros(dq.shape[:2])
        if self.objective.w > 0.0:
            impact, by_q, by_qd = self._impact_slopes(rows, rates)
            harm = impact + np.einsum("kun,un->ku", dq, by_q) + np.einsum("kun,un->ku", dqd, by_qd)
        if self.walkers is not None:
            more, m_q, m_qd, m_t = self.walkers.slopes(rows, rates, self.begins + at.time[0])
            others = more + np.einsum("kun,un->ku", dq, m_q) + np.einsum("kun,un->ku", dqd, m_qd)
            impact, harm = impact + more, harm + others + (near.time - at.time) * m_t
            clearance = np.minimum(clearance, self._gap(at, self.walkers)[0])
            close = np.minimum(close, self._gap(near, self.walkers))
        value = self._charge(at, impact[None], clearance[None], room)
        return (self._charge(near, harm, close, room) - value) / _NUDGE

    def _impact_slopes(self, q: Float[Array, "n nq"], qd: Float[Array, "n nq"]) -> tuple[Array, Array, Array]:
        kernel = self.objective.kernel
        return self.objective.impact_slopes(q, qd) if kernel is None else kernel.state_slopes(q, qd)

    def _values(
        self, moving: MovingCurve, x: Float[Array, "curve variable"], room: Closeness
    ) -> Float[Array, " curve"]:
        """Charge curves."""
        at = self._travelled(moving, x)
        rows, rates = (of.reshape(-1, of.shape[-1]) for of in (at.q, at.qd))
        impact = np.zeros(at.bend.shape)
        if self.objective.w > 0.0:
            impact = self.objective.quick_states(rows, rates).reshape(at.bend.shape)
        clearance = self.clearance(rows)[0].reshape(at.bend.shape)
        if self.walkers is not None:
            more = self.walkers.impact(rows, rates, self.begins + at.time.ravel())
            impact = impact + more.reshape(at.time.shape)
            clearance = np.minimum(clearance, self._gap(at, self.walkers))
        return self._charge(at, impact, clearance, room)

    def _gap(self, at: _Travelled, walkers: Walkers) -> Float[Array, "curve u"]:
        """Return what is left of what those who move are to be kept from [m]."""
        gap = walkers.gap(at.q.reshape(-1, at.q.shape[-1]), self.begins + at.time.ravel())
        return gap.reshape(at.time.shape) - KEPT

    def _charge(
        self, at: _Travelled, impact: Float[Array, "curve u"], clearance: Float[Array, "curve u"], room: Closeness
    ) -> Float[Array, " curve"]:
        total = at.length + self.time_price * at.duration + _BENT * at.metres * at.bend**2
        harm = self.objective.w * at.duration * impact
        return (total + harm + at.metres * room.charge(clearance)).mean(axis=1)

    def _travelled(self, moving: MovingCurve, x: Float[Array, "curve variable"]) -> _Travelled:
        n = max(_PLACES, 4 * len(moving.of.controls))
        u = (np.arange(n) + 0.5) / n
        controls = moving.controls(x)
        P = np.einsum("duc,kcx->dkux", basis(controls.shape[1], tuple(u.tolist())), controls)
        flat = rolled(P[..., :2], moving.of.forward)
        metres, turn = np.linalg.norm(flat[1, ..., :2], axis=-1), np.abs(flat[1, ..., 2])
        bend = turn / np.maximum(metres, 1e-9)
        pace = self.pace(bend, (np.cumsum(metres, axis=1) - 0.5 * metres) / n, metres.mean(axis=1))
        q = np.broadcast_to(moving.of.begin, (*bend.shape, len(moving.of.begin))).copy()
        rate = np.zeros_like(q)
        q[..., :3], rate[..., :3] = flat[:2]
        if P.shape[-1] > 2:
            q[..., 3:], rate[..., 3:] = P[:2, ..., 2:]
            fastest = self.speed * self.objective.scene.limits.velocity[3:]
            slowest = (np.abs(rate[..., 3:]) / fastest).max(axis=-1)
            pace = np.minimum(pace, metres / np.maximum(slowest, 1e-9))
        duration = metres / np.maximum(pace, 1e-9)
        qd = rate / np.maximum(duration, 1e-9)[..., None]
        time = (np.cumsum(duration, axis=1) - 0.5 * duration) / n
        length = np.linalg.norm(rate, axis=-1)
        return _Travelled(q=q, qd=qd, length=length, metres=metres, bend=bend, duration=duration, time=time)
