"""The best path known for each task, one JSON file a task; judged again whenever it is read.

A file counts only while its path still starts and ends where the task does, keeps the limits, is free by exact geometry
and costs what the file says; else the scene, the task or the cost has changed and `load` refuses it.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

import graceful_plan as gp

FOLDER = Path(__file__).parent / "best_known"
SCHEMA = 1
W = 1.0
_COST_TOLERANCE = 1e-6
"""Relative: a stored total is written to full precision and evaluated by the same rule."""
_BETTER = 1e-9
"""Relative gain below which a path is the same path."""
_SAME = 2e-6
"""Distance [rad] between the ends of a path and of its task: a start outside a limit is moved onto it."""


class StaleBestKnownError(ValueError):
    """A stored path that is no solution of the task as it is now, or does not cost what its file says."""


@dataclass(frozen=True, kw_only=True)
class Run:
    """One attempt and what it reached."""

    planner: str
    seed: int
    seconds: float
    total: float | None
    """None if it found no path."""


@dataclass(frozen=True, kw_only=True)
class BestKnown:
    """The best path known for a task at w = 1."""

    task: str
    total: float
    motion: float
    impact: float
    planner: str
    seed: int
    seconds: float
    """Time limit of the run that found it."""
    path: tuple[tuple[float, ...], ...]
    runs: tuple[Run, ...] = ()
    """Every run that it is the best of, besides those of the planner table."""


def file_of(task: str) -> Path:
    """Where the best path of a task is kept."""
    return FOLDER / (task.replace("/", ".") + ".json")


def read(file: Path) -> BestKnown:
    """Read a file without judging its path.

    Raises:
        StaleBestKnownError: If it is not of this format.
    """
    try:
        data = json.loads(file.read_text())
        if data.pop("schema") != SCHEMA or data.pop("w") != W:
            raise StaleBestKnownError(f"{file.name}: another schema or weight")
        runs = tuple(Run(**run) for run in data.pop("runs"))
        path = tuple(tuple(float(x) for x in q) for q in data.pop("path"))
        return BestKnown(**data, path=path, runs=runs)
    except (KeyError, TypeError, json.JSONDecodeError) as error:
        raise StaleBestKnownError(f"{file.name}: {type(error).__name__}: {error}") from error


def problems(known: BestKnown, task: gp.Task) -> list[str]:
    """Say why a stored path does not count, nothing if it does."""
    q = np.array(known.path)
    if q.ndim != 2 or q.shape[1] != len(task.start):
        return [f"path has shape {q.shape}"]
    found = _not_a_solution(q, task)
    total = cost_of(q, task).total
    if not abs(total - known.total) <= _COST_TOLERANCE * max(1.0, abs(total)):
        found.append(f"stored total {known.total:.6f}, but the path costs {total:.6f}")
    return found


def cost_of(q: np.ndarray, task: gp.Task) -> gp.CostBreakdown:
    """Cost of a path under the default objective at w = 1."""
    return gp.evaluate(gp.Path(q), task.scene, gp.Objective(w=W))


def load(name: str, task: gp.Task) -> BestKnown | None:
    """Read and judge the best path of a task; None if there is no file.

    Raises:
        StaleBestKnownError: If the file does not hold what it says.
    """
    file = file_of(name)
    if not file.exists():
        return None
    known = read(file)
    if found := problems(known, task):
        raise StaleBestKnownError(f"{file.name}: {'; '.join(found)}")
    return known


def renewed(name: str, task: gp.Task) -> BestKnown | None:
    """Like `load`, but keep a stored path that still solves the task at what it costs now, its runs forgotten."""
    try:
        return load(name, task)
    except StaleBestKnownError:
        pass
    try:
        known = read(file_of(name))
    except StaleBestKnownError:
        return None
    q = np.array(known.path)
    if q.ndim != 2 or q.shape[1] != len(task.start) or _not_a_solution(q, task):
        return None
    cost = cost_of(q, task)
    return replace(known, total=cost.total, motion=cost.motion, impact=cost.impact, runs=())


def offer(
    name: str, task: gp.Task, known: BestKnown | None, q: np.ndarray, planner: str, seed: int, seconds: float
) -> BestKnown | None:
    """Return the better of what is known and a new path, which must be a solution to count."""
    cost = cost_of(q, task)
    if (known is not None and cost.total >= known.total * (1.0 - _BETTER)) or _not_a_solution(q, task):
        return known
    return BestKnown(
        task=name,
        total=cost.total,
        motion=cost.motion,
        impact=cost.impact,
        planner=planner,
        seed=seed,
        seconds=seconds,
        path=tuple(map(tuple, q.tolist())),
        runs=() if known is None else known.runs,
    )


def write(known: BestKnown) -> None:
    """Write the file of a task, whole or not at all."""
    data = {"schema": SCHEMA, "w": W, **asdict(replace(known, path=(), runs=()))}
    del data["path"], data["runs"]
    rows = ",\n  ".join(json.dumps(q) for q in known.path)
    runs = ",\n  ".join(json.dumps(asdict(run)) for run in known.runs)
    head = json.dumps(data, indent=1, allow_nan=False).removesuffix("\n}")
    file = file_of(known.task)
    file.parent.mkdir(exist_ok=True)
    partial = file.with_suffix(".partial")
    partial.write_text(f'{head},\n "path": [\n  {rows}\n ],\n "runs": [\n  {runs}\n ]\n}}\n')
    partial.replace(file)


def _not_a_solution(q: np.ndarray, task: gp.Task) -> list[str]:
    found = []
    if np.abs(q[0] - task.start).max() > _SAME:
        found.append("does not begin at the start")
    if np.abs(task.goal - q[-1]).max(axis=1).min() > _SAME:
        found.append("ends at no goal")
    verdict = gp.verify(gp.Path(q), task.scene)
    return found + [f"{name}: {verdict.checks[name].detail}" for name in verdict.failures]
