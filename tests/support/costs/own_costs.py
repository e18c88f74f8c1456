"""Custom costs for tests: smooth ones with and without a gradient, and one that depends on velocities."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import graceful_plan as gp
from graceful_plan.array_types import Float

Array = np.ndarray


@dataclass(frozen=True)
class Bowl(gp.Cost):
    """Half the squared distance from a posture, with or without its gradient."""

    centre: float = 0.3
    told: bool = True

    def state(self, batch: gp.StateBatch) -> Float[Array, " n"]:
        """Return the value."""
        return 0.5 * np.sum((batch.q - self.centre) ** 2, axis=1)

    def gradient(self, batch: gp.StateBatch) -> Float[Array, "n nq"] | None:
        """Return the offset."""
        return batch.q - self.centre if self.told else None


@dataclass(frozen=True)
class Height(gp.Cost):
    """Squared height of the tool below a metre: no gradient."""

    def state(self, batch: gp.StateBatch) -> Float[Array, " n"]:
        """Return the value."""
        return (1.0 - batch.tool_poses[:, 2, 3]) ** 2


@dataclass(frozen=True)
class Haste(gp.Cost):
    """Squared speed of each joint, weighted by its distance from zero: depends on velocities and configuration."""

    def state(self, batch: gp.StateBatch) -> Float[Array, " n"]:
        """Return the value."""
        return np.sum((1.0 + batch.q**2) * batch.qd**2, axis=1)

    def gradient(self, batch: gp.StateBatch) -> Float[Array, "n nq"]:
        """Return the derivative at constant velocity."""
        return 2.0 * batch.q * batch.qd**2


@dataclass(frozen=True)
class Crosswise(gp.Cost):
    """A motion cost in which joints differ, and which grows as the first one turns."""

    def state(self, batch: gp.StateBatch) -> Float[Array, " n"]:
        """Return the density."""
        weights = 1.0 + 0.2 * np.arange(batch.q.shape[1])
        return (1.0 + 0.3 * np.sin(batch.q[:, 0])) * np.sqrt(np.sum((weights * batch.direction) ** 2, axis=1) + 1e-3)
