"""Does planning with the impact prevent damage? What failures do along motions planned with it and without."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from benchmarks import suite
from benchmarks.prevention.figures import Found, Group, draw, spilt_on_the_way
from benchmarks.prevention.runs import (
    ALL_FAULTS,
    CURVES,
    MODELS,
    NONE,
    OURS,
    OWN_SECONDS,
    SECONDS,
    SEED,
    Curve,
    CurveJob,
    Headline,
    HeadlineJob,
    do_curve,
    do_headline,
    line,
    read_curves,
    read_headlines,
)
from benchmarks.prevention.tables import CURVE_DROPS, DROPS, MIXED, Sizes, sections
from failbench.report import FAILURES_PER_HOUR

TITLE = "Damage prevented: failures along motions planned with and without regard for them"
MEASURED = f"""\
Every task of every bundled scene and of those in `benchmarks/unseen/`, on which no constant was fitted (the constants
were fitted on rollouts in the bundled scenes, along other motions). All are planned at half of the velocity limits, in
{SECONDS:g} s, with costs written in Python in {OWN_SECONDS:g} s, so that costs are compared and not their speed. Then
the robot fails: "drops", the gripper lets go; "mixed", each of the 19 faults, severe, equally often. All motions of a
task have the same faults at the same fractions of their time, with the same random numbers; fingers hold the object
where they can along all of them, otherwise a weld. Impact: sum of the severities of what is touched within 1 s.
**Per failure**: its mean. **Per task**: failures come per hour, so harm per executed task is failure rate x duration x
mean impact of a failure; absolute figures are for one failure in {1.0 / FAILURES_PER_HOUR:g} h and a million tasks,
ratios do not depend on the rate. "x less": harm at w = 0 over that of the planner. Where n failures hit nothing, one of
them counts as a hit of the least severity of the scene: there is no ratio to nothing. Medians and geometric means are
over tasks, the latter with the 95 % interval between percentiles of resampled tasks. "Worse": tasks with more harm per
task than at w = 0 beyond the 95 % interval of the paired difference; "better" likewise. "{ALL_FAULTS}": the default
model with that prior of faults.

What a healthy robot does harm to on its way, such as by spilling, is in harm per task with probability 1, whatever the
rate. It is no failure's harm, and what has left before a failure cannot be spilt by it. Tasks of which a motion at
w = 0 or of the default loses more than 1 % are left out of the groups "nothing spilt on the way".

Targets are for {DROPS:,} drops and {MIXED} mixed failures a motion on all tasks; what holds with fewer is "not
measured".

