"""Figures of `prevention`: ratios of harm at w = 0, and with other costs, over harm with the default."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.prevention.harm_curves import Offer, Typical, floored, harm_at, typical
from benchmarks.prevention.runs import NONE, OURS, PUBLISHED, Curve, Headline, Motion

MILLION = 1e6
"""Number of tasks for absolute harm."""
_HOUR = 3600.0
"""Seconds per hour."""
_LOST = 0.01
"""Share of the contents whose loss is negligible."""


class Group(NamedTuple):
    """Tasks that are summarised together."""

    name: str
    tasks: frozenset[str]


class Found(NamedTuple):
    """All finished jobs, and groups of tasks."""

    heads: list[Headline]
    curves: dict[tuple[str, str], Curve]
    groups: list[Group]


def less(done: Headline, label: str, kind: str, *, per: str, own_loss: bool = True, by_energy: bool = False) -> float:
    """Return harm at w = 0 over harm of a motion; NaN if either was not simulated.

    Args:
        done: The task.
        label: Label of the motion.
        kind: Kind of failures.
        per: "failure" or "task".
        own_loss: Whether the loss of the carried object itself counts.
        by_energy: Whether contacts count by the probability of damage at their energy.
    """
    base, own = done.motions[NONE], done.motions[label]
    if kind not in base.harm or kind not in own.harm:
        return math.nan
    if not own_loss:
        base, own = _without_own_loss(base), _without_own_loss(own)
    if by_energy:
        base, own = _by_energy(base), _by_energy(own)
    if per == "task":
        return _per_task(base, kind, done) / _per_task(own, kind, done)
    return _impact(base, kind, done.least) / _impact(own, kind, done.least)


def _without_own_loss(motion: Motion) -> Motion:
    harm = {kind: replace(x, mean=max(0.0, x.mean - x.own)) for kind, x in motion.harm.items()}
    return replace(motion, harm=harm)


def _by_energy(motion: Motion) -> Motion:
    return replace(motion, harm={kind: replace(x, mean=x.energy) for kind, x in motion.harm.items()})


def offers(done: Headline, curve: Curve, extent: str) -> list[Offer]:
    """Return the offers of a planner over its weights, by "duration" or "length" relative to w = 0."""
    base = done.motions[NONE]
    motions = [base, *curve.points.values()]
    if curve.cost in done.motions:
        motions.append(done.motions[curve.cost])
    return [
        Offer(getattr(x, extent) / getattr(base, extent), _per_task(x, "drops", done))
        for x in motions
        if "drops" in x.harm
    ]


def against_ours(found: Found, group: Group, cost: str, extent: str, at: float) -> list[float]:
    """Return harm per task with a cost over that with the default model, at equal duration or length, task by task."""
    ratios = []
    for done in found.heads:
        pair = [found.curves.get((done.task, label)) for label in (cost, OURS)]
        if done.task in group.tasks and "drops" in done.motions[NONE].harm and all(pair):
            theirs, ours = (harm_at(offers(done, curve, extent), at) for curve in pair if curve is not None)
            ratios.append(theirs / ours)
    return ratios


def _per_task(motion: Motion, kind: str, done: Headline) -> float:
    """Return harm per executed task over the failure rate per second, including harm of the healthy motion."""
    return _impact(motion, kind, done.least) * motion.duration + motion.healthy * _HOUR / done.rate


def _impact(motion: Motion, kind: str, least: float) -> float:
    harm = motion.harm[kind]
    return floored(harm.mean, harm.n, least)


def tasks_of(found: Found, group: Group) -> list[Headline]:
    """Return the finished tasks of a group."""
    return [done for done in found.heads if done.task in group.tasks]


def spilt_on_the_way(heads: Sequence[Headline], label: str) -> list[str]:
    """List tasks whose healthy motion loses contents."""
    return [done.task for done in heads if loses_contents(done.motions[label])]


def loses_contents(motion: Motion) -> bool:
    """Whether the healthy motion spills contents."""
    return motion.kept < 1.0 - _LOST


def typical_less(
    heads: Sequence[Headline], label: str, kind: str, per: str, *, own_loss: bool = True, by_energy: bool = False
) -> Typical:
    """Summarise `less` over tasks."""
    return typical([less(done, label, kind, per=per, own_loss=own_loss, by_energy=by_energy) for done in heads])


class OfFault(NamedTuple):
    """Harm of one fault among the mixed ones in a group of tasks."""

    fault: str
    share: float
    """Share of the harm at w = 0; all tasks have equal weight."""
    less: float
    """Harm per task at w = 0 over that of the motion; each task is normalised by its harm of all faults at w = 0."""


def by_fault(heads: Sequence[Headline], label: str) -> list[OfFault]:
    """Return the harm of each mixed fault at w = 0, and the ratio of harm with a model."""
    sums: dict[str, list[float]] = {}
    for done in heads:
        motions = [done.motions.get(x) for x in (NONE, label)]
        base, own = (None if motion is None else motion.harm.get("mixed") for motion in motions)
        if base is None or own is None or not base.mean > 0.0:
            continue
        longer = done.motions[label].duration / done.motions[NONE].duration
        for fault, harm in base.by_fault.items():
            found = sums.setdefault(fault, [0.0, 0.0])
            found[0] += harm / base.mean
            found[1] += longer * own.by_fault.get(fault, math.nan) / base.mean
    whole = sum(before for before, _ in sums.values())
    rows = [OfFault(k, a / whole, a / b if b > 0.0 else math.nan) for k, (a, b) in sums.items()]
    return sorted(rows, key=lambda row: -row.share)


def longer(heads: Sequence[Headline], label: str, extent: str) -> float:
    """Return the median relative increase of duration or length over w = 0."""
    pairs = [(done.motions[NONE], done.motions[label]) for done in heads]
    ratios = [getattr(own, extent) / getattr(base, extent) for base, own in pairs if base.harm and own.harm]
    return float(np.median(ratios)) - 1.0 if ratios else math.nan


def beyond(heads: Sequence[Headline], label: str, kind: str, sign: float) -> list[str]:
    """List tasks whose harm per task is above (1) or below (-1) that at w = 0 beyond the interval."""
    return [
        done.task
        for done in heads
        if kind in done.motions[label].harm
        and (rise := done.motions[label].harm[kind].rise) is not None
        and (rise[1] > 0.0 if sign > 0.0 else rise[2] < 0.0)
    ]


def at_weight(found: Found, group: Group, w: float) -> tuple[float, float, Typical]:
    """Return median duration and length relative to w = 0, and typical ratios of harm, of the default model."""
    extents, ratios = [], []
    for done in tasks_of(found, group):
        curve, base = found.curves.get((done.task, OURS)), done.motions[NONE]
        own = None if curve is None else curve.points.get(f"{w:g}")
        if own is None or "drops" not in own.harm or "drops" not in base.harm:
            continue
        extents.append((own.duration / base.duration, own.length / base.length))
        harm = [_per_task(x, "drops", done) for x in (base, own)]
        ratios.append(harm[0] / harm[1])
    duration, length = np.median(extents, axis=0) if extents else (math.nan, math.nan)
    return float(duration), float(length), typical(ratios)


def least_of_all(found: Found, group: Group) -> Typical:
    """Return harm at w = 0 over harm along the best motion of any cost and weight, by observed harm.

    The choice profits from chance. It is an upper bound of the harm that planning can prevent in these tasks.
    """
    ratios = []
    for done in tasks_of(found, group):
        motions = [x for (task, _), curve in found.curves.items() if task == done.task for x in curve.points.values()]
        harms = [_per_task(x, "drops", done) for x in motions if "drops" in x.harm]
        if harms and "drops" in done.motions[NONE].harm:
            ratios.append(_per_task(done.motions[NONE], "drops", done) / min(harms))
    return typical(ratios)


def draw(found: Found, file: Path) -> None:
    """Draw harm per task against duration over the weights, a panel for each scene, a line for each task."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    drawn_tasks = {task for task, cost in found.curves if cost == OURS}
    scenes = list(dict.fromkeys(done.task.split("/")[0] for done in found.heads if done.task in drawn_tasks))
    if not scenes:
        return
    columns = min(5, len(scenes))
    rows = -(-len(scenes) // columns)
    figure = Figure(figsize=(3.2 * columns, 3.0 * rows), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axes = list(figure.subplots(rows, columns, squeeze=False).flat)
    panels = dict(zip(scenes, axes, strict=False))
    for unused in axes[len(scenes) :]:
        unused.set_visible(False)
    for done in found.heads:
        if done.task not in drawn_tasks:
            continue
        name, task = done.task.split("/")
        color = None
        for cost, style in ((OURS, "o-"), (PUBLISHED, "x:")):
            curve = found.curves.get((done.task, cost))
            if curve is None or "drops" not in done.motions[NONE].harm:
                continue
            points = sorted(offers(done, curve, "duration"))
            unit = done.rate / _HOUR * MILLION
            label = task if cost == OURS else None
            (drawn,) = panels[name].plot(
                [p.extent for p in points], [p.harm * unit for p in points], style, ms=3, lw=1, color=color, label=label
            )
            color = drawn.get_color()
    for name, panel in panels.items():
        panel.set(title=name, xlabel="duration over that at w = 0", ylabel="harm per million tasks", yscale="log")
        if panel.get_legend_handles_labels()[0]:
            panel.legend(fontsize=6)
    figure.suptitle("Drops, one failure in 1000 h: default model (dots) and Algorithm 1 (crosses) over their weights")
    figure.savefig(file)
