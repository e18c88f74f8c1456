"""Picture of an explanation: the impact along a motion by entity, and the intervals of its largest parts."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from graceful_plan.analysis.explanation import STRETCH, Contribution, Explanation
from graceful_plan.array_types import Array, Float
from graceful_plan.viz.style import ENTITY_COLOURS, OTHERS_COLOUR, STYLE

_ROWS = 8
"""Maximum number of parts with drawn intervals."""
_LEAST = 0.005
"""Share of the impact above which an entity has a separate colour."""
_LABELS = {
    "length": ("path length [rad]", "impact if it fails here"),
    "time": ("time [s]", "impact if it fails then"),
    "waypoints": ("path length [rad]", "impact if it fails here"),
}


def draw_explanation(explanation: Explanation, file: str | FilePath) -> None:
    """Draw the impact along a motion, stacked by entity, above the intervals of its largest parts.

    Args:
        explanation: Result of `graceful_plan.explain`.
        file: Picture to write; its extension selects the format (png, pdf, svg).
    """
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows = explanation.contributions[:_ROWS]
    names = _shown_entities(explanation)
    colours = dict(zip(names, ENTITY_COLOURS, strict=False))
    with rc_context(STYLE):
        figure = Figure(figsize=(7.6, 3.4 + 0.2 * len(rows)), dpi=150, layout="constrained")
        FigureCanvasAgg(figure)
        height = max(0.15, 0.095 * len(rows))
        along, parts = figure.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": (1.0, height)})
        _draw_along(along, explanation, names, colours)
        _draw_stretches(parts, explanation, rows, colours)
        figure.savefig(file)


def _shown_entities(explanation: Explanation) -> list[str]:
    """Return the entities with the largest impact, at most one per colour."""
    parts, least = explanation.cost.impact_by_entity, _LEAST * explanation.cost.impact
    ordered = sorted((name for name in parts if parts[name] > least), key=lambda name: -parts[name])
    return ordered[: len(ENTITY_COLOURS)]


def _axis(explanation: Explanation) -> Float[Array, " n"]:
    """Return the abscissa: time if the impact is integrated over time, else path length."""
    by_time = explanation.exposure == "time" and explanation.time is not None
    return explanation.time if by_time and explanation.time is not None else explanation.place


def _draw_along(axes: Any, explanation: Explanation, names: list[str], colours: Mapping[str, str]) -> None:
    at, density = _axis(explanation), explanation.by_entity
    columns = [explanation.entities.index(name) for name in names]
    stack = [*density[:, columns].T, density.sum(axis=1) - density[:, columns].sum(axis=1)]
    total = max(explanation.cost.impact, 1e-300)
    shares = [explanation.cost.impact_by_entity[name] / total for name in names]
    labels = [f"{name} {share:.0%}" for name, share in zip(names, shares, strict=True)]
    labels.append(f"others {max(0.0, 1.0 - sum(shares)):.0%}")
    paint = [*(colours[name] for name in names), OTHERS_COLOUR]
    if sum(shares) > 1.0 - _LEAST and len(names) > 0:
        stack, labels, paint = stack[:-1], labels[:-1], paint[:-1]
    if explanation.exposure == "waypoints" or len(at) < 2:
        _draw_bars(axes, at, stack, labels, paint)
    else:
        # The integral uses the mean of two neighbouring samples, which also averages over their two velocities.
        apart = np.diff(at) > 0.0
        middle = [0.5 * (layer[1:] + layer[:-1])[apart] for layer in stack]
        axes.stackplot(0.5 * (at[1:] + at[:-1])[apart], middle, labels=labels, colors=paint, linewidth=0.0)
    axes.set(
        title=f"Impact along the motion, {explanation.cost.impact:.4g} in all", ylabel=_LABELS[explanation.exposure][1]
    )
    axes.set_ylim(0.0, None)
    axes.margins(x=0.0)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), reverse=True)


def _draw_bars(
    axes: Any, at: Float[Array, " n"], stack: list[Float[Array, " n"]], labels: list[str], paint: list[str]
) -> None:
    width = 0.02 * max(float(np.ptp(at)), 1.0)
    base = np.zeros(len(at))
    for layer, label, colour in zip(stack, labels, paint, strict=True):
        axes.bar(at, layer, width=width, bottom=base, label=label, color=colour)
        base = base + layer


def _draw_stretches(
    axes: Any, explanation: Explanation, rows: tuple[Contribution, ...], colours: Mapping[str, str]
) -> None:
    by_time = explanation.exposure == "time" and explanation.time is not None
    for k, row in enumerate(rows):
        begin, end, worst = row.begin, row.end, row.worst
        if by_time and row.begin_time is not None and row.end_time is not None and row.worst_time is not None:
            begin, end, worst = row.begin_time, row.end_time, row.worst_time
        colour = colours.get(row.entity, OTHERS_COLOUR)
        axes.plot([begin, end], [k, k], color=colour, linewidth=5.0, solid_capstyle="butt")
        axes.plot([worst], [k], marker="|", color="#111111", markersize=8.0)
    axes.set_yticks(range(len(rows)), [f"{row.event} {row.share:.0%}" for row in rows], fontsize=7.5)
    axes.set_ylim(max(len(rows), 1) - 0.5, -0.5)
    axes.set(xlabel=_LABELS[explanation.exposure if by_time else "length"][0])
    axes.set_title(f"Intervals with {STRETCH:.0%} of the largest parts; line: where it is most likely")
