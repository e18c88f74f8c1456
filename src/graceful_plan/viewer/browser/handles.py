"""What is dragged: start, goal, and one thing of the scene."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, final

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.viewer.browser.controls import Controls
from graceful_plan.viewer.poses import pose_of, quaternion_of
from graceful_plan.viewer.question import Question

Array = np.ndarray

Change = Callable[[Question, Array], Question]
"""Returns a question with something at another pose."""
_PAUSE = 0.7
"""Who has typed nothing more for so long has typed all of a number [s]."""


@final
class Handles:
    """Handles in the scene, and the fields with the same places.

    Args:
        server: viser's server.
        controls: With the fields.
        drives: Whether the robot does: its base is moved on the floor.
        ask: Called with what is to change when somebody lets go of a handle or has typed a place.
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
        """Ask for the place in the field of "start" or "goal" once nothing more is typed: half of a number is none."""
        self.close(which)
        self._waiting[which] = timer = threading.Timer(_PAUSE, self._read, (which,))
        timer.daemon = True
        timer.start()

    def close(self, *names: str) -> None:
        """Ask for nothing any more that was typed, for the names or at all."""
        for which in names or tuple(self._waiting):
            if which in self._waiting:
                self._waiting.pop(which).cancel()

    def _read(self, which: str) -> None:
        self._waiting.pop(which, None)
        field, handle = getattr(self._controls, which), getattr(self, which)
        change = Question.starting_at if which == "start" else Question.going_to
        self._ask(change, pose_of(np.asarray(field.value), np.asarray(handle.wxyz)))

    def place(self, question: Question, visible: bool) -> None:
        """Put handles where start and goal of a question are, and their fields, unless somebody types there."""
        for which, X in (("start", question.handle_pose(question.start)), ("goal", question.goal_pose())):
            handle, field = getattr(self, which), getattr(self._controls, which)
            handle.position, handle.wxyz = X[:3, 3], quaternion_of(X[:3, :3])
            if which not in self._waiting:
                field.value = tuple(round(x, 4) for x in X[:3, 3].tolist())
        self.show(visible)

    def show(self, visible: bool) -> None:
        """Show those of start and goal, or do not."""
        for handle in (self.start, self.goal):
            handle.visible = visible

    def offer(self, name: str, X_WB: Float[Array, "4 4"] | None) -> None:
        """Show a handle for a thing that is at a pose, or none any more."""
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
