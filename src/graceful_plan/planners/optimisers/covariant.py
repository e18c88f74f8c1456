r"""Descent in the metric of paths: covariant gradient and L-BFGS, with a line search and joint limits.

A step along :math:`-A^{-1} \nabla U` spreads a local force smoothly over the whole path. L-BFGS begins its recursion
with the same inverse, and adds curvature from past steps.

References:
    Nocedal and Wright, "Numerical optimization", 2nd ed., Alg. 7.4 (two-loop recursion) and Alg. 3.1 (backtracking).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Bool, Float
from graceful_plan.planners.optimisers.path_energy import Evaluation
from graceful_plan.planners.optimisers.smoothness import Smoothness

_SUFFICIENT = 1e-4
"""Share of the decrease predicted by the gradient that a step has to achieve (Armijo)."""
_SHORTEST = 1e-4
"""Least step length relative to the full step; below, the direction is abandoned."""
_CURVED = 1e-8
"""Least cosine between a step and the change of the gradient for L-BFGS to store the pair."""

_LEAST_STRETCH = 1e-9
"""Lower bound of the cost per length, against division by zero."""


@final
class Memory:
    """Memory of L-BFGS: pairs of steps and changes of the gradient; without pairs, the plain metric.

    Args:
        metric: Metric of paths.
        scale: Initial estimate of the energy's second derivative relative to the metric.
        size: Number of pairs to store; 0 gives the covariant gradient.
    """

    def __init__(self, metric: Smoothness, scale: float, size: int) -> None:
        self._metric, self._scale = metric, scale
        self._pairs: deque[tuple[Array, Array, float]] = deque(maxlen=size)

    def learn(self, step: Float[Array, "n nq"], change: Float[Array, "n nq"]) -> None:
        """Store a step and the change of the gradient along it."""
        product = float(np.vdot(step, change))
        if self._pairs.maxlen and _is_curved(step, change, product):
            self._pairs.append((step, change, product))

    def forget(self) -> bool:
        """Drop all pairs; return whether there were any."""
        known = len(self._pairs) > 0
        self._pairs.clear()
        return known

    def direction(self, gradient: Float[Array, "n nq"], held: Bool[Array, "n nq"]) -> Float[Array, "n nq"]:
        """Return the descent direction for a gradient, with some joints of some points held."""
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
        """Return the stored pairs, restricted to the joints that are not held."""
        if not held.any():
            return list(self._pairs)
        beside = [(np.where(held, 0.0, step), np.where(held, 0.0, change)) for step, change, _ in self._pairs]
        pairs = [(step, change, float(np.vdot(step, change))) for step, change in beside]
        return [pair for pair in pairs if _is_curved(*pair)]

    def _solve(self, force: Float[Array, "n nq"], held: Bool[Array, "n nq"]) -> Float[Array, "n nq"]:
        """Apply the inverse metric to a force, for each joint over the points where it is not held."""
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
    """Descends from a path, step by step, inside the joint limits.

    Joints at a limit whose descent direction points beyond it are held; the others move as if these were fixed.

    Args:
        evaluate: Computes the energy of a path.
        metric: Metric of paths.
        limits: Lower and upper limits of the joints.
        memory: Number of steps that L-BFGS stores; 0 for the covariant gradient.
        longest: Largest move of a joint of any point in one step [rad].
        allowed: Test whether a step may lead to a path; all paths are accepted if None.
    """

    at: Evaluation
    """The current path."""

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
        """Start from a path with an empty memory."""
        # In free space the energy is that of the metric times the number of edges, scaled by (J / V)^2.
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
        """Try one step with one evaluation; return True if it is taken, False if it is shortened, None at the end."""
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
        best = -0.5 * promised / excess if excess > 0.0 and promised < 0.0 else 0.0  # minimum of the parabola
        return self._shorten(min(0.5, max(0.1, best)))

    def _shorten(self, factor: float) -> bool | None:
        """Shorten the next step; if it becomes too short, clear the memory, or return None if that is empty."""
        self._share *= factor
        if self._share > _SHORTEST:
            return False
        if not self._memory.forget():
            return None
        self._share = 1.0
        self._aim()
        return False

    def _into_limits(self, inner: Float[Array, "n nq"]) -> Float[Array, "n nq"]:
        """Move inner points into the limits: smoothly if no joint is held, else by clamping."""
        return np.clip(inner, *self._limits) if self._held.any() else self._metric.into_limits(inner, *self._limits)
