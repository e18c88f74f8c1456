"""Figures of a comparison as SVG text, for embedding in a page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from graceful_plan.compare.reports.summary import Summary, gap_curve, shares, solved_curve, time_grid
from graceful_plan.compare.runs.comparison import Comparison
from graceful_plan.viz.html_page import svg

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = ("#111111", "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8c6d31")
"""Okabe and Ito's colours without yellow, distinguishable with colour blindness; beyond eight, line styles differ."""
LINES = ("-", "--", ":", "-.")
MARKERS = "osD^vP*X<>hp"
BANDS = 5
"""Maximum number of planners with bands in one figure; with more, each also gets a panel."""
_LEAST_GAP, _GREATEST_GAP = 1e-3, 10.0
_DOTS = 300


def look(index: int) -> dict[str, Any]:
    """Return colour and line style of a planner by its index."""
    return {"color": COLOURS[index % len(COLOURS)], "linestyle": LINES[index // len(COLOURS) % len(LINES)]}


def solved_figure(summary: Summary) -> str:
    """Draw the share of runs with a path over time."""
    comparison = summary.comparison

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        times = time_grid(comparison)
        for i, planner in enumerate(comparison.planners):
            axes.step(times, 100.0 * solved_curve(comparison, planner, times), where="post", label=planner, **look(i))
        axes.set_ylim(-3, 103)
        axes.set_ylabel("runs with a path [%]")
        _time_axis(axes, comparison)
        _legend(figure, axes)

    return svg(draw, "solved", 3.0)


def gap_figure(summary: Summary) -> str:
    """Draw the median gap over time, with quartiles if there are few planners."""
    comparison = summary.comparison

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        bands = len(comparison.planners) <= BANDS
        for i, planner in enumerate(comparison.planners):
            _gap_lines(axes, summary, planner, i, band=bands)
        _gap_axis(axes)
        _time_axis(axes, comparison)
        _legend(figure, axes)

    return svg(draw, "gap", 3.6)


def gap_panels(summary: Summary) -> str:
    """Draw the gap of each planner in a separate panel, with the medians of the others in grey."""
    comparison = summary.comparison
    columns = 3
    rows = -(-len(comparison.planners) // columns)

    def draw(figure: Figure) -> None:
        panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
        times = time_grid(comparison)
        medians = [gap_curve(comparison, planner, summary.best, times)[1] for planner in comparison.planners]
        for i, axes in enumerate(panels):
            if i >= len(comparison.planners):
                axes.axis("off")
                continue
            for other in medians:
                axes.plot(times, _drawn(other), color="#d0d0d0", linewidth=0.8)
            _gap_lines(axes, summary, comparison.planners[i], i, band=True)
            axes.set_title(comparison.planners[i])
            _gap_axis(axes)
            _time_axis(axes, comparison)
            axes.label_outer()

    return svg(draw, "panels", 1.9 * rows + 0.3)


def share_figure(summary: Summary) -> str:
    """Draw motion against impact, both in units of the problem's best-known total."""
    comparison = summary.comparison

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        greatest = 1.2
        for i, planner in enumerate(comparison.planners):
            points = shares(comparison, summary.best, planner)
            style: dict[str, Any] = {"color": COLOURS[i % len(COLOURS)], "marker": MARKERS[i % len(MARKERS)]}
            axes.plot(*points.T, linestyle="none", markersize=5, alpha=0.75, markeredgewidth=0, label=planner, **style)
            greatest = max([greatest, *points.sum(axis=1)])
        greatest = min(greatest, 4.0)
        for total, words in ((1.0, "best known"), (1.1, "+10 %"), (1.5, "+50 %"), (2.0, "+100 %")):
            if total <= greatest:
                axes.plot([0, total], [total, 0], color="#b0b0b0", linewidth=0.8, zorder=0)
                at = (3, 1) if total > 1.0 else (3, -9)
                axes.annotate(words, (0.0, total), xytext=at, textcoords="offset points", fontsize=7, color="#707070")
        axes.set_xlim(0, 1.05 * greatest)
        axes.set_ylim(-0.03 * greatest, 1.05 * greatest)
        axes.set_aspect("equal")
        axes.set_xlabel("motion / best known total")
        axes.set_ylabel("w · impact / best known total")
        _legend(figure, axes)

    return svg(draw, "shares", 4.2)


def spread_figure(summary: Summary) -> str:
    """Draw jerk, clearance and duration of every solved run by planner."""
    comparison = summary.comparison
    count = len(comparison.planners)
    what = (
        ("peak jerk [1000 rad/s³]", lambda run: 1e-3 * run.jerk_peak),
        ("rms jerk [1000 rad/s³]", lambda run: 1e-3 * run.jerk_rms),
        ("clearance [cm]", lambda run: 100.0 * run.clearance),
        ("duration [s]", lambda run: run.duration),
    )

    def draw(figure: Figure) -> None:
        panels = figure.subplots(1, len(what), sharey=True)
        for axes, (label, value) in zip(panels, what, strict=True):
            for i, planner in enumerate(comparison.planners):
                values = [value(run) for run in comparison.of(planner=planner) if run.solved]
                _strip(axes, [v for v in values if math.isfinite(v)], i)
            axes.set_xlim(left=0.0)
            axes.set_xlabel(label)
            axes.set_ylim(count - 0.5, -0.5)
        panels[0].set_yticks(range(count), comparison.planners)

    return svg(draw, "spread", 0.9 + 0.3 * count)


def _gap_lines(axes: Axes, summary: Summary, planner: str, index: int, *, band: bool) -> None:
    times = time_grid(summary.comparison)
    lower, middle, upper = gap_curve(summary.comparison, planner, summary.best, times)
    style = look(index)
    axes.plot(times, _drawn(middle), label=planner, **style)
    if band:
        # With an infinite upper quartile, the band extends to the top.
        known = np.isfinite(lower)
        top = np.where(np.isfinite(upper), upper, 10.0 * _GREATEST_GAP)
        axes.fill_between(
            times, np.maximum(lower, _LEAST_GAP), np.maximum(top, _LEAST_GAP), where=known, color=style["color"],
            alpha=0.12, linewidth=0,
        )  # fmt: skip


def _drawn(gaps: Any) -> Any:
    return np.where(np.isfinite(gaps), np.maximum(gaps, _LEAST_GAP), np.nan)


def _gap_axis(axes: Axes) -> None:
    from matplotlib.ticker import NullLocator

    axes.set_yscale("log")
    axes.set_ylim(0.8 * _LEAST_GAP, _GREATEST_GAP)
    ticks = (0.001, 0.01, 0.1, 1.0, 10.0)
    axes.set_yticks(ticks, ["≤ 0.1 %", "1 %", "10 %", "100 %", "1000 %"])
    axes.yaxis.set_minor_locator(NullLocator())
    axes.set_ylabel("gap to best known")
    axes.grid(axis="y", color="#e4e4e4", linewidth=0.6)


def _time_axis(axes: Axes, comparison: Comparison) -> None:
    axes.set_xscale("log")
    times = time_grid(comparison)
    axes.set_xlim(times[0], times[-1])
    _plain_log(axes.xaxis)
    axes.set_xlabel("time since the call [s]")


def _plain_log(axis: Any) -> None:
    """Label a logarithmic axis with numbers, not powers of ten."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(10.0, subs=(1.0, 3.0), numticks=8))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _strip(axes: Axes, values: Sequence[float], index: int) -> None:
    """Draw values as dots, with a bar between the quartiles and a mark at the median."""
    if not values:
        return
    colour = COLOURS[index % len(COLOURS)]
    # More dots would only clutter the figure; the bar uses all values.
    dots = np.sort(values)[:: -(-len(values) // _DOTS)]
    offsets = 0.22 * np.sin(2.4 * np.arange(len(dots)))
    axes.plot(dots, index + offsets, ".", color=colour, alpha=0.45, markersize=3, markeredgewidth=0)
    low, middle, high = np.quantile(values, (0.25, 0.5, 0.75))
    axes.plot([low, high], [index, index], color=colour, linewidth=3, alpha=0.5, solid_capstyle="butt")
    axes.plot(middle, index, "|", color=colour, markersize=11, markeredgewidth=2)


def _legend(figure: Figure, axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right upper", fontsize=8)
