"""Explain the impact of a motion: which entity is hit, by which component, after which failure, along which stretch.

An explanation decomposes the cost of `Objective`. It reads the same states with the same weights, so its parts add up
to the impact of the cost breakdown.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, final

import numpy as np

from graceful_plan import documents
from graceful_plan.array_types import Array, Float
from graceful_plan.costs.cost_samples import CostSamples
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.objective import Objective
from graceful_plan.exceptions import CostError, SettingError
from graceful_plan.path import Path
from graceful_plan.result import CostBreakdown, PlanningFailed, PlanResult
from graceful_plan.scene.elements import Carried
from graceful_plan.scene.scene import Scene
from graceful_plan.setting_checks import finite
from graceful_plan.timing.trajectory import Trajectory

STRETCH = 0.9
"""Share of a contribution that lies on its reported stretch."""
_MEASURES = {
    "length": "severity expected at a failure, times radians of motion",
    "time": "severity expected at a failure, times seconds of motion",
    "waypoints": "severity expected at a failure, summed over waypoints",
}
_ROUNDING = 1e-9
"""Relative tolerance for two sums to count as equal."""
_SHOWN = 12
"""Number of rows in the text; all others are added up in the last one."""
_FAULTS_SHOWN = 2


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Contribution:
    """One part of the impact: a component of the robot hits an entity after one kind of failure."""

    event: str
    """The event in words."""
    entity: str
    component: str
    source: str
    """Kind of failure, from `InteractionModel.sources`."""
    faults: Mapping[str, float]
    """Faults that cause it, the most likely first, with shares that sum to 1; empty if unknown."""
    impact: float
    share: float
    """Share of the total impact, in [0, 1]."""
    begin: float
    """Begin of the shortest stretch that holds `STRETCH` of this part, as joint-space length from the start [rad]."""
    end: float
    worst: float
    """Where its probability is highest, as joint-space length from the start [rad]."""
    begin_time: float | None
    """`begin`, `end` and `worst` as times [s]; None on a path without times."""
    end_time: float | None
    worst_time: float | None
    severity: float
    probability: float
    """P at the worst state, given a failure there."""
    position: tuple[float, float, float]
    """Position of the carried object (of the tool, if nothing is carried) at the worst state, in W [m]."""


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Explanation:
    """The impact along a motion, and its contributions by cause.

    | field         | meaning                                                        | unit | shape         |
    |---------------|----------------------------------------------------------------|------|---------------|
    | cost          | breakdown by the objective                                     |      |               |
    | exposure      | integration variable of the impact: length, time, waypoints    |      |               |
    | entities      | names of the entities                                          |      | entity        |
    | place         | joint-space length from the start at each state                | rad  | n             |
    | time          | time of each state; None on a path                             | s    | n             |
    | weight        | integration weight of each state                               |      | n             |
    | by_entity     | impact density: P S per unit of exposure, given a failure      |      | n entity      |
    | contributions | parts of the impact, largest first                             |      |               |
    """

    cost: CostBreakdown
    exposure: str
    entities: tuple[str, ...]
    place: Float[Array, " n"]
    time: Float[Array, " n"] | None
    weight: Float[Array, " n"]
    by_entity: Float[Array, "n entity"]
    contributions: tuple[Contribution, ...]

    @cached_property
    def density(self) -> Float[Array, " n"]:
        """Impact density at each state."""
        return self.by_entity.sum(axis=1)

    def to_document(self) -> dict[str, Any]:
        """Return everything as a document of plain numbers, lists and mappings."""
        return {
            "schema": "graceful_plan.explanation",
            "version": 1,
            "exposure": self.exposure,
            "cost": documents.cost_document(self.cost),
            "contributions": [_row_document(row) for row in self.contributions],
            "along": {
                "place": self.place.tolist(),
                "time": None if self.time is None else self.time.tolist(),
                "weight": self.weight.tolist(),
                "by_entity": dict(zip(self.entities, self.by_entity.T.tolist(), strict=True)),
            },
        }

    def to_json(self) -> str:
        """Return `to_document()` as JSON text."""
        return documents.to_json(self.to_document())

    def __str__(self) -> str:
        """Describe the largest contributions in plain words."""
        if not self.contributions:
            return "impact 0: whatever fails, nothing is hit that matters"
        shown, rest = self.contributions[:_SHOWN], self.contributions[_SHOWN:]
        header = ["what happens", "share", f"{STRETCH:.0%} of it between", "worst at", "object then at [m]"]
        header += ["P there", "severity", "after"]
        rows = [_words(row) for row in shown]
        if not any(row.faults for row in shown):
            header, rows = header[:-1], [row[:-1] for row in rows]
        text = f"impact {self.cost.impact:.4g}, {_MEASURES[self.exposure]}\n\n{documents.table(header, rows)}"
        left = math.fsum(row.share for row in rest)
        return text + (f"\nand {len(rest)} others: {left:.1%}" if rest else "")


def explain(
    motion: Path | Trajectory | PlanResult,
    scene: Scene,
    objective: Objective | None = None,
    *,
    start_time: float = 0.0,
) -> Explanation:
    """Decompose the impact of a motion into its contributions.

    Args:
        motion: The motion. Of a `PlanResult`, its trajectory.
        scene: The scene, with the carried object attached.
        objective: The objective that evaluates the motion; the default `Objective()` if None.
        start_time: Offset from the trajectory's times to the clock of the scene's predictions [s].

    Raises:
        CostError: If the sources of the interaction model do not add up to its probability.
        PlanningFailed: If the result of a plan has no trajectory.
        SettingError: If the objective's impact is not an `ImpactCost`, the only cost that resolves entities and
            components, or the start time is not finite.
        ShapeError: If the motion does not fit the scene.
    """
    objective = objective or Objective()
    if not isinstance(objective.impact, ImpactCost):
        raise SettingError("objective.impact", objective.impact, "an ImpactCost: other costs do not resolve entities")
    finite("start_time", start_time, "a finite time [s]")
    if isinstance(motion, PlanResult):
        if motion.trajectory is None:
            raise PlanningFailed(motion)
        motion = motion.trajectory
    bound = objective.bind(scene)
    samples = bound.cost_samples(motion, start_time)
    along = _Along(samples, motion)
    sources = objective.impact.sources(samples.batch)
    severity = objective.impact.severity_table(scene)
    cost = bound.breakdown(motion, start_time)
    by_entity = np.sum([np.einsum("nce,ce->ne", P, severity) for P in sources.values()], axis=0)
    found = float(samples.weight @ by_entity.sum(axis=1))
    if abs(found - cost.impact) > _ROUNDING * cost.impact:
        problem = f"sources() add up to an impact of {found:.6g}, probability() to {cost.impact:.6g}"
        raise CostError(objective.impact.interaction, problem)
    return Explanation(
        cost=cost,
        exposure=objective.exposure,
        entities=objective.impact.harmed_entities(scene),
        place=along.place,
        time=along.time,
        weight=samples.weight,
        by_entity=by_entity,
        contributions=_contributions(scene, along, objective.impact, sources),
    )


@final
class _Along:
    """The evaluated states of a motion, with their places and times."""

    def __init__(self, samples: CostSamples, motion: Path | Trajectory) -> None:
        points = motion.path if isinstance(motion, Trajectory) else motion
        vertices = np.arange(len(points))
        length = np.concatenate([[0.0], np.cumsum(points.segment_lengths)])
        self.batch, self.weight = samples.batch, samples.weight
        self.place = np.interp(samples.place, vertices, length)
        self.time = np.interp(samples.place, vertices, motion.t) if isinstance(motion, Trajectory) else None

    def time_at(self, index: int) -> float | None:
        """Time of a state [s], None on a path."""
        return None if self.time is None else float(self.time[index])

    def position(self, index: int) -> tuple[float, float, float]:
        """Position of the carried object, or else of the tool, in W [m]."""
        poses = self.batch.tool_poses if self.batch.scene.carried is None else self.batch.object_poses
        x, y, z = poses[index, :3, 3].tolist()
        return x, y, z


def _contributions(
    scene: Scene, along: _Along, objective: ImpactCost, sources: Mapping[str, Float[Array, "n component entity"]]
) -> tuple[Contribution, ...]:
    """Return the parts of the impact by source, component and entity, the largest first."""
    severity, faults = objective.severity_table(scene), objective.interaction.fault_shares()
    components, entities = tuple(scene.components), objective.harmed_entities(scene)
    parts = {name: np.tensordot(along.weight, P, axes=1) * severity for name, P in sources.items()}
    total = math.fsum(float(part.sum()) for part in parts.values())
    rows = [
        _contribution(along, name, (components[c], entities[e]), sources[name][:, c, e], float(severity[c, e]), total)
        for name, part in parts.items()
        for c, e in np.argwhere(part > 0.0).tolist()
    ]
    rows = [replace(row, faults=_normalised(faults.get(row.source, {}))) for row in rows]
    return tuple(sorted(rows, key=lambda row: -row.impact))


def _contribution(
    along: _Along,
    source: str,
    hit: tuple[str, str],
    probability: Float[Array, " n"],
    severity: float,
    total: float,
) -> Contribution:
    scene = along.batch.scene
    component, entity = hit
    mass = along.weight * probability * severity
    first, last = shortest_stretch(along.place, mass, STRETCH)
    worst = int(np.argmax(probability))
    return Contribution(
        event=_phrase(source, component, scene.carried, entity),
        entity=entity,
        component=component,
        source=source,
        faults={},
        impact=float(mass.sum()),
        share=float(mass.sum()) / total,
        begin=float(along.place[first]),
        end=float(along.place[last]),
        worst=float(along.place[worst]),
        begin_time=along.time_at(first),
        end_time=along.time_at(last),
        worst_time=along.time_at(worst),
        severity=severity,
        probability=float(probability[worst]),
        position=along.position(worst),
    )


def _normalised(weights: Mapping[str, float]) -> Mapping[str, float]:
    total = math.fsum(weights.values())
    ordered = sorted(weights.items(), key=lambda item: -item[1])
    return {fault: weight / total for fault, weight in ordered if weight > 0.0}


def shortest_stretch(place: Float[Array, " n"], mass: Float[Array, " n"], share: float) -> tuple[int, int]:
    """Return the first and the last state of the shortest stretch that holds a share of the total mass.

    Args:
        place: Positions of the states, not decreasing.
        mass: Mass of each state, at least 0, not all 0.
        share: Share of the total, in (0, 1].
    """
    total = np.concatenate([[0.0], np.cumsum(mass)])
    needed = share * total[-1] * (1.0 - 1e-12)  # rounding must not require more than the total
    last = np.searchsorted(total[1:], total[:-1] + needed)
    starts = np.flatnonzero(last < len(place))
    first = int(starts[np.argmin(place[last[starts]] - place[starts])])
    return first, int(last[first])


# --- in words ---------------------------------------------------------------------------------------------------------

_PHRASES: Mapping[str, Mapping[str, str]] = {
    "drop": {"carried": "dropped {object} onto {entity}", "contents": "contents of dropped {object} onto {entity}"},
    "spill": {"contents": "spilt contents of {object} onto {entity}"},
    "stop": {"contents": "contents of {object} thrown onto {entity} by a stop"},
    "collapse": {"body": "collapsing arm into {entity}", "carried": "{object} held by a collapsing arm into {entity}"},
    "joint": {"body": "arm with a limp joint into {entity}", "carried": "{object} held by a limp arm into {entity}"},
    "stuck": {"body": "arm with a stuck joint into {entity}", "carried": "{object} held by a stuck arm into {entity}"},
    "stray": {"body": "straying arm into {entity}", "carried": "{object} held by a straying arm into {entity}"},
    "failure": {
        "body": "arm into {entity}",
        "carried": "{object} onto {entity}",
        "contents": "contents of {object} onto {entity}",
    },
}
"""Event in words, by source and component."""


def _phrase(source: str, component: str, carried: Carried | None, entity: str) -> str:
    if carried is not None and entity == carried.body:
        return f"{entity} itself, by its fall" if source == "drop" else f"{entity} itself ({source})"
    object_name = "the object" if carried is None else carried.body
    other = f"{component} onto {{entity}} ({source})"
    return _PHRASES.get(source, {}).get(component, other).format(object=object_name, entity=entity)


def _words(row: Contribution) -> list[object]:
    stretch, worst = f"{row.begin:.2f} and {row.end:.2f} rad", f"{row.worst:.2f} rad"
    if row.worst_time is not None:
        stretch += f" ({row.begin_time:.2f} and {row.end_time:.2f} s)"
        worst += f" ({row.worst_time:.2f} s)"
    place = ", ".join(f"{x:.2f}" for x in row.position)
    after = ", ".join(f"{fault} {share:.0%}" for fault, share in list(row.faults.items())[:_FAULTS_SHOWN])
    return [row.event, f"{row.share:5.1%}", stretch, worst, place, row.probability, row.severity, after]


def _row_document(row: Contribution) -> dict[str, Any]:
    return {name.name: getattr(row, name.name) for name in fields(row)}
