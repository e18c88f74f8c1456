"""The best path known for each task of a scene, one JSON file a task; judged again whenever it is read.

A file counts only while its path still starts and ends where the task does, keeps the limits, is free by exact geometry
and costs what the file says; else the scene, the task or the cost has changed and `BestPaths.load` refuses it.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import final

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.compare.runs.records import Run
from graceful_plan.costs.objective import Objective, evaluate
from graceful_plan.exceptions import FormatError
from graceful_plan.judge.verification import verify
from graceful_plan.path import Path as JointPath
from graceful_plan.result import CostBreakdown
from graceful_plan.scene.loading.bundled import load_scene
from graceful_plan.scene.scene import Task

Array = np.ndarray

SCHEMA = 1
_COST_TOLERANCE = 1e-6
"""Relative: a stored total is written to full precision and evaluated by the same rule."""
_BETTER = 1e-9
"""Relative gain below which a path is the same path."""
_SAME = 2e-6
"""Distance [rad] between the ends of a path and of its task: a start outside a limit is moved onto it."""


@final
class StaleBestPath(FormatError):
    """A stored path that is no solution of the task as it is now, or does not cost what its file says."""


@final
@dataclass(frozen=True, kw_only=True)
class Attempt:
    """One run and what it reached."""

    planner: str
    seed: int
    seconds: float
    total: float | None
    """None if it found no path."""


@final
@dataclass(frozen=True, kw_only=True)
class BestPath:
    """The best path known for a task."""

    task: str
    total: float
    motion: float
    impact: float
    planner: str
    seed: int
    seconds: float
    """Time limit of the run that found it."""
    path: tuple[tuple[float, ...], ...]
    runs: tuple[Attempt, ...] = ()
    """Runs that it is the best of; others may have been asked besides."""


@final
@dataclass(frozen=True)
class BestPaths:
    """A folder of best known paths.

    Args:
        folder: Where the files are.
        w: Safety weight of the default objective that they are the best for.
    """

    folder: Path
    w: float = 1.0

    def file_of(self, task: str) -> Path:
        """Where the best path of a task, "scene/task", is kept."""
        return self.folder / (task.replace("/", ".") + ".json")

    def read(self, file: Path) -> BestPath:
        """Read a file without judging its path.

        Raises:
            StaleBestPath: If it is not of this format.
        """
        try:
            data = json.loads(file.read_text(encoding="utf-8"))
            if data.pop("schema") != SCHEMA or data.pop("w") != self.w:
                raise StaleBestPath(file.name, "another schema or weight")
            runs = tuple(Attempt(**run) for run in data.pop("runs"))
            path = tuple(tuple(float(x) for x in q) for q in data.pop("path"))
            return BestPath(**data, path=path, runs=runs)
        except (OSError, KeyError, TypeError, json.JSONDecodeError) as error:
            raise StaleBestPath(file.name, f"{type(error).__name__}: {error}") from error

    def load(self, name: str, task: Task) -> BestPath | None:
        """Read and judge the best path of a task; None if there is no file.

        Raises:
            StaleBestPath: If the file does not hold what it says.
        """
        file = self.file_of(name)
        if not file.exists():
            return None
        best = self.read(file)
        if found := self._problems(best, task):
            raise StaleBestPath(file.name, "; ".join(found))
        return best

    def renewed(self, name: str, task: Task) -> BestPath | None:
        """Like `load`, but keep a stored path that still solves the task at what it costs now, its runs forgotten."""
        try:
            return self.load(name, task)
        except StaleBestPath:
            pass
        try:
            best = self.read(self.file_of(name))
        except StaleBestPath:
            return None
        q = np.array(best.path)
        if q.ndim != 2 or q.shape[1] != len(task.start) or _not_a_solution(q, task):
            return None
        cost = self.cost_of(q, task)
        return replace(best, total=cost.total, motion=cost.motion, impact=cost.impact, runs=())

    def offer(self, task: Task, best: BestPath | None, run: Run, seconds: float) -> BestPath | None:
        """Return the better of what is known and the path of a run, which must be a solution to count.

        Args:
            task: What was to be done.
            best: What is known, None if nothing is.
            run: A run on that task.
            seconds: Its time limit [s].
        """
        if not run.solved or not run.path:
            return best
        q = np.array(run.path)
        cost = self.cost_of(q, task)
        if (best is not None and cost.total >= best.total * (1.0 - _BETTER)) or _not_a_solution(q, task):
            return best
        return BestPath(
            task=run.problem,
            total=cost.total,
            motion=cost.motion,
            impact=cost.impact,
            planner=run.planner,
            seed=run.seed,
            seconds=seconds,
            path=run.path,
            runs=() if best is None else best.runs,
        )

    def write(self, best: BestPath) -> None:
        """Write the file of a task, whole or not at all."""
        data = {"schema": SCHEMA, "w": self.w, **asdict(replace(best, path=(), runs=()))}
        del data["path"], data["runs"]
        rows = ",\n  ".join(json.dumps(q) for q in best.path)
        runs = ",\n  ".join(json.dumps(asdict(run)) for run in best.runs)
        head = json.dumps(data, indent=1, allow_nan=False).removesuffix("\n}")
        file = self.file_of(best.task)
        file.parent.mkdir(exist_ok=True)
        partial = file.with_suffix(".partial")
        partial.write_text(f'{head},\n "path": [\n  {rows}\n ],\n "runs": [\n  {runs}\n ]\n}}\n', encoding="utf-8")
        partial.replace(file)

    def totals(self) -> dict[str, float]:
        """Return the least total cost of every task of bundled scenes that has a file.

        Raises:
            StaleBestPath: If a file does not hold what it says.
        """
        found: dict[str, float] = {}
        for file in sorted(self.folder.glob("*.json")):
            name = self.read(file).task
            scene, _, task = name.partition("/")
            best = self.load(name, load_scene(scene).tasks[task])
            if best is not None:
                found[name] = best.total
        return found

    def cost_of(self, q: Float[Array, "n nq"], task: Task) -> CostBreakdown:
        """Cost of a path under the default objective."""
        return evaluate(JointPath(q), task.scene, Objective(w=self.w))

    def _problems(self, best: BestPath, task: Task) -> list[str]:
        """Say why a stored path does not count, nothing if it does."""
        q = np.array(best.path)
        if q.ndim != 2 or q.shape[1] != len(task.start):
            return [f"path has shape {q.shape}"]
        found = _not_a_solution(q, task)
        total = self.cost_of(q, task).total
        if not abs(total - best.total) <= _COST_TOLERANCE * max(1.0, abs(total)):
            found.append(f"stored total {best.total:.6f}, but the path costs {total:.6f}")
        return found


def _not_a_solution(q: Float[Array, "n nq"], task: Task) -> list[str]:
    """Say what keeps a path from solving a task."""
    found: list[str] = []
    if np.abs(q[0] - task.start).max() > _SAME:
        found.append("does not begin at the start")
    if np.abs(task.goal - q[-1]).max(axis=1).min() > _SAME:
        found.append("ends at no goal")
    verdict = verify(JointPath(q), task.scene)
    return found + [f"{name}: {verdict.checks[name].detail}" for name in verdict.failures]
