"""Figures and tables of `libero`: predictions event by event, and harm at w = 0 over the harm of other motions."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from benchmarks import report
from benchmarks.events import FIGURES, Events
from benchmarks.libero.runs import ENERGY, HEAVY, MODELS, NONE, OBJECTIVES, OURS, PARTS, PUBLISHED, Done, Motion
from benchmarks.prevention.harm_curves import Typical, floored, typical
from failbench.calibrations import skill

CONTACT, BY_ENERGY = "contact", "energy"
"""How contacts count: in full, or weighted by the probability of damage at their energy."""
MOST = 40
"""Target: number of tasks with a transport, and of objects that it brings to their place."""
LEAST_SKILL, BYSTANDERS, RATIO = 0.82, 0.65, (0.8, 1.25)
LESS, LESS_THAN_PUBLISHED, LESS_TO_BYSTANDERS, LONGER = 2.0, 1.4, 4.0, 0.1
"""Targets: Brier skill of all events and of other things, predicted over observed hits; harm per task at w = 0 and of
Algorithm 1 over the default's, and that to bystanders; increase of the median duration."""
KINDS = ("floor", "furniture", "racks and containers", "bowls, plates, mugs", "groceries, books, pans")


def events_of(heads: Sequence[Done]) -> Events:
    """Return the events of all observed motions; resampling treats each motion as one."""
    kinds, predicted, happened, motion, scene = [], {name: [] for name in MODELS}, [], [], []
    for done in heads:
        for label, found in done.motions.items():
            if found.events is not None:
                kinds += found.events.kind
                happened += found.events.happened
                motion += [f"{done.task} {label}"] * len(found.events.kind)
                scene += [done.task] * len(found.events.kind)
                for name in MODELS:
                    predicted[name] += found.events.predicted[name]
    return Events(
        scene=np.array(scene),
        motion=np.unique(motion, return_inverse=True)[1] if motion else np.zeros(0, dtype=int),
        happened=np.array(happened, dtype=bool),
        predicted={name: np.array(values) for name, values in predicted.items()},
        labels={"kind": np.array(kinds)},
    )


def per_task(motion: Motion, by: str, done: Done, parts: Sequence[str] = PARTS) -> float:
    """Return the harm per executed task over the failure rate per second; NaN for a refused motion."""
    if motion.refused:
        return math.nan
    harm = getattr(motion, by)
    return floored(sum(harm[part] for part in parts), done.drops, done.least) * motion.duration


def less(heads: Sequence[Done], label: str, by: str, parts: Sequence[str] = PARTS, base: str = NONE) -> Typical:
    """Return the typical ratio, over the tasks, of the harm of motion `base` to that of motion `label`."""
    return typical([_ratio(done, label, by, parts, base) for done in heads])


def _ratio(done: Done, label: str, by: str, parts: Sequence[str], base: str) -> float:
    pair = [per_task(done.motions[name], by, done, parts) for name in (base, label)]
    return pair[0] / pair[1]


def summed(
    heads: Sequence[Done], label: str, by: str, parts: Sequence[str] = PARTS, base: str = NONE
) -> tuple[float, float, float]:
    """Return the harm of the base summed over tasks over that of a motion, with an interval from resampled tasks."""
    pairs = np.array(
        [
            [sum(getattr(done.motions[name], by)[part] for part in parts) * done.motions[name].duration
             for name in (base, label)]
            for done in heads
            if not (done.motions[base].refused or done.motions[label].refused)
        ]
    )  # fmt: skip
    if not len(pairs) or pairs.sum() <= 0.0:
        return math.nan, math.nan, math.nan
    rows = np.random.default_rng(0).integers(len(pairs), size=(1000, len(pairs)))
    sums = pairs[rows].sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = pairs[:, 0].sum() / pairs[:, 1].sum()
        low, high = np.nanquantile(sums[:, 0] / sums[:, 1], [0.025, 0.975], method="nearest")
    return float(mean), float(low), float(high)


def best_published(heads: Sequence[Done]) -> str:
    """Return the weight of Algorithm 1 with the least harm by contact over all tasks, chosen after the fact."""
    return max(PUBLISHED, key=lambda label: summed(heads, label, CONTACT)[0])


def longer(heads: Sequence[Done], label: str) -> float:
    """Return the median relative increase of the duration over w = 0."""
    ratios = [
        done.motions[label].duration / done.motions[NONE].duration
        for done in heads
        if not (done.motions[label].refused or done.motions[NONE].refused)
    ]
    return float(np.median(ratios)) - 1.0 if ratios else math.nan


# --- tables -----------------------------------------------------------------------------------------------------------

_HARM_HEADER = ("motion", "tasks", "duration", "x less by contact", "in sum", "by energy, in sum", "worse")
WORSE = 1.05
"""Harm over that at w = 0 above which a task counts as worse."""


