"""Handles for dragging start, goal and one entity."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.viewer.browser.controls import Controls
from graceful_plan.viewer.poses import pose_of, quaternion_of
from graceful_plan.viewer.question import Question

Change = Callable[[Question, Array], Question]
"""Function that returns a request with a changed pose."""
_PAUSE = 0.7
"""Pause after which a typed number counts as complete [s]."""


@final
class Handles:
    """Handles in the scene, and fields with the same positions.

    Args:
        server: viser's server.
        controls: Controls with the fields.
        drives: Whether the robot drives; its base is then moved on the floor.
        ask: Called with the change after a handle is released or a position is typed.
    """

    def __init__(self, server: Any, controls: Controls, drives: bool, ask: Callable[[Change, Array], None]) -> None:
        self._server, self._controls, self._ask = server, controls, ask
        self.start, self.goal = (self._end(name, drives) for name in ("start", "goal"))
        self._thing: Any = None
        self._name = ""
        self._waiting: dict[str, threading.Timer] = {}
        self._dragged(self.start, Question.starting_at)
        self._dragged(self.goal, Question.going_to)

    def typed(self, which: str) -> None:
        """Apply the field of "start" or "goal" after a pause, so that partly typed numbers are ignored."""
        self.close(which)
        self._waiting[which] = timer = threading.Timer(_PAUSE, self._read, (which,))
        timer.daemon = True
        timer.start()

    def close(self, *names: str) -> None:
        """Discard pending typed input, for some fields or for all."""
        for which in names or tuple(self._waiting):
            if which in self._waiting:
                self._waiting.pop(which).cancel()

    def _read(self, which: str) -> None:
        self._waiting.pop(which, None)
        field, handle = getattr(self._controls, which), getattr(self, which)
        change = Question.starting_at if which == "start" else Question.going_to
        self._ask(change, pose_of(np.asarray(field.value), np.asarray(handle.wxyz)))

    def place(self, question: Question, visible: bool) -> None:
        """Set handles and fields to start and goal of a request, except for fields with pending input."""
        for which, X in (("start", question.handle_pose(question.start)), ("goal", question.goal_pose())):
            handle, field = getattr(self, which), getattr(self._controls, which)
            handle.position, handle.wxyz = X[:3, 3], quaternion_of(X[:3, :3])
            if which not in self._waiting:
                field.value = tuple(round(x, 4) for x in X[:3, 3].tolist())
        self.show(visible)

    def show(self, visible: bool) -> None:
        """Show or hide the handles of start and goal."""
        for handle in (self.start, self.goal):
            handle.visible = visible

    def offer(self, name: str, X_WB: Float[Array, "4 4"] | None) -> None:
        """Show a handle for an entity at a pose; hide it for None."""
        if X_WB is None:
            if self._thing is not None:
                self._thing.visible = False
            return
        if self._thing is None:
            self._thing = self._server.scene.add_transform_controls(
                "/entity", scale=0.2, line_width=3.0, depth_test=False
            )
            self._dragged(self._thing, lambda question, pose: question.with_moved(self._name, pose))
        self._name = name
        self._thing.position, self._thing.wxyz = X_WB[:3, 3], quaternion_of(X_WB[:3, :3])
        self._thing.visible = True

    def _end(self, name: str, drives: bool) -> Any:
        return self._server.scene.add_transform_controls(
            f"/{name}",
            scale=0.6 if drives else 0.13,
            line_width=3.0,
            active_axes=(True, True, not drives),
            depth_test=False,
        )

    def _dragged(self, handle: Any, change: Change) -> None:
        def react(event: Any) -> None:
            if event.phase == "end":
                self._ask(change, pose_of(np.asarray(handle.position), np.asarray(handle.wxyz)))

        handle.on_update(react)
