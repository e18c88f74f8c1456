r"""Selection and refinement of paths by a risk measure that is not additive along a path.

The search minimises J = V + w S, where S = T E[impact] is exposure (T: time, or whatever the objective integrates over)
times the mean impact of a failure. With another measure rho of the distribution of impact (`risk`), paths are compared
by

.. math:: J_\rho = V + w\, T\, \rho(\mathrm{impact} \mid \mathrm{failure})

which for rho = E is J. It has no optimal substructure: whether a detour pays depends on the whole rest of the path, so
a tree search must not minimise it. It is used only at the end: among the improvements of a search by J, the path of
least J_rho is selected and refined by local moves that lower J_rho. Paths far from all improvements are not found, even
if their J_rho is lower. The returned path may have a higher J than the best path by J.

References:
    O. Salzman, B. Hou, S. Srinivasa, "Efficient motion planning for problems lacking optimal substructure", ICAPS
    2017, on why search must not use such measures.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from graceful_plan.analysis.harm_law import HarmLaw
from graceful_plan.analysis.risk_measures import RiskMeasure
from graceful_plan.array_types import Array, Float
from graceful_plan.core.kernels import COST_STEP, FINE_STEP
from graceful_plan.costs.cost import StateBatch, checked_state
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.path import Path
from graceful_plan.planners.interruptible import out_of_time
from graceful_plan.planners.planner import Budget, Planner
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.planners.shortcut import MOVES, Line, Replacement
from graceful_plan.query.candidates.search import ALL, Search, search, subsampled
from graceful_plan.timing.trajectory import Trajectory

_SEARCH = 0.8
"""Share of the time for the search; the rest is for refinement."""
_STEP = 4.0 * COST_STEP
"""Largest distance between samples during refinement [rad]."""
_ROUNDS = 100
"""Most rounds of refinement, each with one move."""
_PATIENCE = 24
"""Rounds without an improvement after which refinement ends."""
_PROPOSALS = 12
"""Replacements proposed in a round."""
_LEAST_REACH = 0.05
"""Length of the shortest stretch that is replaced, as a fraction of the path."""
_SUMS = 96
"""Grid size of impact distributions during refinement."""
_GAIN = 1e-6
"""Relative decrease of J_rho that counts as an improvement."""


class EdgeRisk(NamedTuple):
    """Contributions of edges to a path. All three are additive; only the risk measure is not."""

    motion: Float[Array, " n"]
    exposure: Float[Array, " n"]
    mass: Float[Array, "n atom"]
    """Distribution of the impact times the exposure."""


class Preference:
    """A risk measure in a scene.

    Args:
        measure: Risk measure of the distribution of impact.
        objective: Objective of the search.

    Raises:
        SettingError: If the objective's impact has no interaction model.
    """

    def __init__(self, measure: RiskMeasure, objective: SceneObjective) -> None:
        self.measure, self.objective = measure, objective
        self.law = HarmLaw(objective.objective.impact, objective.scene, most_sums=_SUMS)

    def total(self, motion: Path | Trajectory) -> float:
        """J_rho of a path, or of a trajectory with its actual times."""
        if isinstance(motion, Trajectory) and self.objective.objective.exposure == "time":
            samples = self.objective.cost_samples(motion)
            mass = samples.weight @ self.law.states(samples.batch)
            length = np.array([self.objective.breakdown(motion).motion])
            return float(self.totals(length, samples.weight.sum(keepdims=True), mass[None])[0])
        path = motion.path if isinstance(motion, Trajectory) else motion
        parts = self.edges(path.q[:-1], path.q[1:])
        return float(self.totals(*(part.sum(axis=0, keepdims=True) for part in parts))[0])

    def edges(self, q0: Float[Array, "n nq"], q1: Float[Array, "n nq"], step: float = COST_STEP) -> EdgeRisk:
        """Evaluate straight edges from `q0` to `q1`, at samples no farther apart than `step` [rad]."""
        objective, scene = self.objective.objective, self.objective.scene
        samples = self.objective.samples(q0, q1, step)
        batch = StateBatch(scene, samples.q, samples.direction, samples.speed)
        motion = samples.integral(checked_state(objective.motion, batch), samples.length)
        if objective.exposure == "waypoints":
            return EdgeRisk(motion, np.ones(len(q1)), self.law.states(StateBatch(scene, q1)))
        measure = samples.length if objective.exposure == "length" else samples.duration
        mass = self.law.states(batch) * samples.weights(measure)[:, None]
        summed = np.add.reduceat(mass, samples.first) if len(q0) else np.zeros((0, mass.shape[1]))
        return EdgeRisk(motion, measure, summed)

    def search(
        self,
        planner: Planner,
        problem: SceneProblem,
        budget: Budget,
        rng: np.random.Generator,
    ) -> Search:
        """Search by J, then order the improvements by J_rho and refine the best one; the refined path is the last."""
        with budget.share(_SEARCH * budget.remaining_seconds) as part:
            found = search(planner, problem, self.objective, part, rng, kept=ALL)
        if found.paths and self.objective.w > 0.0:
            kept = (found.paths[index] for index in subsampled(len(found.paths)))
            found.paths = sorted(kept, key=self.total, reverse=True)
            found.paths.append(self.refined(found.paths[-1], problem, budget, rng))
        return found

    def refined(self, path: Path, problem: SceneProblem, budget: Budget, rng: np.random.Generator) -> Path:
        """Improve a path by local moves, until the time is over or moves no longer help; uses no planner iterations."""
        if len(path.without_duplicates()) < 2:
            return path
        line = _Refined(path, self)
        idle = round_ = 0
        while idle < _PATIENCE and round_ < _ROUNDS and not out_of_time(budget):
            reach = _LEAST_REACH ** rng.uniform()
            proposals = MOVES[round_ % len(MOVES)](line.line, _PROPOSALS, reach, rng)
            idle = 0 if line.take_best(proposals, problem) else idle + 1
            round_ += 1
        refined = Path(line.line.q)
        return refined if self.total(refined) < self.total(path) else path  # at the finer step

    def totals(
        self, motion: Float[Array, " n"], exposure: Float[Array, " n"], mass: Float[Array, "n atom"]
    ) -> Float[Array, " n"]:
        """J_rho of paths from the sums over their edges; see `EdgeRisk`."""
        mass = np.maximum(mass, 0.0)  # differences of sums may be negative by rounding
        share = mass.sum(axis=1)
        worth = self.measure.of(self.law.value, mass / np.where(share > 0.0, share, 1.0)[:, None])
        return motion + self.objective.w * exposure * worth


class _Refined:
    """A path under refinement, with cumulative sums over its edges."""

    def __init__(self, path: Path, preference: Preference) -> None:
        self.preference = preference
        self._set(path.without_duplicates().q)

    def _set(self, q: Float[Array, "vertex nq"]) -> None:
        self.line = Line(q, np.zeros(len(q) - 1))
        parts = self.preference.edges(q[:-1], q[1:], _STEP)
        self.sums = [np.concatenate([np.zeros_like(part[:1]), np.cumsum(part, axis=0)]) for part in parts]
        self.total = float(self.preference.totals(*(total[-1:] for total in self.sums))[0])

    def take_best(self, proposals: list[Replacement], problem: SceneProblem) -> bool:
        """Apply the free replacement that lowers J_rho most; return False if there is none."""
        proposals = [p for p in proposals if np.all((p.q >= problem.lower) & (p.q <= problem.upper))]
        if not proposals:
            return False
        q0, q1 = np.concatenate([p.q[:-1] for p in proposals]), np.concatenate([p.q[1:] for p in proposals])
        begin = np.cumsum([0] + [len(p.q) - 1 for p in proposals])
        first, last = np.array([p.first for p in proposals]), np.array([p.last for p in proposals])
        parts = self.preference.edges(q0, q1, _STEP)
        after = [
            total[-1] - (total[last] - total[first]) + np.add.reduceat(part, begin[:-1])
            for total, part in zip(self.sums, parts, strict=True)
        ]
        totals = self.preference.totals(*after)
        better = np.flatnonzero(totals < self.total - _GAIN * abs(self.total))
        for k in better[np.argsort(totals[better], kind="stable")].tolist():
            edges = slice(begin[k], begin[k + 1])
            if np.all(problem.kernels.edges_free(q0[edges], q1[edges], FINE_STEP, problem.margin)):
                p = proposals[k]
                whole = np.concatenate([self.line.q[: p.first], p.q, self.line.q[p.last + 1 :]])
                self._set(Path(whole).without_duplicates().q)
                return True
        return False
