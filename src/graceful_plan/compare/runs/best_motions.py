"""Best-known motion for each task of a scene, one JSON file per task, verified at every reading.

A file is valid only while its motion starts and ends as the task does, satisfies limits and default constraints, is
free by exact geometry, and has the stored cost. Otherwise the scene, the task or the cost function has changed, and
`BestMotions.load` refuses it. A motion is stored as samples, one per row: time, positions, velocities. Cubics between
them define the motion completely.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, replace
from itertools import chain
from pathlib import Path
from typing import final

import numpy as np

from graceful_plan.compare.runs.records import Run, cubics
from graceful_plan.constraints.scene_constraints import default_constraints
from graceful_plan.costs.objective import Objective, evaluate
from graceful_plan.exceptions import FormatError, GracefulPlanError
from graceful_plan.judge.verification import verify
from graceful_plan.regular_file import read_content
from graceful_plan.result import CostBreakdown
from graceful_plan.scene.loading.bundled import load_scene
from graceful_plan.scene.scene import Task
from graceful_plan.timing.trajectory import Trajectory
from graceful_plan.untrusted_json import parse_json

SCHEMA = 2
_COST_TOLERANCE = 1e-6
"""Relative tolerance of a stored total, which is written with full precision and evaluated by the same rule."""
_BETTER = 1e-9
"""Relative improvement below which a motion counts as unchanged."""
_SAME = 2e-6
"""Tolerance of the ends of a motion [rad]: a start outside a limit is moved onto the limit."""

_BROKEN = (OSError, AttributeError, KeyError, TypeError, ValueError, OverflowError, RecursionError)
"""Exceptions from reading a malformed file."""


@final
class StaleBestMotion(FormatError):
    """A stored motion that does not solve the present task, or whose cost differs from the stored one."""


@final
@dataclass(frozen=True, kw_only=True)
class Attempt:
    """One run and its result."""

    planner: str
    seed: int
    seconds: float
    total: float | None
    """Total cost; None without a motion."""


@final
@dataclass(frozen=True, kw_only=True)
class BestMotion:
    """The best-known motion for a task."""

    task: str
    total: float
    motion: float
    impact: float
    planner: str
    seed: int
    seconds: float
    """Time limit of the run that found it."""
    samples: tuple[tuple[float, ...], ...]
    """Rows of time [s], positions [rad or m] and velocities [rad/s or m/s]."""
    runs: tuple[Attempt, ...] = ()
    """Runs that were compared; may be incomplete."""

    def trajectory(self, joints: tuple[str, ...]) -> Trajectory:
        """Return the motion as a trajectory of the joints.

        Raises:
            GracefulPlanError: If the samples are not a motion of these joints.
        """
        nq = len(joints)
        rows = [(row[0], row[1 : nq + 1], row[nq + 1 :]) for row in self.samples if row]
        times, path, velocities = zip(*rows, strict=True) if rows else ((), (), ())
        return cubics(times, path, velocities, joints)


@final
@dataclass(frozen=True)
class BestMotions:
    """A folder of best-known motions.

    Args:
        folder: Folder of the files.
        w: Safety weight of the default objective.
    """

    folder: Path
    w: float = 1.0

    @classmethod
    def in_folder(cls, folder: Path) -> BestMotions:
        """Read the weight from the files, which must agree on it.

        Raises:
            StaleBestMotion: If a file has no weight.
        """
        for file in sorted(folder.glob("*.json")):
            return cls(folder, _weight(file))
        return cls(folder)

    def file_of(self, task: str) -> Path:
        """Return the file of the best motion of a task, "scene/task"."""
        return self.folder / (task.replace("/", ".") + ".json")

    def read(self, file: Path) -> BestMotion:
        """Read a file without verifying its motion.

        Raises:
            StaleBestMotion: If the format is wrong.
        """
        try:
            data = parse_json(read_content(file), file.name)
            if data.pop("schema") != SCHEMA or data.pop("w") != self.w:
                raise StaleBestMotion(file.name, "another schema or weight")
            runs = tuple(Attempt(**run) for run in data.pop("runs"))
            samples = tuple(tuple(float(x) for x in row) for row in data.pop("samples"))
            best = BestMotion(**data, samples=samples, runs=runs)
            if not all(map(math.isfinite, chain(*samples, (best.total, best.motion, best.impact)))):
                raise StaleBestMotion(file.name, "a number that is not finite")
            return best
        except StaleBestMotion:
            raise
        except _BROKEN as error:
            raise StaleBestMotion(file.name, f"{type(error).__name__}: {error}") from error

    def load(self, name: str, task: Task) -> BestMotion | None:
        """Read and verify the best motion of a task; None if there is no file.

        Raises:
            StaleBestMotion: If the motion does not solve the task, or has another cost than stored.
        """
        file = self.file_of(name)
        if not file.exists():
            return None
        best = self.read(file)
        if found := self._problems(best, task):
            raise StaleBestMotion(file.name, "; ".join(found))
        return best

    def renewed(self, name: str, task: Task) -> BestMotion | None:
        """Like `load`, but update the cost of a motion that still solves the task, and drop its runs."""
        try:
            return self.load(name, task)
        except StaleBestMotion:
            pass
        try:
            best = self.read(self.file_of(name))
            trajectory = best.trajectory(task.scene.joints)
        except GracefulPlanError:
            return None
        if _not_a_solution(trajectory, task):
            return None
        cost = self.cost_of(trajectory, task)
        return replace(best, total=cost.total, motion=cost.motion, impact=cost.impact, runs=())

    def offer(self, task: Task, best: BestMotion | None, run: Run, seconds: float) -> BestMotion | None:
        """Return the better of the best-known motion and that of a run, if the latter is a solution.

        Args:
            task: The task.
            best: Best-known motion, or None.
            run: A run on that task.
            seconds: Time limit of the run [s].
        """
        trajectory = run.trajectory(task.scene.joints)
        if not run.solved or trajectory is None:
            return best
        cost = self.cost_of(trajectory, task)
        no_better = best is not None and cost.total >= best.total * (1.0 - _BETTER)
        if no_better or _not_a_solution(trajectory, task):
            return best
        return BestMotion(
            task=run.problem,
            total=cost.total,
            motion=cost.motion,
            impact=cost.impact,
            planner=run.planner,
            seed=run.seed,
            seconds=seconds,
            samples=tuple((t, *q, *qd) for t, q, qd in zip(run.times, run.path, run.velocities, strict=True)),
            runs=() if best is None else best.runs,
        )

    def write(self, best: BestMotion) -> None:
        """Write the file of a task atomically."""
        data = {"schema": SCHEMA, "w": self.w, **asdict(replace(best, samples=(), runs=()))}
        del data["samples"], data["runs"]
        rows = ",\n  ".join(json.dumps(row) for row in best.samples)
        runs = ",\n  ".join(json.dumps(asdict(run)) for run in best.runs)
        head = json.dumps(data, indent=1, allow_nan=False).removesuffix("\n}")
        file = self.file_of(best.task)
        file.parent.mkdir(exist_ok=True)
        partial = file.with_suffix(".partial")
        partial.write_text(f'{head},\n "samples": [\n  {rows}\n ],\n "runs": [\n  {runs}\n ]\n}}\n', encoding="utf-8")
        partial.replace(file)

    def totals(self) -> dict[str, float]:
        """Return the best-known total cost of every task of bundled scenes that has a file.

        Raises:
            StaleBestMotion: If a file is invalid.
        """
        found: dict[str, float] = {}
        for file in sorted(self.folder.glob("*.json")):
            name = self.read(file).task
            scene, _, task = name.partition("/")
            best = self.load(name, load_scene(scene).tasks[task])
            if best is not None:
                found[name] = best.total
        return found

    def cost_of(self, trajectory: Trajectory, task: Task) -> CostBreakdown:
        """Evaluate a motion under the default objective."""
        return evaluate(trajectory, task.scene, Objective(w=self.w))

    def _problems(self, best: BestMotion, task: Task) -> list[str]:
        """List the reasons why a stored motion is invalid."""
        try:
            trajectory = best.trajectory(task.scene.joints)
        except GracefulPlanError as error:
            return [str(error)]
        found = _not_a_solution(trajectory, task)
        total = self.cost_of(trajectory, task).total
        if not abs(total - best.total) <= _COST_TOLERANCE * max(1.0, abs(total)):
            found.append(f"stored total {best.total:.6f}, but the motion costs {total:.6f}")
        return found


def _weight(file: Path) -> float:
    try:
        return float(parse_json(read_content(file), file.name)["w"])
    except _BROKEN as error:
        raise StaleBestMotion(file.name, f"{type(error).__name__}: {error}") from error


def _not_a_solution(trajectory: Trajectory, task: Task) -> list[str]:
    """List the reasons why a motion does not solve a task."""
    found: list[str] = []
    if np.abs(trajectory.q[0] - task.start).max() > _SAME:
        found.append("does not begin at the start")
    if np.abs(task.goal - trajectory.q[-1]).max(axis=1).min() > _SAME:
        found.append("ends at no goal")
    # Plans also satisfy the default constraints on grasp and contents, so a better motion must, too.
    verdict = verify(trajectory, task.scene, constraints=default_constraints(task.scene))
    return found + [f"{name}: {verdict.checks[name].detail}" for name in verdict.failures]