def targets(heads: Sequence[Done], events: Events, resamples: int, asked: int) -> Iterator[report.Target]:
    """Yield the targets of the issue."""
    solved = sum(not motion.refused for done in heads for motion in done.motions.values())
    yield report.all_done("motions that are found and executed", solved, sum(len(done.motions) for done in heads))
    arrived = sum(done.motions[OURS].arrives for done in heads)
    for what, count in (("tasks", len(heads)), ("tasks whose default motion brings the object to its place", arrived)):
        yield report.Target(what=what, wanted=f">= {MOST}", measured=f"{count} of {asked}", met=count >= MOST)

    def estimate(what: str, some: Events, statistic: object, wanted: str, low: float, high: float) -> report.Target:
        x = skill.bootstrap(
            statistic,  # pyright: ignore[reportArgumentType]
            some.predicted["mixture"],
            some.happened,
            some.motion,
            resamples=resamples,
        )
        return report.Target(what=what, wanted=wanted, measured=str(x), met=bool(low <= x.mean <= high))

    for what, least, names in (
        ("all", LEAST_SKILL, KINDS),
        ("bowls, plates, mugs", BYSTANDERS, KINDS[3:4]),
        ("groceries, books, pans", BYSTANDERS, KINDS[4:]),
        ("racks and containers", BYSTANDERS, KINDS[2:3]),
    ):
        some = events.only(np.isin(events.labels["kind"], names))
        if some.happened.any():
            yield estimate(f"Brier skill, {what}", some, skill.brier_skill, f">= {least:g}", least, math.inf)
            wanted = f"{RATIO[0]:g} to {RATIO[1]:g}"
            yield estimate(f"predicted over observed hits, {what}", some, skill.predicted_ratio, wanted, *RATIO)
    published = best_published(heads)
    for base, what, wanted in ((NONE, "w = 0", LESS), (published, published, LESS_THAN_PUBLISHED)):
        x = less(heads, OURS, CONTACT, base=base).geometric
        yield _at_least(f"x less harm per task by contact than {what}, geometric mean", (x.mean, x.low, x.high), wanted)
        for by in (CONTACT, BY_ENERGY):
            yield _at_least(
                f"x less harm per task by {by} than {what}, in sum", summed(heads, OURS, by, base=base), wanted
            )
    yield _at_least(
        "x less harm by contact to bystanders than w = 0, in sum",
        summed(heads, OURS, CONTACT, PARTS[1:2]),
        LESS_TO_BYSTANDERS,
    )
    more = longer(heads, OURS)
    yield report.Target(
        what="median duration, default",
        wanted=f"<= {report.percent(LONGER, 0)} more",
        measured=f"{report.percent(more)} more",
        met=bool(more <= LONGER),
    )


def _at_least(what: str, x: tuple[float, float, float], wanted: float) -> report.Target:
    return report.Target(what=what, wanted=f">= {wanted:g}", measured=_interval(x), met=bool(x[0] >= wanted))


def _interval(x: tuple[float, float, float]) -> str:
    return "-" if math.isnan(x[0]) else "{:.2f} [{:.2f}, {:.2f}]".format(*x)


def prediction_table(events: Events) -> str:
    """Return figures by kind of entity and model."""
    rows = []
    for kind in ("", *KINDS):
        some = events.only(events.labels["kind"] == kind) if kind else events
        rows += [(kind or "all", model, *some.figures(model)) for model in MODELS if len(some.happened)]
    return report.table(("what may be hit", "model", *FIGURES), rows)


def harm_table(heads: Sequence[Done]) -> str:
    """Return harm at w = 0 over that of each motion."""
    rows = []
    for label in OBJECTIVES:
        if label == NONE:
            continue
        x = less(heads, label, CONTACT).geometric
        worse = sum(_ratio(done, label, CONTACT, PARTS, NONE) < 1.0 / WORSE for done in heads)
        sums = [_interval(summed(heads, label, by)) for by in (CONTACT, BY_ENERGY)]
        more = f"{report.percent(longer(heads, label))} more"
        rows.append((label, x.n, more, _interval((x.mean, x.low, x.high)), *sums, worse))
    return report.table(_HARM_HEADER, rows)


def parts_table(heads: Sequence[Done]) -> str:
    """Return the mean harm of a drop by part, and the sum of w = 0 over that of each motion."""
    rows = []
    for by in (CONTACT, BY_ENERGY):
        for label in (NONE, OURS, HEAVY, ENERGY, best_published(heads)):
            motions = [done.motions[label] for done in heads if not done.motions[label].refused]
            means = [float(np.mean([getattr(motion, by)[part] for motion in motions])) for part in PARTS]
            rows.append((
                f"by {by}", label,
                *(f"{mean:.3g}" + ("" if label == NONE else f" ({summed(heads, label, by, [part])[0]:.2f})")
                  for mean, part in zip(means, PARTS, strict=True)),
            ))  # fmt: skip
    return report.table(("harm", "motion", *PARTS), rows)
