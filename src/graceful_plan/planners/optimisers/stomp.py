r"""STOMP: stochastic trajectory optimisation, a weighted average of noisy copies of a path.

It needs only values, no gradients, so it works with any cost and any obstacles. An iteration is

.. math::
    \epsilon_k \sim N(0, \sigma^2 R^{-1}), \qquad
    P_{k,t} \propto e^{-h\,\hat S_{k,t}}, \qquad
    \theta_t \leftarrow \theta_t + \bigl(M \textstyle\sum_k P_k \odot \epsilon_k\bigr)_t

References:
    Kalakrishnan et al., "STOMP: stochastic trajectory optimization for motion planning", ICRA 2011.
    Differs in: costs are those of edges, so there is no separate control cost; R is tethered, so that noise spans a
    stretch of the path, whose length cycles from the whole path to shorter ones over iterations; costs are averaged
    over such a stretch, and M is this average instead of R^-1, which would blur all but the longest displacements; the
    deviation of each length adapts to its success; points are spaced evenly after each update, since noise along the
    path changes only their spacing.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SettingError
from graceful_plan.path import Path, evenly, plain_numbers
from graceful_plan.planners.interruptible import Interrupted, InterruptibleProblem
from graceful_plan.planners.optimisers.optimiser import Optimiser
from graceful_plan.planners.optimisers.rollouts import Rollouts, finely_checked, weights
from graceful_plan.planners.optimisers.smoothness import Smoothness
from graceful_plan.planners.planner import BoundObjective, Budget, Problem
from graceful_plan.setting_checks import count, positive_or_none

_NEGLIGIBLE = 1e-9
"""Relative gain below which a change is rounding, not an improvement."""
_MORE, _LESS = 1.5, 0.7
"""Factors on the deviation after an iteration that improved the path, and after one that did not."""
_LEAST, _MOST = 0.01, 4.0
"""Bounds of the deviation, relative to the initial deviation."""
_BUMP = 6.7
"""Number of points between the zeros of a bump, times tether ** 0.25."""


@final
@dataclass(frozen=True, kw_only=True)
class STOMP(Optimiser):
    """Improves a path by random perturbations, without gradients, for any cost.

    One iteration is one batch of rollouts, evaluated in one call, and the path that results from them.

    Args:
        points: Number of points of the path between its ends.
        rollouts: Number of noisy paths per iteration.
        elites: Number of best-known paths that take part in the next iteration. They dominate most points and so slow
            the path down: on the bundled tasks, 0 is best.
        sharpness: h of the paper: the higher it is, the more the best rollout at a point counts.
        deviation: Initial standard deviation of the noise in joint space, relative to the length of its stretch.
        reaches: Lengths of the stretches that noise displaces, as shares of the path; iterations cycle through them.
    """

    name: ClassVar[str] = "stomp"

    points: int = 32
    rollouts: int = 12
    elites: int = 0
    sharpness: float = 10.0
    deviation: float = 0.03
    reaches: tuple[float, ...] = (1.0, 0.5, 0.25, 0.12)

    def __post_init__(self) -> None:
        plain_numbers(self)
        count("points", self.points)
        count("rollouts", self.rollouts)
        count("elites", self.elites, 0)
        positive_or_none("sharpness", self.sharpness)
        positive_or_none("deviation", self.deviation)
        if not self.reaches or not all(0.0 < reach <= 1.0 for reach in self.reaches):
            raise SettingError("reaches", self.reaches, "at least one number in (0, 1]")

    def improve(
        self, path: Path, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Yield free paths of decreasing cost between the ends of `path`."""
        if path.length == 0.0:
            return
        questions = InterruptibleProblem(problem, objective, budget)
        with suppress(Interrupted):
            least = np.inf
            if finely_checked(problem).edges_free(path.q[:-1], path.q[1:]).all():
                least = questions.path_cost(path)
            for mean in self._means(path, questions, rng):
                cost = float(mean.cost.sum())
                if not mean.blocked.any() and cost < least * (1.0 - _NEGLIGIBLE):
                    least = cost
                    yield Path(mean.q[0])

    def _means(self, path: Path, questions: InterruptibleProblem, rng: np.random.Generator) -> Iterator[Rollouts]:
        """Yield the mean path, as a batch of one, whenever it has become better."""
        problem = questions.problem
        noises = [_Noise(self, reach, path.length) for reach in self.reaches]
        q = _into_limits(evenly(path.q, self.points + 2)[None], noises[0].metric, problem)
        if not questions.budget.spend():
            return
        mean = Rollouts.asked(q, questions).with_first_finely_checked(problem)
        elites = mean[:0]
        yield mean
        iteration = 0
        while questions.budget.spend():
            noise = noises[iteration % len(noises)]
            iteration += 1
            q = _into_limits(noise.around(mean.q[0], self.rollouts, rng), noise.metric, problem)
            seen = Rollouts.joined([mean, Rollouts.asked(q, questions), elites])
            q = _evened(_into_limits(self._update(mean.q[0], seen, noise), noise.metric, problem), problem)
            ranked = self._ranked(Rollouts.joined([seen, Rollouts.asked(q, questions)]), mean, problem)
            elites, helped = ranked[1:], ranked.beats(mean, _NEGLIGIBLE)
            noise.adapt(helped)
            if helped:
                mean = ranked[:1]
                yield mean

    def _ranked(self, seen: Rollouts, mean: Rollouts, problem: Problem) -> Rollouts:
        """Return the best paths, the best first; if the first beats the mean, it is checked at the fine step, too."""
        ranked = seen.best(self.elites + 1)
        while ranked.beats(mean, _NEGLIGIBLE):
            checked = ranked.with_first_finely_checked(problem)
            if checked is ranked:
                break
            ranked = checked.best(len(checked))
        return ranked

    def _update(self, mean: Float[Array, "point nq"], seen: Rollouts, noise: _Noise) -> Float[Array, "1 point nq"]:
        weight = weights(seen, noise.average, self.sharpness)
        shift = np.einsum("kt,ktj->tj", weight, seen.q[:, 1:-1] - mean[1:-1])
        moved = mean.copy()
        moved[1:-1] += noise.average @ shift
        return moved[None]


