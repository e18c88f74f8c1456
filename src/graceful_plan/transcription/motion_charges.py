"""Running costs of a motion with derivatives: impact of a failure, effort, acceleration, length."""

from __future__ import annotations

from collections.abc import Callable
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.costs.cost import Cost, checked_state, moving_batch
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.slopes import CostSlopes
from graceful_plan.scene.scene import Scene
from graceful_plan.transcription.spline_program import Charge, Charging
from graceful_plan.transcription.symbolic import SymbolicRobot

_STEP = 1e-5
"""Step of finite differences of a cost that has no derivatives [rad or rad/s]."""
_CURVATURE_STEP = 1e-4
"""Step of finite differences of gradients [rad or rad/s]."""
_SOFTENED = 1e-3
"""Speed below which the length cost is smoothed [rad/s]."""


@final
class ImpactCharge:
    """Running cost of a failure: its impact at a state times the safety weight.

    First derivatives are the impact model's own gradients if it has them, otherwise finite differences of all states in
    one batch. Second derivatives are finite differences of the first ones.

    Args:
        impact: The cost of a failure.
        scene: Scene in which the impact is evaluated.
        w: Safety weight.
    """

    def __init__(self, impact: Cost, scene: Scene, w: float) -> None:
        self.impact, self.scene, self.w = impact, scene, w
        self._own = CostSlopes(impact, scene)

    def value(self, q: Float[Array, "n nq"], qd: Float[Array, "n nq"]) -> Float[Array, " n"]:
        """Return the weighted impact of each state."""
        return self.w * checked_state(self.impact, moving_batch(self.scene, q, qd))

    def slope(self, q: Float[Array, "n nq"], qd: Float[Array, "n nq"]) -> Float[Array, "n state"]:
        """Return the derivatives of `value` with respect to q, then qd."""
        exact = self.impact.gradients(moving_batch(self.scene, q, qd)) if isinstance(self.impact, ImpactCost) else None
        if exact is not None:
            return self.w * np.concatenate(exact, axis=1)
        if self._own.has_gradient and not self._own.uses_velocity:
            return self.w * np.concatenate(self._own(q, qd)[1:], axis=1)
        return _differences(lambda z: self.value(*np.split(z, 2, axis=1)), np.concatenate([q, qd], axis=1), _STEP)

    def __call__(self, states: Float[Array, "order n nq"], curved: bool) -> Charge:
        """Evaluate cost and slope of states, and the curvature if `curved`."""
        q, qd = states[0], states[1]
        n, nq = q.shape
        slope = np.zeros((n, 3, nq))
        slope[:, :2] = self.slope(q, qd).reshape(n, 2, nq)
        curvature = np.zeros((n, 3 * nq, 3 * nq) if curved else (0, 0, 0))
        if curved:
            state = np.concatenate([q, qd], axis=1)
            second = _differences(lambda z: self.slope(*np.split(z, 2, axis=1)), state, _CURVATURE_STEP)
            curvature[:, : 2 * nq, : 2 * nq] = _convex(0.5 * (second + np.swapaxes(second, 1, 2)))
        return Charge(self.value(q, qd), slope, curvature)


def _convex(matrix: Float[Array, "n k k"]) -> Float[Array, "n k k"]:
    """Drop negative curvature, with which IPOPT regularises until its steps are tiny."""
    value, vector = np.linalg.eigh(matrix)
    return (vector * np.maximum(value, 0.0)[:, None]) @ np.swapaxes(vector, 1, 2)


def _differences(f: Callable[[Array], Array], z: Float[Array, "n state"], step: float) -> Float[Array, "..."]:
    """Return central differences of f with respect to every column, as the last axis, evaluated in one batch."""
    n, columns = z.shape
    moved = z[None, None] + step * np.array([1.0, -1.0])[:, None, None, None] * np.eye(columns)[:, None, :]
    values = np.asarray(f(moved.reshape(-1, columns)))
    values = values.reshape(2, columns, n, *values.shape[1:])
    return np.moveaxis((values[0] - values[1]) / (2.0 * step), 0, -1)


def effort_charge(robot: SymbolicRobot, limit: Float[Array, " nq"]) -> Charging:
    """Return the running cost sum of (torque / limit)^2 over joints, with Gauss-Newton curvature."""

    def charge(states: Float[Array, "order n nq"], curved: bool) -> Charge:
        torque, slopes = robot.torques_with_slopes(*states)
        share, slopes = torque / limit, slopes / limit[:, None]
        curvature = 2.0 * np.swapaxes(slopes, 1, 2) @ slopes if curved else np.zeros((0, 0, 0))
        slope = 2.0 * np.einsum("sj,sjz->sz", share, slopes)
        return Charge((share**2).sum(axis=1), slope.reshape(len(torque), 3, -1), curvature)

    return charge


def acceleration_charge(limit: Float[Array, " nq"]) -> Charging:
    """Return the running cost sum of (acceleration / limit)^2 over joints."""

    def charge(states: Float[Array, "order n nq"], curved: bool) -> Charge:
        n, nq = states[2].shape
        slope, curvature = np.zeros((n, 3, nq)), np.zeros((n, 3 * nq, 3 * nq) if curved else (0, 0, 0))
        slope[:, 2] = 2.0 * states[2] / limit**2
        if curved:
            own = np.arange(2 * nq, 3 * nq)
            curvature[:, own, own] = 2.0 / limit**2
        return Charge(((states[2] / limit) ** 2).sum(axis=1), slope, curvature)

    return charge


def length_charge(states: Float[Array, "order n nq"], curved: bool) -> Charge:
    """Evaluate the joint-space speed [rad/s] as a running cost, smoothed near rest."""
    qd = states[1]
    n, nq = qd.shape
    speed = np.sqrt((qd**2).sum(axis=1) + _SOFTENED**2)
    slope, curvature = np.zeros((n, 3, nq)), np.zeros((n, 3 * nq, 3 * nq) if curved else (0, 0, 0))
    direction = qd / speed[:, None]
    slope[:, 1] = direction
    if curved:
        across = np.eye(nq) - direction[:, :, None] * direction[:, None, :]
        curvature[:, nq : 2 * nq, nq : 2 * nq] = across / speed[:, None, None]
    return Charge(speed, slope, curvature)
