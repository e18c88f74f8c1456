"""Results as JSON documents and text tables for the command line, and motion files."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path as FilePath
from typing import Any

from graceful_plan.exceptions import FormatError, GracefulPlanError
from graceful_plan.formats.parquet_file import MissingArrow
from graceful_plan.formats.samples import text_of
from graceful_plan.path import Path, finite_array
from graceful_plan.regular_file import path_of
from graceful_plan.result import CostBreakdown, PlanResult, Verdict
from graceful_plan.timing.trajectory import Trajectory
from graceful_plan.untrusted_json import parse_json

_READERS: Mapping[str, Callable[[str | FilePath], Trajectory]] = {
    ".csv": Trajectory.from_csv,
    ".parquet": Trajectory.from_parquet,
    ".yaml": lambda file: Trajectory.from_ros(FilePath(file)),
}
_WRITERS: Mapping[str, Callable[[Trajectory, FilePath], object]] = {
    ".json": Trajectory.to_json,
    ".csv": Trajectory.to_csv,
    ".parquet": Trajectory.to_parquet,
    ".yaml": Trajectory.to_ros_yaml,
}
MOTION_FILES = tuple(_WRITERS)
"""File name extensions that `write_motion` supports."""

_PATH_SCHEMA = {"schema": "graceful_plan.path", "version": 1}


def to_json(document: Any) -> str:
    """Return strict JSON text; non-finite numbers become null."""
    return json.dumps(finite(document), allow_nan=False, indent=2)


def cost_document(cost: CostBreakdown) -> dict[str, Any]:
    """Return a cost breakdown as a document."""
    return {
        "motion": cost.motion,
        "impact": cost.impact,
        "w": cost.w,
        "total": cost.total,
        "impact_by_entity": dict(cost.impact_by_entity),
        "impact_by_component": dict(cost.impact_by_component),
    }


def verdict_document(verdict: Verdict) -> dict[str, Any]:
    """Return the judge's findings as a document."""
    checks = {
        name: {
            "passed": check.passed,
            "worst": check.worst,
            "limit": check.limit,
            "first": check.first,
            "detail": check.detail,
        }
        for name, check in verdict.checks.items()
    }
    return {"passed": verdict.passed, "checks": checks}


def result_document(result: PlanResult) -> dict[str, Any]:
    """Return the result of `plan` as a document, including path and trajectory."""
    return {
        "schema": "graceful_plan.result",
        "version": 1,
        "status": result.status.name,
        "meaning": result.status.value,
        "detail": result.detail,
        "goal_index": result.goal_index,
        "cost": None if result.path is None else cost_document(result.cost),
        "verdict": verdict_document(result.verdict),
        "trace": [
            {"time": point.time, "total": point.total, "motion": point.motion, "impact": point.impact}
            for point in result.trace
        ],
        "stats": dict(result.stats),
        "path": None if result.path is None else path_document(result.path),
        "trajectory": None if result.trajectory is None else json.loads(result.trajectory.to_json()),
    }


def path_document(path: Path) -> dict[str, Any]:
    """Return a path as a document in the format of `read_motion`."""
    return {**_PATH_SCHEMA, "q": path.q.tolist()}


def read_motion(file: str | FilePath) -> Path | Trajectory:
    """Read a trajectory or a path from a file.

    Args:
        file: The extension selects the format. `.csv`, `.parquet` and `.yaml` are the formats of
            `Trajectory.to_csv`, `to_parquet` and `to_ros_yaml`; a ROS file must use the joint names of the scene.
            Any other file is JSON: of `Trajectory.to_json`, of `path_document` or of `result_document`.

    Raises:
        FormatError: If the file cannot be read, or holds neither a path nor a trajectory.
        MissingArrow: If the file is Parquet and pyarrow is not installed.
    """
    other = _READERS.get(path_of(file).suffix)
    try:
        if other is not None:
            return other(file)
        return _motion(parse_json(text_of(file, lambda _: False, "JSON")[1], str(file)))
    except FormatError as error:
        raise FormatError(str(file), error.problem) from None
    except MissingArrow:
        raise
    except GracefulPlanError as error:
        raise FormatError(str(file), str(error)) from None


def write_motion(trajectory: Trajectory, file: FilePath) -> None:
    """Write a trajectory in the format that the file name extension selects; see `MOTION_FILES`.

    Raises:
        MissingArrow: If the format is Parquet and pyarrow is not installed.
        OSError: If the file cannot be written.
    """
    _WRITERS[file.suffix](trajectory, file)


def _motion(document: Any) -> Path | Trajectory:
    if isinstance(document, dict) and document.get("schema") == "graceful_plan.result":
        document = document.get("trajectory") or document.get("path")
    if not isinstance(document, dict) or not document:
        raise FormatError("motion", "it holds neither a path nor a trajectory")
    if document.get("schema") != _PATH_SCHEMA["schema"]:
        return Trajectory.from_json(json.dumps(document))
    if document.keys() != {*_PATH_SCHEMA, "q"} or document["version"] != _PATH_SCHEMA["version"]:
        raise FormatError("motion", f"a path has the keys schema, version (1) and q; found {', '.join(document)}")
    return Path(finite_array("path", document["q"], ndim=2))


def table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Format a text table: text columns left-aligned, numeric columns right-aligned with four significant digits."""
    cells = [list(header), *([_cell(value) for value in row] for row in rows)]
    numeric = [all(isinstance(row[i], int | float) for row in rows) for i in range(len(header))]
    widths = [max(len(row[i]) for row in cells) for i in range(len(header))]
    lines = [
        "  ".join(
            c.rjust(w) if right else c.ljust(w) for c, w, right in zip(row, widths, numeric, strict=True)
        ).rstrip()
        for row in cells
    ]
    return "\n".join([lines[0], "-" * len(lines[0]), *lines[1:]])


def cost_table(costs: Mapping[str, CostBreakdown]) -> str:
    """Compare cost breakdowns in columns: motion, impact, total, then impact by component and entity, worst first."""
    columns = list(costs.values())
    rows: list[list[object]] = [
        ["motion", *(cost.motion for cost in columns)],
        ["impact", *(cost.impact for cost in columns)],
        ["motion + w * impact", *(cost.total for cost in columns)],
    ]
    for heading, parts in (
        ("component", [cost.impact_by_component for cost in columns]),
        ("entity", [cost.impact_by_entity for cost in columns]),
    ):
        worst = {name: max(part.get(name, 0.0) for part in parts) for part in parts for name in part}
        for name in sorted((name for name in worst if worst[name] > 0.0), key=lambda name: -worst[name]):
            rows.append([f"  {heading} {name}", *(part.get(name, 0.0) for part in parts)])
    return table(["", *costs], rows)


def _cell(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def finite(value: Any) -> Any:
    """Return a copy of a document in which non-finite numbers are None."""
    if isinstance(value, Mapping):
        return {str(key): finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return value
