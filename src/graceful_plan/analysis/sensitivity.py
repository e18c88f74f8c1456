r"""Sensitivity of costs and rankings of paths to the severities, which are rough estimates.

Each entity's severity is multiplied by a random factor,

.. math:: \tilde S_e = S_e \, e^{\sigma z_e}, \qquad z_e \sim N(0, 1) \text{ independent},

and the paths are ranked for each draw. All components share the factor of an entity, because the main uncertainty is
its value. The median of the factor is 1, its mean :math:`e^{\sigma^2 / 2}`. The exposure of each path to each entity is
computed once; the rest is linear algebra. All paths are compared under the same draws.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Float, Int
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.objective import Objective, evaluate
from graceful_plan.documents import table
from graceful_plan.exceptions import SettingError
from graceful_plan.path import Path, real_array
from graceful_plan.scene.scene import Scene
from graceful_plan.setting_checks import not_negative
from graceful_plan.timing.trajectory import Trajectory

INTERVAL = (0.025, 0.975)
"""Quantiles that bound the reported intervals."""
_MOST = 10_000_000  # draws times entities
_EQUAL = 1e-9  # costs that differ by less than this, relative to the greatest, are equal


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class SeveritySensitivity:
    """Costs and ranks of paths under random severities; made by `severity_sensitivity`.

    Intervals hold 95 % of the draws. Paths of equal cost share their rank, the mean of their places; the best has 1.

    | field           | meaning                                                                | shape  |
    |-----------------|------------------------------------------------------------------------|--------|
    | names           | names of the paths                                                     | path   |
    | spread          | standard deviation of the logarithms of the factors                    |        |
    | motion          | V of each path                                                         | path   |
    | impact          | S of each path with the nominal severities                             | path   |
    | total           | J = V + w S with the nominal severities                                | path   |
    | impact_interval | interval of S over the draws                                           | path 2 |
    | total_interval  | interval of J over the draws                                           | path 2 |
    | best            | probability that the path has the least J; ties are shared equally     | path   |
    | least_impact    | probability that the path has the least S; ties are shared equally     | path   |
    | rank            | rank by J with the nominal severities                                  | path   |
    | rank_interval   | interval of the rank by J over the draws                               | path 2 |
    | tau             | Kendall's tau between the rankings by J: of the draw and nominal       | draw   |
    | tau_impact      | Kendall's tau between the rankings by S: of the draw and nominal       | draw   |

    Kendall's tau counts the pairs of paths that differ with the nominal severities; 1 if there are none.
    """

    names: tuple[str, ...]
    spread: float
    motion: Float[Array, " path"]
    impact: Float[Array, " path"]
    total: Float[Array, " path"]
    impact_interval: Float[Array, "path 2"]
    total_interval: Float[Array, "path 2"]
    best: Float[Array, " path"]
    least_impact: Float[Array, " path"]
    rank: Float[Array, " path"]
    rank_interval: Float[Array, "path 2"]
    tau: Float[Array, " draw"]
    tau_impact: Float[Array, " draw"]

    def __str__(self) -> str:
        header = ["path", "motion", "impact", "from", "to", "J", "rank", "from", "to", "P(best)", "P(least impact)"]
        rows = [
            [
                name,
                float(self.motion[i]),
                float(self.impact[i]),
                *self.impact_interval[i].tolist(),
                float(self.total[i]),
                float(self.rank[i]),
                *self.rank_interval[i].tolist(),
                float(self.best[i]),
                float(self.least_impact[i]),
            ]
            for i, name in enumerate(self.names)
        ]
        low, high = np.quantile(self.tau, INTERVAL)
        return (
            table(header, rows)
            + f"\nSeverities times exp(N(0, {self.spread:g}^2)), {len(self.tau)} draws, 95 % intervals."
            + f" Kendall's tau of the ranking by J: {self.tau.mean():.3f} [{low:.3f}, {high:.3f}]"
        )


def severity_sensitivity(
    paths: Mapping[str, Path | Trajectory | ArrayLike] | Sequence[Path | Trajectory | ArrayLike],
    scene: Scene,
    objective: Objective | None = None,
    *,
    spread: float = 0.5,
    n: int = 1000,
    seed: int = 0,
) -> SeveritySensitivity:
    """Compute how costs and ranks of paths vary if every severity is off by a random factor.

    Args:
        paths: Paths, trajectories or arrays of configurations [n, nq], by name or in a sequence.
        scene: The scene, with the carried object attached.
        objective: The objective that ranks them; the default `Objective()` if None. Its impact must be an `ImpactCost`.
        spread: Standard deviation of the logarithm of each entity's factor; 0.5 mostly gives factors of 0.6 to 1.6.
        n: Number of draws.
        seed: Seed of the draws.

    Raises:
        SettingError: If there is no path, a setting is invalid, or the impact is not an `ImpactCost`.
        ShapeError: If a path does not fit the scene.

    Example:
        >>> import graceful_plan as gp
        >>> task = gp.load_scene("tabletop").tasks["green_to_blue"]
        >>> found = {f"w = {w}": gp.plan(task.start, task.goal, task.scene, w=w, iterations=5).path for w in (0, 1)}
        >>> report = gp.severity_sensitivity(found, task.scene)
        >>> float(report.best.sum())
        1.0
    """
    goal = Objective() if objective is None else objective
    if not isinstance(goal.impact, ImpactCost):
        raise SettingError("objective", goal.impact, "one whose impact is an ImpactCost, a sum over severities")
    not_negative("spread", spread)
    if n < 1 or n * max(1, len(scene.entities)) > _MOST:
        raise SettingError("n", n, f"at least 1, and at most {_MOST} draws times entities")
    if seed < 0:
        raise SettingError("seed", seed, "at least 0")
    named = paths if isinstance(paths, Mapping) else {f"path {i}": path for i, path in enumerate(paths)}
    if not named:
        raise SettingError("paths", "()", "at least one path")
    costs = [evaluate(_motion(path), scene, goal) for path in named.values()]
    motion = np.array([cost.motion for cost in costs])
    by_entity = np.array([list(cost.impact_by_entity.values()) for cost in costs]).reshape(len(costs), -1)
    z = np.random.default_rng(seed).normal(size=(n, by_entity.shape[1]))
    return sensitivity_to(tuple(named), spread, motion, goal.w, by_entity, np.exp(spread * z))


def _motion(path: Path | Trajectory | ArrayLike) -> Path | Trajectory | Array:
    return path if isinstance(path, Path | Trajectory) else real_array("path", path)


def sensitivity_to(
    names: tuple[str, ...],
    spread: float,
    motion: Float[Array, " path"],
    w: float,
    by_entity: Float[Array, "path entity"],
    factors: Float[Array, "draw entity"],
) -> SeveritySensitivity:
    """Compute how costs and ranks vary with given factors of the severities.

    Args:
        names: Names of the paths.
        spread: Standard deviation of the logarithms of the factors, for the record.
        motion: V of each path.
        w: Safety weight.
        by_entity: Contribution of each entity to S of each path.
        factors: Factors of the severities.
    """
    impact = by_entity.sum(axis=1)
    # Not a matrix product, in which identical paths may get different rounding errors.
    impacts = np.stack([(factors * row).sum(axis=1) for row in by_entity], axis=1)
    total, totals = motion + w * impact, motion + w * impacts
    ranks = _ranks(totals)
    return SeveritySensitivity(
        names=names,
        spread=spread,
        motion=motion,
        impact=impact,
        total=total,
        impact_interval=np.quantile(impacts, INTERVAL, axis=0).T,
        total_interval=np.quantile(totals, INTERVAL, axis=0).T,
        best=_least(totals),
        least_impact=_least(impacts),
        rank=_ranks(total[None])[0],
        rank_interval=np.quantile(ranks, INTERVAL, axis=0).T,
        tau=_tau(total, totals),
        tau_impact=_tau(impact, impacts),
    )


def _order(values: Float[Array, "draw path"]) -> Int[Array, "draw path path"]:
    """Return 1 where the first of two paths costs more, -1 where it costs less, 0 where they are equal."""
    gap = values[:, :, None] - values[:, None, :]
    scale = np.abs(values).max(axis=1, initial=0.0)[:, None, None]
    return np.where(np.abs(gap) <= _EQUAL * scale, 0, np.sign(gap)).astype(int)


def _ranks(values: Float[Array, "draw path"]) -> Float[Array, "draw path"]:
    order = _order(values)
    return 0.5 * (1.0 + (order >= 0).sum(axis=2) + (order > 0).sum(axis=2))


def _least(values: Float[Array, "draw path"]) -> Float[Array, " path"]:
    least = ~(_order(values) > 0).any(axis=2)
    return (least / least.sum(axis=1, keepdims=True)).mean(axis=0)


def _tau(before: Float[Array, " path"], after: Float[Array, "draw path"]) -> Float[Array, " draw"]:
    was, pairs = _order(before[None])[0], np.triu_indices(len(before), 1)
    signs = was[pairs]
    differing = int(np.count_nonzero(signs))
    if differing == 0:
        return np.ones(len(after))
    return (_order(after)[:, pairs[0], pairs[1]] * signs).sum(axis=1) / differing
