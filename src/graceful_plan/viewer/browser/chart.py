"""Chart of the impact by entity over time, with a line at the present moment."""

from __future__ import annotations

from typing import Any, final

import numpy as np

from graceful_plan.array_types import Array
from graceful_plan.viewer.shown import ShownMotion
from graceful_plan.viz.style import ENTITY_COLOURS, OTHERS_COLOUR

_ENTITIES = 4
_SERIES = _ENTITIES + 3
"""Number of series: time, most endangered entities, all others, and the line of the present moment."""
_NOW = 1e-6
"""Width of the line of the present moment [s]."""
_UNUSED = {"label": "", "width": 0, "points": {"show": False}}


@final
class ImpactChart:
    """Chart on the page, which exists as long as the page and is reused for all motions.

    A browser applies updates of panel elements after all other messages of the same time. Updating an element and then
    removing it is therefore an error, so this chart is never removed. The number of series is constant, because a
    browser may draw between the updates of data and labels.

    Args:
        server: viser's server; the chart is added at the present place of the panel, hidden until there is a motion.
    """

    def __init__(self, server: Any) -> None:
        self._server = server
        self._motion: ShownMotion | None = None
        self._values: list[Array] = []
        self._top = 1.0
        nothing = np.zeros(2)
        self._handle = server.gui.add_uplot(
            (np.arange(2.0), *[nothing] * (_SERIES - 1)),
            ({"label": "t [s]"}, *[_UNUSED] * (_SERIES - 1)),
            height=190,
            scales=self._scales(),
            axes=({"label": "time [s]", "labelSize": 18, "size": 34}, {"size": 46}),
            legend={"show": True, "live": False},
            visible=False,
        )

    def draw(self, motion: ShownMotion | None) -> None:
        """Draw another motion; hide the chart for None."""
        self._motion = motion
        if motion is None:
            self._handle.visible = False
            return
        names = motion.worst(_ENTITIES)
        index = [motion.entities.index(name) for name in names]
        others = motion.risk - motion.by_entity[:, index].sum(axis=1)
        self._values = [*motion.by_entity[:, index].T, np.maximum(others, 0.0)]
        self._top = max(1e-3, 1.05 * float(max(values.max(initial=0.0) for values in self._values)))
        colours = zip([*names, "all others"], [*ENTITY_COLOURS[: len(names)], OTHERS_COLOUR], strict=True)
        series: list[Any] = [{"label": "t [s]"}]
        series += [{"label": label, "stroke": colour, "width": 2} for label, colour in colours]
        series.append({"label": "now", "stroke": "#d62728", "width": 1})
        with self._server.atomic():
            self._handle.series = (*series, *[_UNUSED] * (_SERIES - len(series)))
            self._handle.scales = self._scales()
            self.show(0.0)
            self._handle.visible = True

    def show(self, t: float) -> None:
        """Move the line to a time [s], if there is a motion."""
        if self._motion is None:
            return
        here = min(max(t, 0.0), self._motion.duration)
        x = np.union1d(self._motion.risk_t, [here, here + _NOW])
        now = np.full(len(x), np.nan)
        at = int(np.searchsorted(x, here))
        now[at], now[at + 1] = 0.0, self._top
        shown = [x, *(np.interp(x, self._motion.risk_t, values) for values in self._values), now]
        self._handle.data = (*shown, *[np.full(len(x), np.nan)] * (_SERIES - len(shown)))

    def _scales(self) -> dict[str, Any]:
        return {"x": {"time": False}, "y": {"range": (0.0, self._top)}}
