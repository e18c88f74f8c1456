"""Comparing planners: every planner on every problem with every seed, at equal time, written down as it goes."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any

from graceful_plan.compare.problems.analytic import analytic_problems
from graceful_plan.compare.problems.suite import Suite, load_suite
from graceful_plan.compare.runs import workers
from graceful_plan.compare.runs.journal import NAME, RunJournal, check_head, read
from graceful_plan.compare.runs.known import known_costs
from graceful_plan.compare.runs.machine import describe
from graceful_plan.compare.runs.planner_notes import PlannerNote, read_planners
from graceful_plan.compare.runs.records import Run
from graceful_plan.compare.runs.runner import PlannerJob
from graceful_plan.exceptions import SettingError
from graceful_plan.regular_file import path_of

Progress = Callable[[int, int, Run | None], None]
"""Called with the runs that are done, those there are in all, and the newest."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """What is compared.

    Args:
        suite: The problems.
        planners: The planners, the reference first.
        seeds: Seeds of the runs.
        seconds: Time limit of every call [s].
        w: Safety weight.
        processes: Runs at a time, none of which shares a process with another.
    """

    suite: Suite
    planners: tuple[PlannerNote, ...]
    seeds: tuple[int, ...]
    seconds: float
    w: float
    processes: int = 1

    def __post_init__(self) -> None:
        whole = all(isinstance(seed, int) and not isinstance(seed, bool) and seed >= 0 for seed in self.seeds)
        if not (self.seeds and whole) or len(set(self.seeds)) < len(self.seeds):
            raise SettingError("seeds", self.seeds, "at least one whole number >= 0, none twice")
        if not (math.isfinite(self.seconds) and self.seconds > 0.0):
            raise SettingError("seconds", self.seconds, "a finite time > 0 s")
        if not (math.isfinite(self.w) and self.w >= 0.0):
            raise SettingError("w", self.w, "a finite number >= 0")
        cores = os.cpu_count() or 1
        if not 0 <= self.processes <= cores:
            raise SettingError(
                "processes", self.processes, f"at most the {cores} cores there are, or times mean nothing"
            )

    @property
    def jobs(self) -> list[PlannerJob]:
        """Every run. Planners take turns, at being first too, so that what else the machine does meets all alike."""
        rounds = [(seed, problem) for seed in self.seeds for problem in self.suite.problems]
        return [
            PlannerJob(problem=problem, planner=planner, seed=seed, seconds=self.seconds, w=self.w)
            for i, (seed, problem) in enumerate(rounds)
            for first in [i % len(self.planners)]
            for planner in (*self.planners[first:], *self.planners[:first])
        ]

    def to_document(self, machine: Mapping[str, str]) -> dict[str, Any]:
        """Return all that figures depend on: two runs are comparable if this is the same for both."""
        return {
            "suite": self.suite.name,
            "seconds": self.seconds,
            "w": self.w,
            "seeds": list(self.seeds),
            "processes": self.processes,
            "processor": machine["processor"],
            "cores": machine["cores"],
            "versions": machine["versions"],
            "planners": [planner.to_document() for planner in self.planners],
            "problems": [problem.to_document() for problem in self.suite.problems],
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class Comparison:
    """Runs, and what they are runs of.

    | field      | meaning                                                                |
    |------------|------------------------------------------------------------------------|
    | suite      | name of the suite                                                      |
    | problems   | names of the problems                                                  |
    | planners   | labels of the planners, the reference first                            |
    | seeds      | seeds                                                                  |
    | seconds    | time limit of every call [s]                                           |
    | w          | safety weight                                                          |
    | machine    | what it was made on                                                    |
    | begun      | when, in UTC                                                           |
    | runs       | the runs that are done, in the order of problems, planners and seeds   |
    | known      | least total costs known from elsewhere, by problem                     |
    | groups     | the kind of every problem, by its name                                 |
    | settings   | everything that figures depend on, as a document                       |
    """

    suite: str
    problems: tuple[str, ...]
    planners: tuple[str, ...]
    seeds: tuple[int, ...]
    seconds: float
    w: float
    machine: Mapping[str, str]
    begun: str
    runs: tuple[Run, ...]
    known: Mapping[str, float] = field(default_factory=dict)
    groups: Mapping[str, str] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)

    @property
    def expected(self) -> int:
        """Number of runs of the whole comparison."""
        return len(self.problems) * len(self.planners) * len(self.seeds)

    def of(self, *, planner: str | None = None, problem: str | None = None) -> list[Run]:
        """Return the runs of a planner, of a problem, or of both."""
        return self._grouped.get((problem, planner), [])

    @cached_property
    def _grouped(self) -> dict[tuple[str | None, str | None], list[Run]]:
        """Runs by problem and planner, by either alone, and all: a report asks thousands of times."""
        found: dict[tuple[str | None, str | None], list[Run]] = {}
        for run in self.runs:
            for key in product((run.problem, None), (run.planner, None)):
                found.setdefault(key, []).append(run)
        return found


def compare(
    suite: str | Path | Suite = "quick",
    *,
    planners: Sequence[str] | None = None,
    seeds: int | Sequence[int] | None = None,
    seconds: float | None = None,
    w: float | None = None,
    out: str | Path,
    processes: int = 1,
    known: Mapping[str, float] | None = None,
    progress: Progress | None = None,
) -> Comparison:
    """Compare planners; go on with a comparison that was interrupted.

    Args:
        suite: Bundled suite, suite file, problem file or folder of those, or a `Suite`.
        planners: Names with settings, as "rrt_star:range=0.4", or classes of one's own, as "package.module:Class"; the
            first is the reference. All of the library's if None.
        seeds: How many, or which.
        seconds: Time limit of every call [s].
        w: Safety weight.
        out: Folder of the journal. Runs that are in it already are not repeated.
        processes: Runs at a time, in processes of their own; 0 uses this very process, which a planner can then crash.
        known: Least total costs known from elsewhere at this weight, by problem.
        progress: Called before the first run and after every run.

    Returns:
        Everything that is done, which is all of it.

    Raises:
        GracefulPlanError: For misuse: unknown names, settings out of range, a folder with another comparison.
    """
    settings = settle(suite, planners=planners, seeds=seeds, seconds=seconds, w=w, processes=processes)
    machine = describe()
    document = settings.to_document(machine)
    with RunJournal(path_of(out), document, machine, _known(settings)) as journal:
        have = {run.key for run in journal.runs}
        jobs = [job for job in settings.jobs if job.key not in have]
        total = len(settings.jobs)
        if progress is not None:
            progress(total - len(jobs), total, None)
        for i, run in enumerate(workers.done(jobs, settings.processes), total - len(jobs) + 1):
            journal.add(run)
            if progress is not None:
                progress(i, total, run)
        return _comparison(journal.head, journal.runs, known)


def settle(
    suite: str | Path | Suite = "quick",
    *,
    planners: Sequence[str] | None = None,
    seeds: int | Sequence[int] | None = None,
    seconds: float | None = None,
    w: float | None = None,
    processes: int = 1,
) -> Settings:
    """Return settings, with the suite's own for those that are None. Arguments as for `compare`."""
    loaded = suite if isinstance(suite, Suite) else load_suite(suite)
    if isinstance(seeds, int):
        if isinstance(seeds, bool) or seeds < 1:
            raise SettingError("seeds", seeds, "a number of seeds >= 1, or a list of seeds")
        seeds = range(seeds)
    return Settings(
        suite=loaded,
        planners=read_planners(planners),
        seeds=loaded.seeds if seeds is None else tuple(seeds),
        seconds=loaded.seconds if seconds is None else float(seconds),
        w=loaded.w if w is None else float(w),
        processes=processes,
    )


