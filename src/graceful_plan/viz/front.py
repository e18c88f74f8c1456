"""Picture of a Pareto front on linear and logarithmic axes, with knee, weights and chosen point."""

from __future__ import annotations

from pathlib import Path as FilePath
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.exceptions import SettingError
from graceful_plan.tuning.pareto_front import Choice, ParetoFront
from graceful_plan.tuning.points import ParetoPoint
from graceful_plan.viz.style import HALO, PATH_COLOURS, STYLE

_LINE, _CHOSEN, _KNEE = PATH_COLOURS[1], PATH_COLOURS[3], PATH_COLOURS[2]
_LABELS = 6
"""Maximum number of points labelled with their weight."""


def draw_front(
    front: ParetoFront, file: str | FilePath, choice: Choice | None = None, reference: ArrayLike | None = None
) -> None:
    """Draw motion against impact.

    Args:
        front: Front with at least one point.
        file: Picture to write; its extension selects the format (png, pdf, svg).
        choice: Chosen point to mark.
        reference: Reference point of the hypervolume in the title; that of the front by default.

    Raises:
        SettingError: If the front is empty.
    """
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    if not len(front):
        raise SettingError("front", front.status.name, "a front with at least one point")
    with rc_context(STYLE):
        figure = Figure(figsize=(9.0, 3.9), dpi=150, layout="constrained")
        FigureCanvasAgg(figure)
        plain, logarithmic = figure.subplots(1, 2)
        for axes in (plain, logarithmic):
            _draw(axes, front, choice)
        plain.set_ylim(0.0, None)
        plain.set_title(f"{len(front)} motions, hypervolume {front.hypervolume(reference):.3f}; numbers: weight w")
        plain.legend(loc="upper right")
        if front.costs[-1, 1] > 0.0:
            logarithmic.set_yscale("log")
        logarithmic.set_title("Logarithmic impact axis")
        figure.savefig(file)


def _draw(axes: Any, front: ParetoFront, choice: Choice | None) -> None:
    motion, impact = front.costs.T
    axes.step(motion, impact, where="post", color=_LINE, linewidth=1.0, alpha=0.5)
    by_weight = np.array([point.weights is not None for point in front.points])
    axes.plot(motion[by_weight], impact[by_weight], "o", color=_LINE, markersize=5, label="best for a weight")
    axes.plot(
        *front.costs[~by_weight].T, "o", color=_LINE, markerfacecolor="white", markersize=5, label="best for none"
    )
    marks: list[tuple[str, ParetoPoint | None, str, str]] = [("knee", front.knee, "D", _KNEE)]
    if choice is not None and choice.point is not None:
        marks.append(("chosen" if choice.w is None else f"chosen, w = {choice.w:.3g}", choice.point, "s", _CHOSEN))
    for label, point, marker, colour in marks:
        if point is not None:
            axes.plot(
                point.motion,
                point.impact,
                marker,
                color=colour,
                markersize=11,
                markerfacecolor="none",
                markeredgewidth=1.6,
                linestyle="none",
                label=label,
            )
    _label_weights(axes, [point for point in front.points if point.weights is not None])
    axes.set(xlabel="motion V [rad]", ylabel="impact S")


def _label_weights(axes: Any, points: list[ParetoPoint]) -> None:
    for i in sorted(set(np.linspace(0, len(points) - 1, min(_LABELS, len(points))).astype(int).tolist())):
        weights = points[i].weights
        if weights is not None:
            axes.annotate(
                f"{weights[0]:.2g}",
                (points[i].motion, points[i].impact),
                xytext=(5, 4),
                textcoords="offset points",
                fontsize=7,
                bbox=HALO,
            )
