"""Costs of moving states with derivatives, for optimisers and descents; any user's cost works."""

from __future__ import annotations

from functools import cached_property
from threading import RLock
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Float
from graceful_plan.costs.cost import Cost, StateBatch, checked_state, moving_batch
from graceful_plan.exceptions import CostError, ShapeError
from graceful_plan.path import real_array
from graceful_plan.scene.scene import Scene

DIFFERENCE = 1e-3
"""Step of the finite differences [rad or rad/s]. Single precision of the kernels (1e-7 m) causes an error of 1e-4 of a
slope of 1 m/rad; curvature on the scale of 0.1 rad causes 5e-3."""
_PROBED = 32
"""Number of random states that test whether a cost depends on velocity."""


@final
class CostSlopes:
    """A cost in a scene, with its derivatives: by its own gradient if it has one, else by finite differences.

    Differences displace all states in one batch, one joint at a time. Calls are serialised, since a cost need not be
    thread-safe.

    Args:
        cost: The cost.
        scene: The scene.
    """

    def __init__(self, cost: Cost, scene: Scene) -> None:
        self.cost, self.scene = cost, scene
        self._lock = RLock()

    @cached_property
    def has_gradient(self) -> bool:
        """Whether the cost has a gradient in q."""
        with self._lock:
            return self.cost.gradient(StateBatch(self.scene, self.scene.limits.position.mean(axis=1)[None])) is not None

    @cached_property
    def uses_velocity(self) -> bool:
        """Whether the cost depends on velocity, tested at random states."""
        rng = np.random.default_rng(0)
        lower, upper = self.scene.limits.position.T
        q = rng.uniform(lower, upper, (_PROBED, len(lower)))
        qd = self.scene.limits.velocity * rng.uniform(-1.0, 1.0, q.shape)
        return not np.array_equal(self.states(q, np.zeros_like(q)), self.states(q, qd))

    def states(self, q: Float[Array, "n nq"], qd: Float[Array, "n nq"]) -> Float[Array, " n"]:
        """Return the density at each state.

        Raises:
            CostError: If the cost breaks its contract.
        """
        with self._lock:
            return checked_state(self.cost, moving_batch(self.scene, q, qd))

    def __call__(
        self, q: Float[Array, "n nq"], qd: Float[Array, "n nq"]
    ) -> tuple[Float[Array, " n"], Float[Array, "n nq"], Float[Array, "n nq"]]:
        """Return the density at each state, and its derivatives with respect to q and to the joint velocities.

        Raises:
            CostError: If the cost breaks its contract.
        """
        with self._lock:
            batch = moving_batch(self.scene, q, qd)
            gradient = self.cost.gradient(batch) if self.has_gradient else None
            if gradient is None:
                value, d_q = self._differences(q, qd, by_q=True)
            else:
                value, d_q = checked_state(self.cost, batch), _checked(self.cost, gradient, q)
            if not self.uses_velocity:
                return value, d_q, np.zeros_like(d_q)
            return value, d_q, self._differences(q, qd, by_q=False)[1]

    def _differences(
        self, q: Float[Array, "n nq"], qd: Float[Array, "n nq"], *, by_q: bool
    ) -> tuple[Float[Array, " n"], Float[Array, "n nq"]]:
        n, nq = q.shape
        # Away from the nearer limit, so that no state is outside of the limits.
        middle = self.scene.limits.position.mean(axis=1)
        sign = np.where(q > middle, -1.0, 1.0) if by_q else np.ones_like(q)
        moved = np.zeros((nq + 1, n, nq))
        joints = np.arange(nq)
        moved[joints + 1, :, joints] = DIFFERENCE * sign.T
        all_q = (q + moved if by_q else np.broadcast_to(q, moved.shape)).reshape(-1, nq)
        all_qd = (np.broadcast_to(qd, moved.shape) if by_q else qd + moved).reshape(-1, nq)
        value = self.states(all_q, all_qd).reshape(nq + 1, n)
        return value[0], (value[1:] - value[0]).T / (DIFFERENCE * sign)


def _checked(cost: Cost, gradient: ArrayLike, q: Float[Array, "n nq"]) -> Float[Array, "n nq"]:
    try:
        array = real_array("gradient()", gradient)
    except ShapeError as error:
        raise CostError(cost, str(error)) from None
    if array.shape != q.shape:
        raise CostError(cost, f"gradient() returned shape {array.shape} for {len(q)} states, expected {q.shape}")
    if not np.all(np.isfinite(array)):
        raise CostError(cost, "gradient() returned a NaN or an infinity")
    return array