def load_comparison(folder: str | Path, known: Mapping[str, float] | None = None) -> Comparison:
    """Read what a folder holds, however much of it is done.

    Raises:
        FormatError: If there is no journal, or a damaged one.
    """
    file = path_of(folder) / NAME
    head, runs = read(file)
    check_head(head, file)
    return _comparison(head, runs, known)


def _known(settings: Settings) -> dict[str, float]:
    """Return what the suite knows of least costs; it knows them at its own weight only."""
    exact = analytic_problems()
    known = dict(settings.suite.best_known) if settings.w == settings.suite.w else {}
    for problem in settings.suite.problems:
        if problem.kind == "analytic" and exact[problem.item].objective.w == settings.w:
            known[problem.name] = exact[problem.item].optimum
    return known


def _comparison(head: Mapping[str, Any], runs: Sequence[Run], known: Mapping[str, float] | None) -> Comparison:
    document = head["settings"]
    problems = tuple(problem["name"] for problem in document["problems"])
    planners = tuple(planner["label"] for planner in document["planners"])
    seeds = tuple(document["seeds"])
    place = {
        key: i
        for i, key in enumerate(
            (problem, planner, seed) for problem in problems for planner in planners for seed in seeds
        )
    }
    return Comparison(
        suite=document["suite"],
        problems=problems,
        planners=planners,
        seeds=seeds,
        seconds=document["seconds"],
        w=document["w"],
        machine=head["machine"],
        begun=head["begun"],
        runs=tuple(sorted((run for run in runs if run.key in place), key=lambda run: place[run.key])),
        known=known_costs(head["known"], known or {}),
        groups={problem["name"]: problem["group"] for problem in document["problems"]},
        settings=document,
    )
