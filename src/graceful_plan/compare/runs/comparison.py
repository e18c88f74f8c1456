"""Comparison of planners: every planner on every problem with every seed, at equal time, with a journal."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from graceful_plan.compare.problems.analytic import analytic_problems
from graceful_plan.compare.problems.suite import Suite, load_suite
from graceful_plan.compare.runs import workers
from graceful_plan.compare.runs.journal import NAME, RunJournal, check_head, read
from graceful_plan.compare.runs.known import known_costs
from graceful_plan.compare.runs.machine import describe
from graceful_plan.compare.runs.planner_specs import PlannerSpec, read_planners
from graceful_plan.compare.runs.records import Run
from graceful_plan.compare.runs.runner import PlannerJob
from graceful_plan.exceptions import SettingError
from graceful_plan.path import is_whole, plain_numbers
from graceful_plan.regular_file import path_of
from graceful_plan.setting_checks import not_negative, positive

Progress = Callable[[int, int, Run | None], None]
"""Called with the number of finished runs, the total number, and the latest run."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of a comparison.

    Args:
        suite: The problems.
        planners: The planners, the reference first.
        seeds: Seeds of the runs.
        seconds: Time limit of every call [s].
        w: Safety weight.
        processes: Number of parallel runs, each in a separate process.
    """

    suite: Suite
    planners: tuple[PlannerSpec, ...]
    seeds: tuple[int, ...]
    seconds: float
    w: float
    processes: int = 1

    def __post_init__(self) -> None:
        plain_numbers(self)
        whole = all(is_whole(seed) and seed >= 0 for seed in self.seeds)
        if not (self.seeds and whole) or len(set(self.seeds)) < len(self.seeds):
            raise SettingError("seeds", self.seeds, "at least one whole number >= 0, none twice")
        positive("seconds", self.seconds, "a finite time > 0 s")
        not_negative("w", self.w)
        cores = os.cpu_count() or 1
        if not 0 <= self.processes <= cores:
            raise SettingError(
                "processes", self.processes, f"at most the {cores} available cores, or times are meaningless"
            )

    @property
    def jobs(self) -> list[PlannerJob]:
        """Return all runs. The order of planners rotates, so that other load on the machine affects all alike."""
        rounds = [(seed, problem) for seed in self.seeds for problem in self.suite.problems]
        return [
            PlannerJob(problem=problem, planner=planner, seed=seed, seconds=self.seconds, w=self.w)
            for i, (seed, problem) in enumerate(rounds)
            for first in [i % len(self.planners)]
            for planner in (*self.planners[first:], *self.planners[:first])
        ]

    def to_document(self, machine: Mapping[str, str]) -> dict[str, Any]:
        """Return all settings that affect results; runs with equal documents are comparable."""
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
    """Runs of a comparison with its settings.

    | field      | meaning                                                                |
    |------------|------------------------------------------------------------------------|
    | suite      | name of the suite                                                      |
    | problems   | names of the problems                                                  |
    | planners   | labels of the planners, the reference first                            |
    | seeds      | seeds                                                                  |
    | seconds    | time limit of every call [s]                                           |
    | w          | safety weight                                                          |
    | machine    | description of the machine                                             |
    | begun      | begin of the comparison, in UTC                                        |
    | runs       | finished runs, in the order of problems, planners and seeds            |
    | known      | best-known total costs from other sources, by problem                  |
    | groups     | kind of every problem, by name                                         |
    | settings   | all settings that affect results, as a document                        |
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
        """Runs by problem and planner, by either alone, and all; cached because a report needs them often."""
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
    """Compare planners, or resume an interrupted comparison.

    Args:
        suite: Bundled suite, suite file, problem file or folder of problem files, or a `Suite`.
        planners: Names with settings, such as "rrt_star:range=0.4", or custom classes, such as "package.module:Class";
            the first is the reference. All planners of the library if None.
        seeds: Number of seeds, or the seeds.
        seconds: Time limit of every call [s].
        w: Safety weight.
        out: Folder of the journal. Runs in the journal are not repeated.
        processes: Number of parallel runs in separate processes; 0 uses this process, which a planner can then crash.
        known: Best-known total costs at this weight from other sources, by problem.
        progress: Called before the first run and after every run.

    Returns:
        The complete comparison.

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
    """Return settings with defaults from the suite. Arguments as in `compare`."""
    loaded = suite if isinstance(suite, Suite) else load_suite(suite)
    if isinstance(seeds, int | np.integer):
        if isinstance(seeds, bool) or seeds < 1:
            raise SettingError("seeds", seeds, "a number of seeds >= 1, or a list of seeds")
        seeds = range(int(seeds))
    return Settings(
        suite=loaded,
        planners=read_planners(planners),
        seeds=loaded.seeds if seeds is None else tuple(seeds),
        seconds=loaded.seconds if seconds is None else float(seconds),
        w=loaded.w if w is None else float(w),
        processes=processes,
    )


def load_comparison(folder: str | Path, known: Mapping[str, float] | None = None) -> Comparison:
    """Read the finished runs of a comparison from its folder.

    Raises:
        FormatError: If there is no journal, or a damaged one.
    """
    file = path_of(folder) / NAME
    head, runs = read(file)
    check_head(head, file)
    return _comparison(head, runs, known)


def _known(settings: Settings) -> dict[str, float]:
    """Return the best-known costs in the suite, which hold for the weight of the suite only."""
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
