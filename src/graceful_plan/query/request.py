"""What was asked of `plan`."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import final

from graceful_plan.constraints.scene_constraints import SceneConstraints
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.planners import Planner
from graceful_plan.query.prefer import Preference
from graceful_plan.query.search import Callback
from graceful_plan.scene.pose_goal import PoseGoal


_FIRST_GUESS = 0.005
"""Of how long a part takes [s]: to time a motion and to charge it takes 3 to 10 ms on the bundled tasks."""


@final
class Stopwatch:
    """How long a part of the call takes each time: what has to be kept for it follows from this very call."""

    def __init__(self) -> None:
        self.seconds = _FIRST_GUESS
        """The longest so far [s]."""

    @contextmanager
    def running(self) -> Iterator[None]:
        """Measure what happens within."""
        before = time.perf_counter()
        try:
            yield
        finally:
            self.seconds = max(self.seconds, time.perf_counter() - before)


@dataclass(frozen=True, kw_only=True, eq=False)
class Request:
    """What was asked for, all of it checked.

    | field      | meaning                                                               | unit |
    |------------|-----------------------------------------------------------------------|------|
    | planner    | what searches                                                         |      |
    | objective  | what to minimise, in which scene                                      |      |
    | constraints| what has to hold on the way                                           |      |
    | preference | what decides between paths instead, if the mean impact does not       |      |
    | pose       | the pose to be reached, if that is the goal                           |      |
    | speed      | fraction of the velocity limits to use                                |      |
    | max_wait   | longest wait at the start, if something moves                         | s    |
    | callback   | told of every improvement                                             |      |
    | timing     | how long it takes to time a motion and to charge it                   |      |
    """

    planner: Planner
    objective: SceneObjective
    constraints: SceneConstraints
    preference: Preference | None = None
    pose: PoseGoal | None = None
    speed: float = 1.0
    max_wait: float = 0.0
    callback: Callback | None = None
    timing: Stopwatch = field(default_factory=Stopwatch)
