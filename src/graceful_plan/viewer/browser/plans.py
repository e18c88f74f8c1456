"""Both motions in the scene: their paths, and the robot of the ordinary one."""

from __future__ import annotations

from typing import Any, final

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.viewer.browser import marks
from graceful_plan.viewer.browser.cameras import Cameras
from graceful_plan.viewer.browser.controls import BESIDE, GHOST, HIDDEN
from graceful_plan.viewer.browser.drawn_scene import DrawnScene
from graceful_plan.viewer.question import PlanAnswer

Array = np.ndarray

_GHOST = 0.3
"""Opacity of a ghost."""
_CHOSEN, _ORDINARY = 0.012, 0.006
"""Thickness of the paths [m]."""


@final
class DrawnPlans:
    """What is drawn of an answer, besides the scene.

    Args:
        server: viser's server.
        cameras: Those that look at it.
    """

    def __init__(self, server: Any, cameras: Cameras) -> None:
        self._server, self._cameras = server, cameras
        self._nodes: list[Any] = []
        self._other: DrawnScene | None = None

    def draw(self, answer: PlanAnswer | None, how: str) -> None:
        """Draw an answer from scratch, the ordinary motion `how` it is to be shown."""
        for node in self._nodes:
            node.remove()
        self._nodes = []
        if self._other is not None:
            self._other.remove()
            self._other = None
        if answer is None:
            return
        shift = self._cameras.beside(answer.question.scene) if how == BESIDE else np.zeros(3)
        self._cameras.take_in(shift)
        greatest = marks.greatest_risk(answer.motions)
        if answer.chosen is not None:
            self._nodes.append(marks.add_path(self._server, "/path", answer.chosen, greatest, thickness=_CHOSEN))
        if answer.ordinary is not None and how != HIDDEN and answer.chosen is not None:
            ghost, scene = how == GHOST, answer.ordinary.scene
            opacity = _GHOST if ghost else 1.0
            self._other = DrawnScene(self._server, "/other", scene, opacity=opacity, shift=shift, only_moving=ghost)
            path = marks.add_path(self._server, "/other/path", answer.ordinary, greatest, thickness=_ORDINARY)
            middle = answer.ordinary.tool[len(answer.ordinary.tool) // 2]
            self._nodes += [path, self._server.scene.add_label("/other/label", answer.ordinary.label, position=middle)]

    def put(self, position: Float[Array, "part 3"], turned: Float[Array, "part 4"]) -> None:
        """Move the robot of the ordinary motion, if it is drawn."""
        if self._other is not None:
            self._other.put(position, turned)
