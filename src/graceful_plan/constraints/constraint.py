"""The constraint contract: a batched residual that is positive where a configuration violates the constraint.

A constraint is a small frozen object, like a cost. It needs no registration: `plan(..., constraints=[MyConstraint()])`.
Planners check it along every edge as densely as collisions; the judge checks the timed motion.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.costs.cost import Contract, StateBatch
from graceful_plan.exceptions import CostError, ShapeError
from graceful_plan.path import real_array
from graceful_plan.scene.rules.rules import CustomRule, Rule
from graceful_plan.scene.scene import Scene

_NUDGE = 1e-5
"""Step of the finite differences that replace a missing gradient [rad]."""


class Constraint(Contract):
    """Base class of all constraints: a frozen object with `residual` and, optionally, `gradient`."""

    lever: ClassVar[float] = 1.0
    """Clearance that one unit of the residual is worth [m]: planners apply one margin to distances and constraints."""

    @property
    def name(self) -> str:
        """Name of the constraint in messages and verdicts."""
        return type(self).__name__

    @abstractmethod
    def residual(self, batch: StateBatch) -> Float[Array, " n"]:
        """Return the violation of each state: at most 0 where the constraint holds.

        Laws: finite and continuous; each entry depends on its own configuration alone; the same input gives the same
        output.
        """

    def gradient(self, batch: StateBatch) -> Float[Array, "n nq"] | None:
        """Return the derivative of `residual` with respect to q; None to use finite differences."""
        del batch
        return None

    def told(self, residual: float) -> str:
        """Describe a violation for messages."""
        return f"{self.name}: {residual:.3g} beyond what is allowed"

    def rule(self, scene: Scene) -> Rule:
        """Return the rule that the judge checks in a scene.

        Raises:
            GracefulPlanError: If the constraint does not apply to the scene.
        """
        return CustomRule(
            name=self.name, residual=lambda q: checked_residual(self, StateBatch(scene, q)), told=self.told
        )


def checked_residual(constraint: Constraint, batch: StateBatch) -> Float[Array, " n"]:
    """Evaluate a constraint and check that the result obeys the contract.

    Raises:
        CostError: If it returns the wrong shape, a NaN or an infinity.
    """
    try:
        value = real_array("residual()", constraint.residual(batch))
    except ShapeError as error:
        raise CostError(constraint, str(error)) from None
    if value.shape != (len(batch),):
        raise CostError(
            constraint, f"residual() returned shape {value.shape} for {len(batch)} states, expected ({len(batch)},)"
        )
    if not np.all(np.isfinite(value)):
        worst = int(np.flatnonzero(~np.isfinite(value))[0])
        raise CostError(constraint, f"residual() returned {value[worst]} at q = {batch.q[worst].round(4).tolist()}")
    return value


def residual_gradient(constraint: Constraint, batch: StateBatch) -> Float[Array, "n nq"]:
    """Return the gradient of a residual, by central differences if the constraint has none."""
    own = constraint.gradient(batch)
    if own is not None:
        return real_array("gradient()", own)
    n, nq = batch.q.shape
    nudges = _NUDGE * np.concatenate([np.eye(nq), -np.eye(nq)])
    around = StateBatch(batch.scene, (batch.q[:, None] + nudges).reshape(-1, nq))
    values = checked_residual(constraint, around).reshape(n, 2, nq)
    return (values[:, 0] - values[:, 1]) / (2.0 * _NUDGE)
