"""Stops along a motion, planned ahead for a grid of times, because planning one takes longer than a robot may wait."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable

import numpy as np

from graceful_plan.constraints.constraint import Constraint
from graceful_plan.exceptions import SettingError
from graceful_plan.path import is_real
from graceful_plan.query.stop import plan_stop
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import Trajectory


class PreparedStops:
    """The quickest verified stops along a motion, for a grid of times.

    Args:
        trajectory: The motion.
        scene: Robot, surroundings and carried object.
        every: Time between the beginnings of two stops [s]: a robot goes on for up to this time before it stops.
        constraints: Constraints along the stops, as for `plan_stop`.

    Raises:
        SettingError: If `every` is not a finite time > 0, or as for `plan_stop`.
    """

    def __init__(
        self,
        trajectory: Trajectory,
        scene: Scene,
        *,
        every: float = 0.1,
        constraints: Iterable[Constraint] | None = None,
    ) -> None:
        if not isinstance(trajectory, Trajectory):
            raise SettingError("trajectory", trajectory, "a Trajectory")
        if not is_real(every) or not 0.0 < every < np.inf:
            raise SettingError("every", every, "a finite time > 0 s")
        kept = None if constraints is None else tuple(constraints)
        times = np.arange(float(trajectory.t[0]), float(trajectory.t[-1]), every)
        planned = [plan_stop(trajectory, scene, at=float(t), constraints=kept).trajectory for t in times]
        self._trajectory = trajectory
        self.stops: tuple[Trajectory, ...] = tuple(stop for stop in planned if stop is not None)
        """The stops, the earliest first; each begins on the clock of the motion."""
        self._begins = [float(stop.t[0]) for stop in self.stops]

    def after(self, t: float) -> Trajectory:
        """Return the next stop that begins at a time or later [s]; after the last one, the rest of the motion."""
        place = bisect_left(self._begins, t - 1e-9)
        return self.stops[place] if place < len(self.stops) else self._trajectory