@final
class _Noise:
    """Noise of one length of stretch: its shape and adaptive deviation."""

    def __init__(self, settings: STOMP, reach: float, length: float) -> None:
        n = settings.points
        stretch = reach * (n + 1)
        self.metric = Smoothness(n, tether=0.0 if reach == 1.0 else (_BUMP / stretch) ** 4)
        average = Smoothness(n, order=1, tether=(6.0 / stretch) ** 2).inverse
        self.average = average / average.sum(axis=1, keepdims=True)
        self.deviation = self.first = settings.deviation * reach * length

    def around(self, mean: Float[Array, "point nq"], n: int, rng: np.random.Generator) -> Float[Array, "n point nq"]:
        """Return noisy copies of a path; the ends are unchanged."""
        nq = mean.shape[1]
        q = np.tile(mean, (n, 1, 1))
        q[:, 1:-1] += self.deviation / np.sqrt(nq) * self.metric.noise(n, nq, rng)
        return q

    def adapt(self, helped: bool) -> None:
        """Increase the deviation after an iteration that improved the path, else decrease it."""
        factor = _MORE if helped else _LESS
        self.deviation = float(np.clip(factor * self.deviation, _LEAST * self.first, _MOST * self.first))


def _into_limits(q: Float[Array, "n point nq"], metric: Smoothness, problem: Problem) -> Float[Array, "n point nq"]:
    moved = q.copy()
    moved[:, 1:-1] = metric.into_limits(q[:, 1:-1], problem.lower, problem.upper)
    return moved


def _evened(q: Float[Array, "n point nq"], problem: Problem) -> Float[Array, "n point nq"]:
    """Space the points evenly; clamp them, since rounding may exceed the limits."""
    even = np.stack([evenly(path, q.shape[1]) for path in q])
    even[:, 1:-1] = np.clip(even[:, 1:-1], problem.lower, problem.upper)
    return even
