"""The chart of the impact by entity over time, with a line where the moment is that is shown."""

from __future__ import annotations

from typing import Any, final

import numpy as np

from graceful_plan.viewer.shown import ShownMotion
from graceful_plan.viz.style import ENTITY_COLOURS, OTHERS_COLOUR

Array = np.ndarray

_ENTITIES = 4
_NOW = 1e-6
"""Width of the line that says when [s]."""


@final
class ImpactChart:
    """A chart on the page.

    Args:
        server: viser's server; the chart is put where the panel is at.
        motion: What it is of.
    """

    def __init__(self, server: Any, motion: ShownMotion) -> None:
        self._motion = motion
        self._names = motion.worst(_ENTITIES)
        index = [motion.entities.index(name) for name in self._names]
        others = motion.risk - motion.by_entity[:, index].sum(axis=1)
        self._values = [*motion.by_entity[:, index].T, np.maximum(others, 0.0)]
        self._top = max(1e-3, 1.05 * float(max(values.max(initial=0.0) for values in self._values)))
        labels = [*self._names, "all others"]
        colours = [*ENTITY_COLOURS[: len(self._names)], OTHERS_COLOUR]
        series: list[Any] = [{"label": "t [s]"}]
        series += [
            {"label": label, "stroke": colour, "width": 2} for label, colour in zip(labels, colours, strict=True)
        ]
        series.append({"label": "now", "stroke": "#d62728", "width": 1})
        self.handle = server.gui.add_uplot(
            self._data(0.0),
            tuple(series),
            height=190,
            scales={"x": {"time": False}, "y": {"range": (0.0, self._top)}},
            axes=({"label": "time [s]", "labelSize": 18, "size": 34}, {"size": 46}),
            legend={"show": True, "live": False},
        )

    def show(self, t: float) -> None:
        """Move the line to a time [s]."""
        self.handle.data = self._data(t)

    def _data(self, t: float) -> tuple[Array, ...]:
        here = min(max(t, 0.0), self._motion.duration)
        x = np.union1d(self._motion.risk_t, [here, here + _NOW])
        now = np.full(len(x), np.nan)
        at = int(np.searchsorted(x, here))
        now[at], now[at + 1] = 0.0, self._top
        return (x, *(np.interp(x, self._motion.risk_t, values) for values in self._values), now)
