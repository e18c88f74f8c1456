"""Stops along an executed motion, planned at the first fault that follows them."""

from __future__ import annotations

from threading import Lock

from graceful_plan import PreparedStops, Scene, Trajectory, plan_stops


class StopsAhead:
    """Stops planned ahead, once for each time between two of them. Simulation threads share it.

    Args:
        motion: The executed motion.
        scene: Its scene.
    """

    def __init__(self, motion: Trajectory, scene: Scene) -> None:
        self._motion, self._scene, self._lock = motion, scene, Lock()
        self._planned: dict[float, PreparedStops] = {}

    def every(self, seconds: float) -> PreparedStops:
        """Return the stops with a time between their beginnings [s]."""
        with self._lock:
            if seconds not in self._planned:
                self._planned[seconds] = plan_stops(self._motion, self._scene, every=seconds)
            return self._planned[seconds]
