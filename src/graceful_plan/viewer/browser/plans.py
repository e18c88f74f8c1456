"""Motions in the scene: all paths, and the robots of the other motions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.viewer.browser import marks
from graceful_plan.viewer.browser.cameras import Cameras
from graceful_plan.viewer.browser.controls import BESIDE, GHOST, HIDDEN
from graceful_plan.viewer.browser.drawn_scene import DrawnScene
from graceful_plan.viewer.shown import ShownMotion

_GHOST = 0.3
"""Opacity of a ghost."""
_CHOSEN, _OTHER = 0.012, 0.006
"""Thickness of the paths [m]."""


@final
class DrawnPlans:
    """Drawn paths and robots of motions.

    Args:
        server: viser's server.
        cameras: Cameras of the page.
    """

    def __init__(self, server: Any, cameras: Cameras) -> None:
        self._server, self._cameras = server, cameras
        self._nodes: list[Any] = []
        self._others: list[DrawnScene] = []

    def draw(self, motion: ShownMotion | None, others: Sequence[ShownMotion], how: str) -> None:
        """Redraw all motions, the others in the display mode `how`."""
        for node in (*self._nodes, *self._others):
            node.remove()
        self._nodes, self._others = [], []
        if motion is None:
            return
        shown = () if how == HIDDEN else tuple(others)
        shift = self._cameras.beside(motion.scene) if how == BESIDE else np.zeros(3)
        self._cameras.take_in(len(shown) * shift)
        greatest = marks.greatest_risk((motion, *others))
        self._nodes.append(marks.add_path(self._server, "/path", motion, greatest, thickness=_CHOSEN))
        for k, other in enumerate(shown):
            root, ghost = f"/others/{k}", how == GHOST
            opacity = _GHOST if ghost else 1.0
            at = (k + 1) * shift
            drawn = DrawnScene(self._server, root, other.scene, opacity=opacity, shift=at, only_moving=ghost)
            path = marks.add_path(self._server, f"{root}/path", other, greatest, thickness=_OTHER)
            middle = other.tool[len(other.tool) // 2]
            self._others.append(drawn)
            self._nodes += [path, self._server.scene.add_label(f"{root}/label", other.label, position=middle)]

    def put(self, places: Sequence[tuple[Float[Array, "part 3"], Float[Array, "part 4"]]]) -> None:
        """Move the robots of the other motions, if drawn, to positions and quaternions of their parts."""
        for other, place in zip(self._others, places, strict=False):
            other.put(*place)
