"""Harm of failures along motions planned with and without the impact, and over weights of several costs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from benchmarks import suite
from benchmarks.prevention.bound import bound_jobs, bound_sizes, bound_table, do_bound, read_bounds
from benchmarks.prevention.choosing import choice_jobs, choice_section, do_choice, read_choices
from benchmarks.prevention.figures import draw
from benchmarks.prevention.noticed import do_noticed, noticed_jobs, noticed_section, read_noticed
from benchmarks.prevention.runs import (
    ALL_FAULTS,
    NONE,
    OURS,
    OWN_SECONDS,
    PUBLISHED,
    SECONDS,
    SEED,
    HeadlineJob,
    do_curve,
    do_headline,
)
from benchmarks.prevention.tables import CURVE_DROPS, DROPS, MIXED, Sizes, curve_sections, headline_sections
from benchmarks.prevention.work import curve_jobs, fill, found, headline_jobs, kept, task_names
from failbench.report import FAILURES_PER_HOUR

TITLE = "Prevention: harm of failures along motions planned with and without the impact"
QUESTION = "How much less harm do failures cause along default motions than along the fastest motions (w = 0)?"
HEADLINE = "unseen: x less harm per task, drops, others only, median"
DEPENDS_ON = (
    *suite.PLANNING,
    *suite.SIMULATION,
    "sim/failbench/report.py",
    "benchmarks/prevention",
    "benchmarks/unseen",
)
LONG_DROPS, LONG_MIXED = 1000, 500
WEIGHTS = (0.1, 0.3, 1.0, 3.0, 10.0)
RELATIVE = (0.3, 1.0, 3.0, 10.0)
"""Weights of own costs, as multiples of the weight at which the straight path costs twice as much; see `weight_of`."""
PICTURE = Path(__file__).resolve().parents[2] / "docs" / "images" / "prevention.png"
MEASURED = f"""\
Every task of the bundled scenes and of `benchmarks/unseen/`. No constant was fitted on the latter; on the bundled
scenes constants were fitted to rollouts along other motions. All motions are planned at half of the velocity limits in
{SECONDS:g} s. Then the robot fails: "drops" are gripper failures, "mixed" are all 19 faults, severe, equally often. All
motions of a task have the same faults at the same fractions of their duration, with the same random numbers. Fingers
hold the object if they can along all motions of the task, otherwise a weld does. The impact of a failure is the sum of
the severities of all touches within 1 s.

**Per failure**: mean impact. **Per task**: failures come per hour, so harm per executed task is failure rate x duration
x mean impact. Absolute figures are for one failure in {1.0 / FAILURES_PER_HOUR:g} h and a million tasks; ratios do not
depend on the rate. "x less": harm at w = 0 over harm with the planner. If no failure of a motion hits anything, one of
them counts as a hit of the least severity of the scene. Medians and geometric means are over tasks; the latter have a
95 % interval from resampled tasks. "Worse" ("better"): tasks with more (less) harm per task than at w = 0, beyond the
95 % interval of the paired difference. "{ALL_FAULTS}": the default model with that prior of faults. Harm includes the
damage to the carried object; "others only" leaves it out, for the same motions. "By energy": the default model with
`consequence="energy"`; "harm by energy": each contact weighted by the probability of damage at its energy.

Harm of the healthy motion, such as spilling on the way, has probability 1 and is included in harm per task. It is no
failure's harm, and contents that were spilled before a failure cannot be spilled by it. The groups "nothing spilt on
the way" leave out tasks in which the motion at w = 0 or the default motion loses more than 1 %.
"""
CURVES_MEASURED = f"""\
## Harm over duration

Costs written in Python have {OWN_SECONDS:g} s per plan, to compare costs instead of speed. The object is dropped along
every motion. Own costs as a user may write them: "keep away" is the severity of each entity times exp(- distance / 0.15
m); "not above" is the severity of everything straight below; "carry low" is the height above what is below. Motions are
planned over a grid of weights of these costs, of the default model and of Algorithm 1. "At equal duration" reads harm
per task from the lower envelope over the weights, including w = 0, and interpolates its logarithm.
"""


def run(options: suite.Options) -> str:
    """Do the jobs that are left, and report on all finished ones; a long run adds the curves and their picture.

    With `options.bound`, measure the harm that the best of many motions prevents instead.
    """
    if options.bound:
        return _bound(options)
    names = task_names(options)
    asked = [name for all_of in names.values() for name in all_of]
    parts = [MEASURED, *_headline(options, names, asked)]
    if options.long or options.quick:
        parts += _curves(options, names, asked)
    return "\n".join(parts)


def asked_job(options: suite.Options) -> HeadlineJob:
    """Return the job of each task at the default weights."""
    drops, mixed = options.pick((DROPS, MIXED), quick=(16, 19), long=(LONG_DROPS, LONG_MIXED))
    return HeadlineJob(drops=options.drops or drops, mixed=options.mixed or mixed)


def sizes_of(options: suite.Options) -> Sizes:
    """Return the sizes of the curves."""
    weights, relative = options.pick((WEIGHTS, RELATIVE), quick=((1.0,), (3.0,)))
    drops = options.drops or options.pick(CURVE_DROPS, quick=8)
    return Sizes(drops=drops, weights=options.weights or weights, relative=relative)


def _bound(options: suite.Options) -> str:
    with kept(options) as folder:
        file = folder / f"bound.{SEED}{'.long' if options.long else ''}.jsonl"
        choices = folder / f"choices.{SEED}.jsonl"
        fill(file, bound_jobs(file, options), do_bound, options, "bound")
        fill(choices, choice_jobs(choices, options), do_choice, options, "choices")
        noticed = folder / f"noticed.{SEED}.jsonl"
        fill(noticed, noticed_jobs(noticed, options), do_noticed, options, "noticed failures")
        parts = [bound_table(read_bounds(file), bound_sizes(options)), *choice_section(read_choices(choices))]
        parts += noticed_section(read_noticed(noticed))
    return "\n".join(parts)


def _headline(options: suite.Options, names: Mapping[str, Sequence[str]], asked: Sequence[str]) -> Iterator[str]:
    job = asked_job(options)
    with kept(options) as folder:
        heads = folder / f"headline.{SEED}.{job.drops}.{job.mixed}.jsonl"
        fill(heads, headline_jobs(names, heads, job), do_headline, options, "prevention")
        done = found(names, heads)
    yield from headline_sections(done, asked, job)


def _curves(options: suite.Options, names: Mapping[str, Sequence[str]], asked: Sequence[str]) -> Iterator[str]:
    sizes = sizes_of(options)
    job = HeadlineJob(drops=sizes.drops, mixed=0, labels=(NONE, OURS, PUBLISHED))
    with kept(options) as folder:
        heads = folder / f"curve_heads.{SEED}.{sizes.drops}.jsonl"
        curves = folder / f"curves.{SEED}.{sizes.drops}.jsonl"
        fill(heads, headline_jobs(names, heads, job), do_headline, options, "curves, default weights")
        fill(curves, curve_jobs(names, heads, curves, sizes), do_curve, options, "curves")
        done = found(names, heads, curves)
    yield CURVES_MEASURED
    yield from curve_sections(done, asked, sizes)
    if not options.quick:
        draw(done, PICTURE)
        yield f"![harm per task over duration](../../docs/images/{PICTURE.name})\n"
