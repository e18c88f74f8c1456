"""Targets and tables of `prevention`."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from benchmarks import report
from benchmarks.prevention.figures import (
    MILLION,
    Found,
    Group,
    against_ours,
    at_weight,
    beyond,
    by_fault,
    least_of_all,
    longer,
    loses_contents,
    spilt_on_the_way,
    tasks_of,
    typical_less,
)
from benchmarks.prevention.harm_curves import Typical, typical
from benchmarks.prevention.runs import CURVES, MODELS, NONE, OURS, Headline, HeadlineJob, Motion
from failbench.report import FAILURES_PER_HOUR

KINDS = ("drops", "mixed")
DROPS, MIXED, CURVE_DROPS = 80, 57, 200
"""Failures per motion in a normal run, and drops per motion of the curves."""
DURATIONS = (1.05, 1.1, 1.2)
"""Durations relative to w = 0 at which planners are compared."""
TRUE_TO = (0.8, 1.25)
"""Target of predicted over observed harm."""
LESS, LESS_WITH_OWN, LESS_AT_CHOICE, LONGER, LESS_THAN_OTHERS = 2.5, 1.8, 4.0, 0.2, 1.5
"""Targets: ratio of harm per task at w = 0 over the default, without and with the object's own loss; the same at the
best w; largest increase of the median duration; ratio of the harm of other costs over the default."""


@dataclass(frozen=True, kw_only=True)
class Sizes:
    """Drops per motion, and weights of the curves."""

    drops: int
    weights: tuple[float, ...]
    relative: tuple[float, ...]


def headline_sections(found: Found, asked: Sequence[str], job: HeadlineJob) -> Iterator[str]:
    """Yield the sections on motions at the default w.

    Args:
        found: Finished jobs.
        asked: Names of the chosen tasks.
        job: The job of each task.
    """
    yield (
        f"{len(found.heads)} of {len(asked)} tasks, {job.drops} drops and {job.mixed} mixed failures or more "
        "a motion.\n"
    )
    yield from _remarks(found, asked)
    for label in job.labels:
        yield _listed(f"Healthy motions that spill more than 1 %, {label}", spilt_on_the_way(found.heads, label))
    yield report.targets(_headline_targets(found, job, len(asked)))
    for kind in KINDS:
        yield f"{kind.capitalize()}, at the default w:\n"
        yield report.table(_SUMMARY_HEADER, _summary(found, kind))
    yield "Mixed, fault by fault; each task counts alike:\n"
    yield report.table(_FAULT_HEADER, _by_fault(found))
    yield f"Task by task; harm per failure, and per million tasks at one failure in {1.0 / FAILURES_PER_HOUR:g} h:\n"
    yield report.table(_HEADER, (row for kind in KINDS for row in _rows(found, kind)))


def curve_sections(found: Found, asked: Sequence[str], sizes: Sizes) -> Iterator[str]:
    """Yield the sections on motions over weights."""
    yield (
        f"{len(found.heads)} of {len(asked)} tasks, {len(found.curves)} of {len(asked) * len(CURVES)} curves, "
        f"{sizes.drops} drops a motion.\n"
    )
    yield from _remarks(found, asked)
    yield report.targets(_curve_targets(found, sizes))
    yield (
        "Least observed harm along any motion of any cost and weight, which no planner can know in advance: "
        f"x less, median (geometric mean): {'; '.join(_least_of_all(found))}.\n"
    )
    yield "Default model over w:\n"
    yield report.table(_WEIGHT_HEADER, _over_w(found, sizes))
    yield from _equal_tables(found)


def _least_of_all(found: Found) -> Iterator[str]:
    for group in found.groups:
        value = least_of_all(found, group)
        if value.geometric.n:
            yield f"{group.name} {value.median:.2f} ({_with_interval(value)})"


def _remarks(found: Found, asked: Sequence[str]) -> Iterator[str]:
    yield _listed("Not done", sorted(set(asked) - {done.task for done in found.heads}))
    yield _listed("Held by a weld", [done.task for done in found.heads if done.grasp == "weld"])
    yield _listed("Not in", _refused(found))


def _listed(what: str, entries: Sequence[str]) -> str:
    return f"{what}: {'; '.join(entries)}.\n" if entries else f"{what}: none.\n"


def _refused(found: Found) -> list[str]:
    """List the motions that were not found or cannot be executed."""
    heads = [(x.task, label, x.motions[label]) for x in found.heads for label in x.motions]
    curves = [(x.task, f"{x.cost}, w {asked}", x.points[asked]) for x in found.curves.values() for asked in x.points]
    return [f"{task} ({label}): {motion.refused}" for task, label, motion in heads + curves if motion.refused]


def _headline_targets(found: Found, job: HeadlineJob, asked: int) -> Iterator[report.Target]:
    compared = [done for done in found.heads if done.motions[NONE].harm and done.motions[OURS].harm]
    whole = len(compared) == asked
    enough = {"drops": whole and job.drops >= DROPS, "mixed": whole and job.mixed >= MIXED}
    for group in found.groups:
        heads = tasks_of(found, group)
        if "," in group.name or not heads:
            continue
        for kind in KINDS:
            for own_loss, wanted in ((False, LESS), (True, LESS_WITH_OWN)):
                value = typical_less(heads, OURS, kind, "task", own_loss=own_loss)
                words = f"{kind}, {'the own loss of the object in it' if own_loss else 'others only'}"
                for which, x in (("median", value.median), ("geometric mean", value.geometric.mean)):
                    yield _at_least(f"{group.name}: x less harm per task, {words}, {which}", x, wanted, enough[kind])
            worse = beyond(heads, OURS, kind, 1.0)
            yield report.Target(
                what=f"{group.name}: tasks with more harm per task, {kind}, beyond their interval",
                wanted="none",
                measured=", ".join(worse) or "none",
                met=_met(not worse, enough[kind]),
            )
        share = longer(heads, OURS, "duration")
        yield report.Target(
            what=f"{group.name}: median duration",
            wanted=f"<= {report.percent(LONGER, 0)} more",
            measured=f"{report.percent(share)} more",
            met=_met(share <= LONGER, whole),
        )
        yield from _prediction_targets(heads, group, enough["drops"])


def _curve_targets(found: Found, sizes: Sizes) -> Iterator[report.Target]:
    for group in found.groups:
        if "," in group.name or not tasks_of(found, group):
            continue
        best = [at_weight(found, group, w)[2].median for w in sizes.weights]
        what = f"{group.name}: x less harm per task, drops, median, at the best w"
        yield _at_least(what, max((x for x in best if not math.isnan(x)), default=math.nan), LESS_AT_CHOICE, True)
        for cost in CURVES[1:]:
            value = typical(against_ours(found, group, cost, "duration", 1.0 + LONGER)).median
            more = report.percent(LONGER, 0)
            what = f"{group.name}: harm per task, {cost} over default, at {more} more duration, median"
            yield _at_least(what, value, LESS_THAN_OTHERS, True)


def _at_least(what: str, value: float, wanted: float, complete: bool) -> report.Target:
    met = None if math.isnan(value) else _met(value >= wanted, complete)
    return report.Target(what=what, wanted=f">= {wanted:g}", measured=report.quantity(value), met=met)


def _met(holds: bool, complete: bool) -> bool | None:
    """Whether a target is met; None if it holds but failures or tasks are missing."""
    return False if not holds else True if complete else None


def _prediction_targets(heads: Sequence[Headline], group: Group, complete: bool) -> Iterator[report.Target]:
    ours = [done.motions[OURS] for done in heads]
    kept = [x for x in ours if not loses_contents(x)]
    for which, motions in (("", ours), *([(", nothing spilt on the way", kept)] if len(kept) < len(ours) else [])):
        harms = [x.harm["drops"] for x in motions if "drops" in x.harm]
        seen = sum(harm.mean for harm in harms)
        ratio = sum(harm.predicted for harm in harms) / seen if seen else math.nan
        least, most = TRUE_TO
        yield report.Target(
            what=f"{group.name}{which}: predicted over observed harm of drops along default motions",
            wanted=f"{least:g} to {most:g}",
            measured=report.quantity(ratio),
            met=None if math.isnan(ratio) else _met(least <= ratio <= most, complete),
        )


_SUMMARY_HEADER = (
    "tasks",
    "planner",
    "n",
    "duration",
    "motion",
    "x less per failure, median",
    "geometric mean",
    "x less per task, median",
    "geometric mean",
    "others only: median",
    "geometric mean",
    "harm by energy: median",
    "geometric mean",
    "worse",
    "better",
)
_NOT_PLANNED = Motion(w=math.nan)
_FAULT_HEADER = ("fault", "tasks", "share of the harm at w = 0", *(f"x less per task, {label}" for label in MODELS))
_EQUAL_HEADER = ("tasks", "cost", "n", *(f"at +{100.0 * (d - 1.0):.0f} %, median (geometric mean)" for d in DURATIONS))
_WEIGHT_HEADER = ("tasks", "w", "duration", "motion", "x less per task, median", "geometric mean")
_HEADER = (
    "task",
    "failures",
    "duration, w = 0",
    *(f"{label}, duration" for label in MODELS),
    *(f"{label}, per failure" for label in (NONE, *MODELS)),
    "default, predicted",
    *(f"{label}, per million tasks" for label in (NONE, *MODELS)),
    "default, x less per task",
)


def _summary(found: Found, kind: str) -> Iterator[Sequence[object]]:
    for group in found.groups:
        heads = tasks_of(found, group)
        for label in _labels(heads):
            per_failure, per_task = (typical_less(heads, label, kind, per) for per in ("failure", "task"))
            others = typical_less(heads, label, kind, "task", own_loss=False)
            energy = typical_less(heads, label, kind, "task", by_energy=True)
            yield (
                group.name,
                label,
                per_task.geometric.n,
                _more(longer(heads, label, "duration")),
                _more(longer(heads, label, "length")),
                f"{per_failure.median:.2f}",
                f"{per_failure.geometric.mean:.2f}",
                f"{per_task.median:.2f}",
                _with_interval(per_task),
                f"{others.median:.2f}",
                _with_interval(others),
                f"{energy.median:.2f}",
                _with_interval(energy),
                len(beyond(heads, label, kind, 1.0)),
                len(beyond(heads, label, kind, -1.0)),
            )


def _labels(heads: Sequence[Headline]) -> list[str]:
    """Return the models of the planned motions."""
    return [label for label in MODELS if any(label in done.motions for done in heads)]


def _by_fault(found: Found) -> Iterator[Sequence[object]]:
    for group in found.groups:
        heads = tasks_of(found, group)
        if "," in group.name:
            continue
        less = {(label, row.fault): row.less for label in MODELS for row in by_fault(heads, label)}
        for row in by_fault(heads, OURS):
            known = (less.get((label, row.fault), math.nan) for label in MODELS)
            times = ("-" if math.isnan(x) else f"{x:.2f}" for x in known)
            yield row.fault, group.name, report.percent(row.share), *times


def _equal_tables(found: Found) -> Iterator[str]:
    for extent, word in (("duration", "duration"), ("length", "motion")):
        yield f"Drops, harm per task with other costs over that with the default model at equal {word}:\n"
        yield report.table(_EQUAL_HEADER, _equal(found, extent))


def _equal(found: Found, extent: str) -> Iterator[Sequence[object]]:
    for group in found.groups:
        for cost in CURVES[1:]:
            values = [typical(against_ours(found, group, cost, extent, at)) for at in DURATIONS]
            cells = (f"{value.median:.2f} ({_with_interval(value)})" for value in values)
            yield group.name, cost, values[0].geometric.n, *cells


def _over_w(found: Found, sizes: Sizes) -> Iterator[Sequence[object]]:
    for group in found.groups:
        for w in sizes.weights:
            duration, length, value = at_weight(found, group, w)
            yield (
                group.name,
                f"{w:g}",
                _more(duration - 1.0),
                _more(length - 1.0),
                f"{value.median:.2f}",
                _with_interval(value),
            )


def _rows(found: Found, kind: str) -> Iterator[Sequence[object]]:
    for done in found.heads:
        base, ours = done.motions[NONE], done.motions[OURS]
        if kind not in base.harm:
            continue
        motions = [done.motions.get(label, _NOT_PLANNED) for label in MODELS]
        harms = [motion.harm.get(kind) for motion in (base, *motions)]
        per_hour = [motion.duration * done.rate / 3600.0 * MILLION for motion in (base, *motions)]
        times = None if kind not in ours.harm else ours.harm[kind].less_per_task
        yield (
            done.task,
            kind,
            f"{base.duration:.2f} s",
            *(_more(motion.duration / base.duration - 1.0) for motion in motions),
            *("-" if harm is None else f"{harm.mean:.2f}" for harm in harms),
            "-" if kind not in ours.harm else f"{ours.harm[kind].predicted:.2f}",
            *(
                "-" if harm is None else f"{harm.mean * factor + motion.healthy * MILLION:.2f}{_mark(harm.rise)}"
                for harm, factor, motion in zip(harms, per_hour, (base, *motions), strict=True)
            ),
            "-" if times is None else "{:.2f} [{:.2f}, {:.2f}]".format(*times),
        )


def _mark(rise: tuple[float, float, float] | None) -> str:
    """Mark harm that is above (+) or below (*) that at w = 0 beyond its interval."""
    return "" if rise is None or rise[1] <= 0.0 <= rise[2] else " +" if rise[1] > 0.0 else " *"


def _more(share: float) -> str:
    return f"{100.0 * share:+.0f} %" if math.isfinite(share) else "-"


def _with_interval(value: Typical) -> str:
    x = value.geometric
    return f"{x.mean:.2f} [{x.low:.2f}, {x.high:.2f}]"
