"""Mobile robots under all faults: harm per executed task at the default weight, compared with w = 0."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

import failbench as fb
import graceful_plan as gp
from benchmarks import report, suite
from failbench.scenario import MOBILE
from graceful_plan.mobile.floor.generated import floor_plan

Array = np.ndarray

TITLE = "Robots that drive: harm per executed task under all faults"
QUESTION = "How much less harm do failing mobile robots cause at the default weight than at w = 0?"
HEADLINE = "harm per executed task at the default w"
DEPENDS_ON = (*suite.PLANNING, *suite.SIMULATION, "src/graceful_plan/mobile", "sim/failbench/mobile")
PEOPLE, HORIZON, SECONDS, SEED = 12, 3.0, 5.0, 2016
SIZES, LONG_SIZES = (6, 3, 3), (20, 8, 16)
"""Generated floors, and failures per fault of floors and of bundled tasks, in normal and long runs."""
RESAMPLES = 1000
"""Bootstrap samples of an interval."""
DEGREE = "severe"
LEAST = 0.1
"""Hits that count if none was observed."""
MEASURED = f"""\
Every task of the mobile scenes ({", ".join(gp.mobile_scenes())}), with its carried object, and generated floors
(`floor_plan`, three by two rooms, {PEOPLE} entities), which an empty Jackal crosses. No constant was fitted on these
tasks and floors; the speed of drifting bases was fitted on 16 other floors of this kind. Each task is planned with w =
0 and with the default weight, in {SECONDS:g} s each (or `--seconds`) and one process per core, and executed in
FailBench on simulated wheels. It then fails with each fault of its robot, degree "{DEGREE}", with the same onsets (as
quantiles) and random numbers for both motions; the simulation continues for {HORIZON:g} s. Harm is that of `validate`:
hits of the base count by the square of its speed up to 1 m/s, hits of the carried object by what it falls on, including
its own loss; "others" leaves that out. **Per task**: failures come per hour, so harm per task is harm per failure times
duration; without any hit, {LEAST:g} of a hit of severity 1 counts. "Refused": the healthy robot cannot execute the
motion, for instance because a pedestrian blocks its way. "Worse": more harm per task than at w = 0, by more than twice
the standard error of the paired difference. Intervals (95 %) of ratios of means come from a bootstrap of the paired
failures of each task; they leave out that other motions may be found. Pedestrians stop 0.4 s after a failure
(`SimSettings(people="stop")`). "Walk on": the ratio of harm per task if they follow their prediction whatever happens,
and walk into a robot that stands still.
"""


WEIGHTS, OTHERS_ONLY, SEEDS = (0.0, None, 1.0, 3.0), (0.3, 1.0, 3.0), ((None, 1.0), (1,))
LONG_WEIGHTS, LONG_SEEDS = (0.0, None, 0.1, 1.0, 3.0, 10.0), ((None, 1.0, 3.0), (1, 2, 3))
"""Candidates of the bound, in normal and long runs: weights; weights without the own loss of the carried object; and
weights that are planned with further seeds. None is the default weight."""
BOUND_FAILURES = (3, 6)
"""Failures per fault of each candidate, in normal and long runs."""
BOUND = f"""\
How much less harm could any choice among many motions do? Each bundled task is planned with several weights, with and
without the own loss of the carried object in J, and several seeds, in {SECONDS - 1:g} s each (or `--seconds`), and
each motion fails in the same ways as the others. "Best of all": the motion with the least observed harm per task on
one half of the failures, with its harm on the other half; both halves serve once. A choice by observed harm itself is
out of reach for every planner with a model. Harm counts as in the results without `--bound`.
"""
EACH = "Harm per task at w = 0 over that of each motion: all, and of others; how much longer the motion is."


@dataclass(frozen=True, kw_only=True)
class Prevented:
    """Result for one task."""

    task: str
    note: str = ""
    """Reason why there are no figures."""
    duration: tuple[float, float] = (np.nan, np.nan)
    """At w = 0, and at the default weight [s]."""
    harm: tuple[float, float] = (np.nan, np.nan)
    """Harm per failure."""
    others: tuple[float, float] = (np.nan, np.nan)
    """Harm without the loss of the carried object."""
    walk_on: tuple[float, float] = (np.nan, np.nan)
    """Harm per failure if pedestrians do not react."""
    predicted: tuple[float, float] = (np.nan, np.nan)
    worse: bool = False
    failures: int = 0
    harms: Array = field(default_factory=lambda: np.zeros((2, 0)))
    """Harm of each failure, at w = 0 and at the default weight, paired."""
    by_fault: dict[str, tuple[float, float]] = field(default_factory=dict)
    """Harm per failure of each kind."""

    @property
    def times_less(self) -> float:
        """Harm per executed task at w = 0 over that at the default weight."""
        return self._less(self.harm)

    @property
    def others_less(self) -> float:
        """The same ratio for harm to others."""
        return self._less(self.others)

    @property
    def walk_on_less(self) -> float:
        """The same ratio for all harm, if pedestrians do not react."""
        return self._less(self.walk_on)

    def _less(self, harm: tuple[float, float]) -> float:
        plain, ours = (max(h, LEAST / self.failures) * t for h, t in zip(harm, self.duration, strict=True))
        return plain / ours

    @property
    def longer(self) -> float:
        """Duration at the default weight over that at w = 0."""
        return self.duration[1] / self.duration[0]


def query_of(name: str) -> tuple[gp.Scene, Array, Array, tuple[fb.Fault, ...]]:
    """Return scene, start, goal and possible faults of a task: "SCENE/TASK", or "floor SEED"."""
    if name.startswith("floor"):
        plan = floor_plan(SEED + int(name.split()[1]), people=PEOPLE)
        found = fb.scenarios(f"apartment/serve_tea/*/{DEGREE}")  # a Jackal too, which has no gripper
        return plan.floor.to_scene("jackal"), plan.start, plan.goal, tuple(s.fault for s in found)
    scene, task = name.split("/")
    chosen = suite.scene(scene).tasks[task]
    return chosen.scene, chosen.start, chosen.goal, tuple(s.fault for s in fb.scenarios(f"{name}/*/{DEGREE}"))


def planned(name: str, seconds: float) -> tuple[gp.PlanResult, gp.PlanResult]:
    """Plan a task with w = 0 and with the default weight."""
    scene, start, goal, _ = query_of(name)
    gp.plan(start, goal, scene, iterations=1)  # compiles
    plain, ours = (gp.plan(start, goal, scene, w=w, time_limit=seconds) for w in (0.0, None))
    return plain, ours


def examine(job: tuple[str, float, int]) -> Prevented:
    """Plan a task in a time limit [s] each, and simulate the same failures along both motions."""
    name, seconds, each = job
    results = planned(name, seconds)
    scene, _, _, faults = query_of(name)
    found, reports = Prevented(task=name, failures=each * len(faults)), {people: [] for people in ("stop", "walk")}
    n, reactions = each * len(faults), ("stop", "walk") if scene.moving else ("stop",)
    for result in results:
        if result.trajectory is None:
            return replace(found, note=f"not planned: {result.status.name}")
        try:
            for people in reactions:
                settings = fb.SimSettings(people=people)
                one = fb.validate(result, scene, faults, n=n, horizon=HORIZON, threads=1, settings=settings)
                reports[people].append(one)
        except fb.ExecutionRefused as refused:
            return replace(found, note=f"refused: {refused.what} at {refused.time:.1f} s")
    plain, ours = reports["stop"]
    more = fb.compare(ours, plain, per="task")
    return replace(
        found,
        duration=(plain.duration, ours.duration),
        harm=(plain.observed.mean, ours.observed.mean),
        others=(plain.observed.mean - plain.own_loss.mean, ours.observed.mean - ours.own_loss.mean),
        walk_on=tuple(one.observed.mean for one in reports["walk"] or reports["stop"]),
        predicted=(plain.predicted, ours.predicted),
        worse=more.low > 0.0,
        harms=np.stack([plain.impacts, ours.impacts]),
        by_fault={name: (one.mean, ours.by_fault[name].mean) for name, one in plain.by_fault.items()},
    )


@dataclass(frozen=True, kw_only=True)
class Candidates:
    """Motions of one task, planned in different ways, and their harm; the first has w = 0, the second the default w."""

    task: str
    names: tuple[str, ...]
    harm: Array
    """Harm of each failure times the duration of the motion [s]: one row per motion, with the same failures."""
    others: Array
    """Mean over the failures without the own loss of the carried object, times the duration."""
    duration: Array

    def less(self, name: str) -> str:
        """Return how much less harm a motion does than that for w = 0, in all and to others, and its extra duration."""
        if name not in self.names:
            return ""
        k, least = self.names.index(name), LEAST / self.harm.shape[1] * self.duration
        ratios = [of[0] / of[k] for of in (np.maximum(x, least) for x in (np.nanmean(self.harm, axis=1), self.others))]
        return "{:.2f}, {:.2f}, {:+.0f} %".format(*ratios, 100 * (self.duration[k] / self.duration[0] - 1))

    def halves(self) -> list[tuple[Array, Array]]:
        """Return harm per task on one half of the failures, which chooses the motion, and on the other; both ways."""
        least = 2.0 * LEAST / self.harm.shape[1] * self.duration
        even, odd = (np.maximum(np.nanmean(self.harm[:, k::2], axis=1), least) for k in (0, 1))
        return [(even, odd), (odd, even)]

    @property
    def default_less(self) -> float:
        """Harm per task at w = 0 over that at the default weight."""
        return float(np.exp(np.mean([np.log(on[0] / on[1]) for _, on in self.halves()])))

    @property
    def bound(self) -> float:
        """Harm per task at w = 0 over that of the best motion, which is chosen on other failures."""
        return float(np.exp(np.mean([np.log(on[0] / on[by.argmin()]) for by, on in self.halves()])))

    @property
    def chosen(self) -> str:
        """Name of the motion with the least harm on all failures."""
        return self.names[int(np.nanmean(self.harm, axis=1).argmin())]


def candidates(job: tuple[str, float, int, bool]) -> Candidates:
    """Plan a task in all ways, and simulate the same failures along all motions."""
    name, seconds, each, long = job
    scene, start, goal, faults = query_of(name)
    again, seeds = LONG_SEEDS if long else SEEDS
    ways = [(w, True, 0) for w in (LONG_WEIGHTS if long else WEIGHTS)] + [(w, False, 0) for w in OTHERS_ONLY]
    ways += [(w, True, seed) for w in again for seed in seeds]
    gp.plan(start, goal, scene, iterations=1)  # compiles
    found: dict[str, tuple[Array, float, float]] = {}
    for w, own, seed in ways:
        objective = gp.Objective(impact=gp.ImpactCost(own_loss=own))
        result = gp.plan(start, goal, scene, w=w, objective=objective, time_limit=seconds, seed=seed)
        settings = fb.SimSettings(people="stop")
        try:
            one = fb.validate(
                result, scene, faults, n=each * len(faults), horizon=HORIZON, threads=1, settings=settings
            )
        except (fb.ExecutionRefused, gp.PlanningFailed):
            continue
        label = "default" if w is None else f"w = {w:g}"
        label += "" if own else ", others only"
        others = (one.observed.mean - one.own_loss.mean) * one.duration
        found[f"{label}, seed {seed}" if seed else label] = one.impacts * one.duration, others, one.duration
    harm, others, duration = (np.stack(of) for of in zip(*found.values(), strict=True))
    return Candidates(task=name, names=tuple(found), harm=harm, others=others, duration=duration)


def bounds(options: suite.Options, names: Sequence[str]) -> str:
    """Measure the bound that the choice of a motion sets in bundled tasks."""
    each = options.pick(BOUND_FAILURES[0], quick=1, long=BOUND_FAILURES[1])
    jobs = [(name, options.seconds or SECONDS - 1.0, each, options.long) for name in names]
    return bound_table(list(suite.spread(candidates, jobs, options.processes, "tasks")))


def bound_table(found: Sequence[Candidates]) -> str:
    """Return the document of the bound."""
    rows = [
        [one.task, f"{len(one.names)}", f"{one.default_less:.2f}", f"{one.bound:.2f}", one.chosen,
         f"{100 * (one.duration[one.names.index(one.chosen)] / one.duration[0] - 1):+.0f} %"]
        for one in found
    ]  # fmt: skip
    middle = np.median([[one.default_less, one.bound] for one in found], axis=0)
    header = ("task", "motions", "default, x less", "best of all, x less", "least harm", "its duration")
    note = f"Medians: default {middle[0]:.2f}, best of all {middle[1]:.2f} times less harm per task than at w = 0."
    names = [name for name in dict.fromkeys(name for one in found for name in one.names) if name != "w = 0"]
    each = report.table(("task", *names), [(one.task, *(one.less(name) for name in names)) for one in found])
    return f"{BOUND}\n{report.table(header, rows)}\n{note}\n\n{EACH}\n\n{each}"


def run(options: suite.Options) -> str:
    """Measure bundled tasks and generated floors, or the bound for bundled tasks."""
    bundled = tuple(dict.fromkeys(f"{s.scene}/{s.task}" for s in fb.scenarios(f"{MOBILE}/*/{DEGREE}")))
    if options.bound:
        return bounds(options, suite.chosen(bundled[:1] if options.quick else bundled, options.tasks))
    plans, *failures = options.pick(SIZES, quick=(2, 1, 1), long=LONG_SIZES)
    floors = tuple(f"floor {k}" for k in range(plans))
    names = (bundled[0], *floors) if options.quick else (*bundled, *floors)
    # Planners of driving robots seldom use a second thread, so processes hardly slow each other down.
    jobs = [
        (name, options.seconds or SECONDS, failures[0 if name in floors else 1])
        for name in suite.chosen(names, options.tasks)
    ]
    found = list(suite.spread(examine, jobs, options.processes, "tasks"))
    table, groups = report.table(HEADER, [_row(one) for one in found]), report.table(GROUPED, list(_groups(found)))
    faults = report.table(BY_FAULT, list(_faults(found)))
    return f"{MEASURED}\n{report.targets(_targets(found))}\n{groups}\n{table}\n{faults}"


HEADER = ("task", "harm per failure, w = 0", "default", "harm per task, x less", "of others", "walk on",
          "duration", "predicted", "worse")  # fmt: skip
GROUPED = ("group", "tasks with figures", "harm per task, x less, median", "ratio of the means", "95 %",
           "of others, median", "ratio of the means", "duration, median")  # fmt: skip
BY_FAULT = ("fault", "floors: harm per failure, w = 0", "default", "bundled tasks: w = 0", "default")


def _groups(found: Sequence[Prevented]) -> Iterator[list[str]]:
    """Yield the results of the floors, with an empty robot, and of the bundled tasks."""
    for name, floors in (("generated floors", True), ("bundled tasks", False)):
        done = [one for one in found if not one.note and one.task.startswith("floor ") == floors]
        if done:
            less, others = np.median([[one.times_less, one.others_less] for one in done], axis=0)
            longer = np.median([one.longer for one in done])
            yield [name, f"{len(done)}", f"{less:.2f}", f"{_of_means(done, 'harm'):.2f}",
                   "{:.2f} to {:.2f}".format(*_interval(done)), f"{others:.2f}",
                   f"{_of_means(done, 'others'):.2f}", f"{100 * (longer - 1):+.1f} %"]  # fmt: skip


def _of_means(done: Sequence[Prevented], harm: str) -> float:
    """Return mean harm per executed task at w = 0 over that at the default weight: all `harm`, or that to `others`."""
    plain, ours = np.mean([np.multiply(getattr(one, harm), one.duration) for one in done], axis=0)
    return float(plain / ours)


def _interval(done: Sequence[Prevented]) -> Array:
    """Return the 95 % interval of the ratio of mean harm per executed task, for these motions."""
    rng, means = np.random.default_rng(SEED), np.zeros((RESAMPLES, 2))
    for one in done:
        harms = one.harms[:, np.isfinite(one.harms).all(axis=0)]
        drawn = rng.integers(harms.shape[1], size=(RESAMPLES, harms.shape[1]))
        means += np.maximum(harms[:, drawn].mean(axis=2).T, LEAST / one.failures) * one.duration
    return np.quantile(means[:, 0] / means[:, 1], [0.025, 0.975])


def _faults(found: Sequence[Prevented]) -> Iterator[list[str]]:
    """Yield the mean harm per failure of each fault, over floors and over bundled tasks, the worst fault first."""
    rows = []
    groups = [
        [one for one in found if not one.note and one.task.startswith("floor ") == floors] for floors in (True, False)
    ]
    for name in dict.fromkeys(name for one in found for name in one.by_fault):
        of = [[one.by_fault[name] for one in group if name in one.by_fault] for group in groups]
        rows.append((name, *(np.mean(values, axis=0) if values else (np.nan, np.nan) for values in of)))
    for name, floors, bundled in sorted(rows, key=lambda row: -np.nan_to_num(row[2][0])):
        figures = (*floors, *bundled)
        yield [name.split("/")[0], *("" if np.isnan(figure) else f"{figure:.2f}" for figure in figures)]


def _row(one: Prevented) -> list[str]:
    if one.note:
        return [one.task, one.note, *[""] * 7]
    return [
        one.task,
        f"{one.harm[0]:.3f}",
        f"{one.harm[1]:.3f}",
        f"{one.times_less:.2f}",
        f"{one.others_less:.2f}",
        f"{one.walk_on_less:.2f}",
        f"{one.duration[0]:.2f} s, {100 * (one.longer - 1):+.1f} %",
        f"{one.predicted[0]:.2f}, {one.predicted[1]:.2f}",
        "yes" if one.worse else "",
    ]


def _targets(found: Sequence[Prevented]) -> Iterator[report.Target]:
    done = [one for one in found if not one.note]
    refused = len(found) - len(done)
    yield report.none_of("tasks that are refused", refused, "none")
    for name, floors, wanted in (("tasks with a carried object", False, 2.0), ("floors", True, 2.5)):
        group = [one for one in done if one.task.startswith("floor ") == floors]
        if not group:
            continue
        less, longer = np.median([[one.times_less, one.longer] for one in group], axis=0)
        yield report.Target(
            what=f"harm per executed task at the default w against w = 0, {name}, median",
            wanted=f"{wanted:g} x less, <= 15 % longer",
            measured=f"{less:.2f} x less, {100 * (longer - 1):+.1f} %",
            met=bool(less >= wanted and longer <= 1.15),
        )
        mean = _of_means(group, "harm")
        yield report.Target(
            what=f"ratio of the means, {name}",
            wanted=f"{wanted:g} x less",
            measured="{:.2f} x ({:.2f} to {:.2f})".format(mean, *_interval(group)),
            met=mean >= wanted,
        )
    yield report.none_of("worse than at w = 0", sum(one.worse for one in done), "none")
