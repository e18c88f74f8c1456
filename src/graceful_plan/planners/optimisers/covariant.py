r"""Descent in the metric of paths: covariant gradient and L-BFGS, with a line search and joint limits.

A step along :math:`-A^{-1} \nabla U` spreads a local push over the whole path, the less the rougher that would make it.
L-BFGS begins its recursion with the same inverse, and learns from past steps what the metric does not know.

References:
    Nocedal and Wright, "Numerical optimization", 2nd ed., Alg. 7.4 (two-loop recursion) and Alg. 3.1 (backtracking).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import final

import numpy as np

from graceful_plan.array_types import Bool, Float
from graceful_plan.planners.optimisers.path_energy import Evaluation
from graceful_plan.planners.optimisers.smoothness import Smoothness

Array = np.ndarray

_SUFFICIENT = 1e-4
"""Share of the fall that the slope promises which a step has to bring."""
_SHORTEST = 1e-4
"""Share of a step below which the direction is given up."""
_CURVED = 1e-8
"""Least cosine between a step and the change of the gradient for L-BFGS to learn from it."""

_LEAST_STRETCH = 1e-9
"""Cost per length below which nothing is gained by moving."""


@final
class Memory:
    """What L-BFGS remembers: steps and what they changed in the gradient; the plain metric if there are none.

    Args:
        metric: That of the paths.
        scale: The energy's second derivative relative to the metric, as far as it is known beforehand.
        size: How many steps; 0 is the covariant gradient.
    """

    def __init__(self, metric: Smoothness, scale: float, size: int) -> None:
        self._metric, self._scale = metric, scale
        self._pairs: deque[tuple[Array, Array, float]] = deque(maxlen=size)

    def learn(self, step: Float[Array, "n nq"], change: Float[Array, "n nq"]) -> None:
        """Note a step and by how much it changed the gradient."""
        product = float(np.vdot(step, change))
        if self._pairs.maxlen and _is_curved(step, change, product):
            self._pairs.append((step, change, product))

    def forget(self) -> bool:
        """Drop everything; tell whether there was anything."""
        known = len(self._pairs) > 0
        self._pairs.clear()
        return known

    def direction(self, gradient: Float[Array, "n nq"], held: Bool[Array, "n nq"]) -> Float[Array, "n nq"]:
        """Return where to go from a point with this gradient, with some joints of some points held."""
        left, shares, pairs = np.where(held, 0.0, gradient), [], self._pairs_beside(held)
        for step, change, product in reversed(pairs):
            shares.append(float(np.vdot(step, left)) / product)
            left -= shares[-1] * change
        moved = self._solve(left, held)
        if pairs:
            _, change, product = pairs[-1]
            moved *= product / float(np.vdot(change, self._solve(change, held)))
        else:
            moved /= self._scale
        for (step, change, product), share in zip(pairs, reversed(shares), strict=True):
            moved += (share - float(np.vdot(change, moved)) / product) * step
        return -moved

    def _pairs_beside(self, held: Bool[Array, "n nq"]) -> list[tuple[Array, Array, float]]:
        """Return what is remembered of the joints that are not held."""
        if not held.any():
            return list(self._pairs)
        beside = [(np.where(held, 0.0, step), np.where(held, 0.0, change)) for step, change, _ in self._pairs]
        pairs = [(step, change, float(np.vdot(step, change))) for step, change in beside]
        return [pair for pair in pairs if _is_curved(*pair)]

    def _solve(self, force: Float[Array, "n nq"], held: Bool[Array, "n nq"]) -> Float[Array, "n nq"]:
        """Spread a force by the metric, over those points of a joint that are not held."""
        moved = self._metric.solve(force)
        for joint in np.flatnonzero(held.any(axis=0)):
            loose = np.flatnonzero(~held[:, joint])
            moved[:, joint] = 0.0
            moved[loose, joint] = np.linalg.solve(self._metric.matrix[np.ix_(loose, loose)], force[loose, joint])
        return moved


def _is_curved(step: Array, change: Array, product: float) -> bool:
    return product > _CURVED * float(np.linalg.norm(step) * np.linalg.norm(change))


@final
class Descent:
    """Goes down from a path, step by step, inside the limits.

    Joints that are at a limit and pushed beyond it are held, and the others move as if they were fixed.

    Args:
        evaluate: The energy.
        metric: That of the paths.
        limits: Lower and upper limits of the joints.
        memory: Steps that L-BFGS remembers; 0 for the covariant gradient.
        longest: No joint of any point moves farther in one step [rad].
        allowed: Which paths a step may lead to; all if None.
    """

    at: Evaluation
    """The path that was reached."""

    def __init__(
        self,
        evaluate: Callable[[Array], Evaluation],
        metric: Smoothness,
        limits: tuple[Float[Array, " nq"], Float[Array, " nq"]],
        memory: int,
        longest: float,
        allowed: Callable[[Array], bool] | None = None,
    ) -> None:
        self._evaluate, self._metric, self._limits, self._longest = evaluate, metric, limits, longest
        self._memory_size, self._allowed = memory, allowed

    def begin(self, at: Evaluation) -> None:
        """Start from a path, with nothing learned."""
        # In free space the energy is that of the metric times the number of edges, all of it stretched by J / V.
        length = np.linalg.norm(np.diff(at.q, axis=0), axis=1).sum()
        stretch = max(_LEAST_STRETCH, float(at.cost.sum() / max(length, _LEAST_STRETCH)))
        self._memory = Memory(self._metric, (self._metric.n + 1) * stretch**2, self._memory_size)
        self.at, self._share = at, 1.0
        self._aim()

    def _aim(self) -> None:
        (lower, upper), inner, gradient = self._limits, self.at.q[1:-1], self.at.gradient
        self._held = ((inner <= lower) & (gradient > 0.0)) | ((inner >= upper) & (gradient < 0.0))
        self._heading = self._memory.direction(gradient, self._held)
        farthest = float(np.abs(self._heading).max(initial=0.0))
        self._reach = min(1.0, self._longest / farthest) if farthest > 0.0 else 1.0

    def attempt(self) -> bool | None:
        """Try one step, one evaluation: True if it was taken, False if not yet, None if there is nowhere to go."""
        t = self._share * self._reach
        moved = self._into_limits(self.at.q[1:-1] + t * self._heading)
        step = moved - self.at.q[1:-1]
        promised = float(np.vdot(self.at.gradient, step))
        q = np.concatenate([self.at.q[:1], moved, self.at.q[-1:]])
        if self._allowed is not None and not self._allowed(q):
            return self._shorten(0.5)
        trial = self._evaluate(q)
        if promised < 0.0 and trial.energy <= self.at.energy + _SUFFICIENT * promised:
            self._memory.learn(step, trial.gradient - self.at.gradient)
            self.at = trial
            self._share = min(1.0, 2.0 * self._share) if self._memory_size else 2.0 * self._share
            self._aim()
            return True
        excess = trial.energy - self.at.energy - promised
        best = -0.5 * promised / excess if excess > 0.0 and promised < 0.0 else 0.0  # of the parabola through both
        return self._shorten(min(0.5, max(0.1, best)))

    def _shorten(self, factor: float) -> bool | None:
        """Try less of the step next; if that is next to nothing, begin anew, or give up if nothing has been learned."""
        self._share *= factor
        if self._share > _SHORTEST:
            return False
        if not self._memory.forget():
            return None
        self._share = 1.0
        self._aim()
        return False

    def _into_limits(self, inner: Float[Array, "n nq"]) -> Float[Array, "n nq"]:
        """Smoothly; but what is held would be drawn along by bumps, and must stay."""
        return np.clip(inner, *self._limits) if self._held.any() else self._metric.into_limits(inner, *self._limits)