Common sense, as own costs: "keep away", the severity of everything around times exp(- distance / 0.15 m); "not above",
the severity of everything straight below; "carry low", the height above what is below. Each is planned with over a
grid of weights, and so are the default model and Algorithm 1; "at equal duration" reads harm per task off the lower
envelope of what a planner offers over its weights, w = 0 included, interpolating its logarithm.
"""
STORE = Path(__file__).resolve().parents[1] / "prevented"
"""A line for each job that is done; an interrupted run goes on where it was. To measure anew, take the folder away."""
PICTURE = Path(__file__).resolve().parents[2] / "docs" / "images" / "prevention.png"
BUNDLED, UNSEEN = "bundled", "unseen"
WEIGHTS = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0)
RELATIVE = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0)
"""Weights of own costs, as multiples of that at which the straight path costs as much again; see `weight_of`."""


def run(options: suite.Options) -> str:
    """Do what is left to do, and report on all that is done."""
    sizes = sizes_of(options)
    names = task_names(options)
    with _folder(options) as folder:
        heads = folder / f"headline.{SEED}.{sizes.drops}.{sizes.mixed}.jsonl"
        curves = folder / f"curves.{SEED}.{sizes.curve_drops}.jsonl"
        until = math.inf if options.seconds is None else time.monotonic() + options.seconds
        if options.phase != "curves":
            _fill(heads, headline_jobs(names, heads, sizes), do_headline, options, until)
        if options.phase != "headline":
            _fill(curves, curve_jobs(names, heads, curves, sizes), do_curve, options, until)
        found = _found(names, heads, curves)
    whole = not options.quick and options.tasks == suite.Options().tasks
    if whole:
        draw(found, PICTURE)
    picture = [f"![harm per task over duration](../docs/images/{PICTURE.name})\n"] if whole else []
    asked = [name for all_of in names.values() for name in all_of]
    return "\n".join([MEASURED, *sections(found, asked, sizes), *picture])


def sizes_of(options: suite.Options) -> Sizes:
    """Return sizes as they were asked for."""
    drops, mixed, curve_drops = options.pick((DROPS, MIXED, CURVE_DROPS), quick=(16, 19, 8))
    weights, relative = options.pick((WEIGHTS, RELATIVE), quick=((1.0,), (3.0,)))
    return Sizes(
        drops=options.drops or drops,
        mixed=options.mixed or mixed,
        curve_drops=options.curve_drops or curve_drops,
        weights=options.weights or weights,
        relative=relative,
    )


def task_names(options: suite.Options) -> dict[str, list[str]]:
    """Return the names of the tasks that were asked for, bundled and unseen; of a quick run one of each kind."""
    names = {BUNDLED: suite.task_names(options), UNSEEN: suite.unseen_task_names(options)}
    if options.quick:
        names = {
            key: list({suite.is_tabletop(name): name for name in all_of}.values()) for key, all_of in names.items()
        }
    return {key: suite.chosen(all_of, options.tasks) for key, all_of in names.items()}


# --- jobs ------------------------------------------------------------------------------------------------------------


def headline_jobs(names: Mapping[str, Sequence[str]], file: Path, sizes: Sizes) -> list[HeadlineJob]:
    """List what is left to do of the first phase."""
    have = {done.task for done in read_headlines(file)}
    todo = [name for all_of in names.values() for name in all_of if name not in have]
    return [HeadlineJob(task=name, drops=sizes.drops, mixed=sizes.mixed) for name in todo]


def curve_jobs(names: Mapping[str, Sequence[str]], heads: Path, file: Path, sizes: Sizes) -> list[CurveJob]:
    """List what is left to do of the second phase: in tasks whose motion at w = 0 failed in the first."""
    grasps = {done.task: done.grasp for done in read_headlines(heads) if done.motions[NONE].harm}
    have = {(done.task, done.cost): set(done.points) for done in read_curves(file)}
    jobs = []
    for cost in reversed(CURVES):  # those that take longest first
        for name in (name for all_of in names.values() for name in all_of if name in grasps):
            wanted = sizes.weights if cost in MODELS else sizes.relative
            left = tuple(w for w in wanted if f"{w:g}" not in have.get((name, cost), ()))
            if left:
                jobs.append(CurveJob(task=name, cost=cost, weights=left, grasp=grasps[name], drops=sizes.curve_drops))
    return jobs


def _fill(
    file: Path, jobs: Sequence[Any], do: Callable[[Any], Headline | Curve], options: suite.Options, until: float
) -> None:
    file.parent.mkdir(exist_ok=True)
    with file.open("a", encoding="utf-8") as out:
        for done in suite.spread(do, jobs, options.processes, f"prevention, {file.name.split('.')[0]}"):
            out.write(line(done))
            out.flush()
            if time.monotonic() > until:
                break


@contextmanager
def _folder(options: suite.Options) -> Iterator[Path]:
    if options.quick:  # it has nothing to keep
        with tempfile.TemporaryDirectory() as scratch:
            yield Path(scratch)
    else:
        yield STORE


def _found(names: Mapping[str, Sequence[str]], heads: Path, curves: Path) -> Found:
    order = [name for all_of in names.values() for name in all_of]
    done = sorted((x for x in read_headlines(heads) if x.task in order), key=lambda x: order.index(x.task))
    groups = []
    for key, all_of in names.items():
        for kind, wanted in (("", (True, False)), (", household", (False,)), (", tabletop", (True,))):
            tasks = frozenset(name for name in all_of if suite.is_tabletop(name) in wanted)
            if tasks:
                groups.append(Group(f"{key}{kind}", tasks))
        spilt = set(spilt_on_the_way(done, NONE) + spilt_on_the_way(done, OURS))
        if set(all_of) - spilt:
            groups.append(Group(f"{key}, nothing spilt on the way", frozenset(all_of) - spilt))
    return Found(done, {(x.task, x.cost): x for x in read_curves(curves) if x.task in order}, groups)
