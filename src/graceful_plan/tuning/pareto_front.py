r"""The front of motion against impact: choice of a point, weight that leads to it, quality of the front.

A point dominates another if it costs no more in motion V and in impact S, and less in one of them. A front holds only
non-dominated points. Minimising V + w S reaches exactly the points on the lower convex hull. Other methods find the
remaining points, which no safety weight leads to.

References:
    I. Das and J. E. Dennis, "A closer look at drawbacks of minimizing weighted sums of objectives for Pareto set
        generation", Structural Optimization 1997.
    E. Zitzler and L. Thiele, "Multiobjective evolutionary algorithms: a comparative case study and the strength Pareto
        approach", IEEE TEC 1999 (hypervolume).
    I. Das, "On characterizing the knee of the Pareto curve", Structural Optimization 1999.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from pathlib import Path as FilePath
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SettingError, names_file
from graceful_plan.path import finite_array
from graceful_plan.result import PlanStatus
from graceful_plan.tuning.front_file import FrontParts, front_text, read_front
from graceful_plan.tuning.points import ParetoPoint, dominated_area

REFERENCE = 1.1
"""Factor on the largest motion and impact of a front that gives its own reference point."""


class ChoiceStatus(Enum):
    """How a choice ended; the value is a sentence with a remedy."""

    MET = "A point of the front meets every demand."
    UNREACHABLE = "No point of the front meets every demand; relax one of them, or search longer."
    NO_FRONT = "The front is empty; see its status."


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Choice:
    """The point and weight that a front offers for given demands.

    Args:
        status: Whether the demands can be met.
        point: The point of least motion that meets them, or of least impact if only the detour is limited. If they
            cannot be met, the nearest miss: the point of least impact within the detour, or overall.
        w: Smallest safety weight whose best point on the front meets the demands; None if there is none.
        detail: Explanation of the status.
    """

    status: ChoiceStatus
    point: ParetoPoint | None = None
    w: float | None = None
    detail: str = ""


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class ParetoFront:
    """Verified motions between one start and one goal, none dominated by another, sorted by motion.

    Args:
        status: SOLVED if there is at least one point; otherwise the reason, as in `plan`.
        points: The points, sorted by motion.
        detail: Explanation of the status.
        scene: Name of the scene.
        stats: Seconds per stage, iterations spent, number of rejected candidates.
    """

    status: PlanStatus
    points: tuple[ParetoPoint, ...] = ()
    detail: str = ""
    scene: str = ""
    stats: Mapping[str, float] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.points)

    @cached_property
    def costs(self) -> Float[Array, "n 2"]:
        """Motion and impact of each point."""
        return np.array([(point.motion, point.impact) for point in self.points], dtype=np.float64).reshape(-1, 2)

    @property
    def reference(self) -> Float[Array, " 2"]:
        """The front's own reference point: `REFERENCE` times its largest motion and impact."""
        return REFERENCE * self.costs.max(axis=0) if len(self) else np.zeros(2)

    def hypervolume(self, reference: ArrayLike | None = None) -> float:
        """Return the fraction of the rectangle between zero and the reference that the front dominates.

        Args:
            reference: Motion and impact; by default the front's own. Compare fronts only at the same reference.

        Raises:
            SettingError: If the reference is not positive.
        """
        corner = self.reference if reference is None else finite_array("reference", reference, ndim=1, last=2)
        if reference is not None and np.any(corner <= 0.0):
            raise SettingError("reference", corner.tolist(), "a motion and an impact > 0")
        area = float(np.prod(corner))
        return dominated_area(self.costs, corner) / area if area > 0.0 else 0.0

    @property
    def knee(self) -> ParetoPoint | None:
        """The point farthest below the chord of the front, with both axes scaled to its extent; None if it is empty.

        From there on, a further reduction of impact costs much motion, and a further reduction of motion much impact.
        """
        if not len(self):
            return None
        low, extent = self.costs.min(axis=0), np.ptp(self.costs, axis=0)
        scaled = (self.costs - low) / np.where(extent > 0.0, extent, 1.0)
        return self.points[int(np.argmin(np.round(scaled.sum(axis=1), 12)))]

    def smallest_w(self, target_impact: float) -> float | None:
        """Return the smallest safety weight whose best point has at most this impact; None if there is none."""
        return self.choose(target_impact=target_impact).w

    def choose(self, *, target_impact: float | None = None, max_detour: float | None = None) -> Choice:
        """Choose point and weight for a target impact, a limit on the detour, or both; by default the knee.

        Args:
            target_impact: Largest impact S.
            max_detour: Largest motion beyond that of the shortest point, relative to it: 0.05 allows 5 % more.

        Raises:
            SettingError: If a demand is not a number of at least 0.
        """
        for name, value in (("target_impact", target_impact), ("max_detour", max_detour)):
            if value is not None and not (np.isfinite(value) and value >= 0.0):
                raise SettingError(name, value, "a finite number, at least 0")
        knee = self.knee
        if knee is None:
            return Choice(status=ChoiceStatus.NO_FRONT, detail=f"{self.status.name}: {self.detail}".rstrip(": "))
        if target_impact is None and max_detour is None:
            return Choice(status=ChoiceStatus.MET, point=knee, w=_weight(knee), detail="the knee")
        shortest = self.points[0].motion
        within = [p for p in self.points if max_detour is None or p.motion <= (1.0 + max_detour) * shortest]
        meets = [p for p in within if target_impact is None or p.impact <= target_impact]
        if not meets:
            return self._missed(within[-1], target_impact)
        # Along the front motion rises and impact falls, so the first that meets a target is the shortest.
        point = meets[0] if target_impact is not None else meets[-1]
        weighted = [p for p in meets if p.weights is not None]
        chosen = (weighted[0] if target_impact is not None else weighted[-1]) if weighted else None
        detail = f"motion {100.0 * (point.motion / shortest - 1.0):.3g} % above the shortest" if shortest else ""
        if chosen is None:
            detail += "; no weight leads to a point that meets the demands, as the front is not convex there"
        elif chosen is not point:
            detail += f"; w leads to motion {chosen.motion:.4g}, impact {chosen.impact:.4g}, as the front is not convex"
        return Choice(status=ChoiceStatus.MET, point=point, w=_weight(chosen), detail=detail)

    def _missed(self, nearest: ParetoPoint, target: float | None) -> Choice:
        there = f"impact {nearest.impact:.4g} at motion {nearest.motion:.4g}"
        reachable = [p for p in self.points if target is not None and p.impact <= target]
        detail = f"the least within the demands is {there}"
        if reachable:
            detour = reachable[0].motion / self.points[0].motion - 1.0
            detail += f"; the target takes a detour of {100.0 * detour:.3g} %"
        return Choice(status=ChoiceStatus.UNREACHABLE, point=nearest, detail=detail)

    def to_json(self, file: str | FilePath | None = None) -> str:
        """Return the front as JSON text, trajectories included; write it to `file` if one is given."""
        parts = FrontParts(self.status, self.points, self.detail, self.scene, self.stats)
        text = front_text(parts)
        if file is not None:
            FilePath(file).write_text(text, encoding="utf-8")
        return text

    def save(self, file: str | FilePath) -> None:
        """Write the front to a JSON file."""
        self.to_json(file)

    @classmethod
    @names_file
    def load(cls, source: str | FilePath) -> ParetoFront:
        """Read a front written by `save` or `to_json`, from a file or JSON text (a string that starts with a brace).

        No code is executed. Costs and verdicts are those of the file; check them with `verify` and `evaluate`.

        Raises:
            FormatError: If the document is not a front.
            GracefulPlanError: If a path or trajectory in it is broken.
        """
        parts = read_front(source)
        return cls(status=parts.status, points=parts.points, detail=parts.detail, scene=parts.scene, stats=parts.stats)


def _weight(point: ParetoPoint | None) -> float | None:
    return None if point is None or point.weights is None else point.weights[0]
