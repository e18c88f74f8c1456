"""Pareto fronts as JSON documents; reading them executes no code."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping
from pathlib import Path as FilePath
from typing import Any, NamedTuple, final

from graceful_plan import documents
from graceful_plan.exceptions import FormatError, naming
from graceful_plan.formats.samples import text_of
from graceful_plan.path import Path, finite_array
from graceful_plan.result import Check, CostBreakdown, PlanStatus, Verdict
from graceful_plan.timing.trajectory import Trajectory
from graceful_plan.tuning.points import ParetoPoint, front_of
from graceful_plan.untrusted_json import check_keys, parse_json

_SCHEMA = {"schema": "graceful_plan.pareto_front", "version": 1}
_KEYS = {"scene", "status", "detail", "stats", "points"}
_POINT = {"made_by", "made_with", "weights", "cost", "verdict", "path", "trajectory"}
_COST = {"motion", "impact", "w", "total", "impact_by_entity", "impact_by_component"}
_CHECK = {"passed", "worst", "limit", "first", "detail"}


class FrontParts(NamedTuple):
    """The fields of a front; see `ParetoFront`."""

    status: PlanStatus
    points: tuple[ParetoPoint, ...]
    detail: str
    scene: str
    stats: Mapping[str, float]


def front_text(front: FrontParts) -> str:
    """Return strict JSON text on one line; numbers that are not finite become null."""
    points = [
        {
            "made_by": point.made_by,
            "made_with": point.made_with,
            "weights": None if point.weights is None else list(point.weights),
            "cost": documents.cost_document(point.cost),
            "verdict": documents.verdict_document(point.verdict),
            "path": point.path.q.tolist(),
            "trajectory": json.loads(point.trajectory.to_json()),
        }
        for point in front.points
    ]
    document = {
        **_SCHEMA,
        "scene": front.scene,
        "status": front.status.name,
        "detail": front.detail,
        "stats": dict(front.stats),
        "points": points,
    }
    return json.dumps(json.loads(documents.to_json(document)), allow_nan=False) + "\n"


def read_front(source: str | FilePath) -> FrontParts:
    """Read a front from a file or from JSON text.

    Raises:
        FormatError: If the document is not a front.
    """
    name, text = text_of(source, lambda text: text.lstrip().startswith("{"), "JSON")
    return _FrontReader(name).front(parse_json(text, name))


@final
class _FrontReader:
    """Reads the parts of a document; errors name the file and the part."""

    def __init__(self, name: str) -> None:
        self.name = name

    def front(self, document: Any) -> FrontParts:
        check_keys(self.name, document, {*_SCHEMA, *_KEYS})
        for key, value in _SCHEMA.items():
            if document[key] != value:
                raise FormatError(self.name, f"{key} is {document[key]!r}, this version reads {value!r}")
        status, stats, points = document["status"], document["stats"], document["points"]
        if not isinstance(status, str) or status not in PlanStatus.__members__:
            raise FormatError(self.name, f"status is {status!r}; expected: {', '.join(PlanStatus.__members__)}")
        if not isinstance(points, list):
            raise FormatError(self.name, "points must be a list")
        found = [self._point(f"points[{i}]", point) for i, point in enumerate(points)]
        front = front_of(found)
        if len(front) < len(found) or (status == PlanStatus.SOLVED.name) != bool(found):
            raise FormatError(self.name, "its points are not a front: some are better than others, or it is empty")
        return FrontParts(
            status=PlanStatus[status],
            points=front,
            detail=self._text("detail", document["detail"]),
            scene=self._text("scene", document["scene"]),
            stats=self._numbers("stats", stats),
        )

    def _point(self, place: str, value: Any) -> ParetoPoint:
        check_keys(f"{self.name} at {place}", value, _POINT)
        with naming(f"{self.name} at {place}"):
            return self._read_point(place, value)

    def _read_point(self, place: str, value: Any) -> ParetoPoint:
        return ParetoPoint(
            path=Path(finite_array(f"{place}.path", value["path"], ndim=2)),
            trajectory=Trajectory.from_json(json.dumps(value["trajectory"])),
            cost=self._cost(f"{place}.cost", value["cost"]),
            verdict=self._verdict(f"{place}.verdict", value["verdict"]),
            made_by=self._text(f"{place}.made_by", value["made_by"]),
            made_with=self._number(f"{place}.made_with", value["made_with"]),
        )

    def _cost(self, place: str, value: Any) -> CostBreakdown:
        check_keys(f"{self.name} at {place}", value, _COST)
        return CostBreakdown(
            motion=self._number(f"{place}.motion", value["motion"], least=0.0),
            impact=self._number(f"{place}.impact", value["impact"], least=0.0),
            w=self._number(f"{place}.w", value["w"], least=0.0),
            impact_by_entity=self._numbers(f"{place}.impact_by_entity", value["impact_by_entity"]),
            impact_by_component=self._numbers(f"{place}.impact_by_component", value["impact_by_component"]),
        )

    def _verdict(self, place: str, value: Any) -> Verdict:
        check_keys(f"{self.name} at {place}", value, {"passed", "checks"})
        if not isinstance(value["checks"], dict):
            raise FormatError(self.name, f"{place}.checks must be an object")
        checks = {name: self._check(f"{place}.checks.{name}", check) for name, check in value["checks"].items()}
        verdict = Verdict(checks=checks)
        if not verdict.passed:
            raise FormatError(self.name, f"{place}: a front holds verified points only")
        return verdict

    def _check(self, place: str, value: Any) -> Check:
        check_keys(f"{self.name} at {place}", value, _CHECK)
        if not isinstance(value["passed"], bool):
            raise FormatError(self.name, f"{place}.passed must be true or false")
        unbounded = math.inf if value["passed"] else -math.inf
        return Check(
            passed=value["passed"],
            worst=unbounded if value["worst"] is None else self._number(f"{place}.worst", value["worst"]),
            limit=unbounded if value["limit"] is None else self._number(f"{place}.limit", value["limit"]),
            first=None if value["first"] is None else self._number(f"{place}.first", value["first"]),
            detail=self._text(f"{place}.detail", value["detail"]),
        )

    def _text(self, place: str, value: Any) -> str:
        if not isinstance(value, str):
            raise FormatError(self.name, f"{place} must be a text")
        return value

    def _number(self, place: str, value: Any, least: float = -math.inf) -> float:
        if type(value) not in (int, float) or not abs(value) <= sys.float_info.max or value < least:
            raise FormatError(self.name, f"{place} must be a finite number" + (" >= 0" if least == 0.0 else ""))
        return float(value)

    def _numbers(self, place: str, value: Any) -> dict[str, float]:
        if not isinstance(value, dict):
            raise FormatError(self.name, f"{place} must be an object")
        return {name: self._number(f"{place}.{name}", number) for name, number in value.items()}
