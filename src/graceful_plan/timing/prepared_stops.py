"""Stops along a motion that are ready when a robot has to stop."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from graceful_plan.timing.trajectory import Trajectory

_ROUNDING = 1e-9
"""Rounding error of times [s]."""


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class PreparedStops:
    """Verified stops along a motion, see `plan_stops`: planning one takes longer than a robot may wait.

    | field  | meaning                                                                          | unit |
    |--------|----------------------------------------------------------------------------------|------|
    | motion | the motion                                                                       |      |
    | every  | time between the moments at which stops were looked for                          | s    |
    | stops  | the stop found at each moment, on the clock of the motion; None if there is none |      |
    | gaps   | first and last moment of each stretch of moments that lack a stop                | s    |
    """

    motion: Trajectory
    every: float
    stops: tuple[Trajectory | None, ...]
    gaps: tuple[tuple[float, float], ...] = ()

    def after(self, t: float) -> Trajectory:
        """Return the stop with the earliest end among those that begin at a time or later [s].

        The robot follows the motion until that stop begins. Without such a stop, it is the motion itself.
        """
        later = [stop for stop in self.stops if stop is not None and stop.t[0] >= t - _ROUNDING]
        return min(later, key=lambda stop: float(stop.t[-1]), default=self.motion)
