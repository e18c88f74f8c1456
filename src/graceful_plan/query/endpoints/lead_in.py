"""Velocity and lead-in of a moving start, the motion that it takes over from, and the run-in of a moving goal."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.path import Path
from graceful_plan.query.endpoints.endpoints import Endpoints
from graceful_plan.timing.trajectory import State, Trajectory


@final
class Takeover(State):
    """The state of a robot that leaves another motion.

    Args:
        state: Position and velocity.
        before: The motion up to there, which ends at time 0; liquids swing by it.
        stop: Computes a stop along that motion, from time 0 on; None if there is none.
        onward: The rest of that motion's path, from which descents may start; None for none.
    """

    before: Trajectory
    stop: Callable[[], Trajectory | None]
    onward: Path | None

    def __new__(
        cls, state: State, before: Trajectory, stop: Callable[[], Trajectory | None], onward: Path | None = None
    ) -> Takeover:
        """Keep the motion with the state, which is an immutable tuple."""
        self = super().__new__(cls, *state)
        self.before, self.stop, self.onward = before, stop, onward
        return self

    def without_turns(self, turns: Float[Array, " nq"]) -> Takeover:
        """Return the same start with whole turns of the joints subtracted everywhere [rad]."""
        if not turns.any():
            return self
        return Takeover(
            State(self.q - turns, self.qd, self.qdd),
            before=_less(self.before, turns),
            stop=lambda: None if (stop := self.stop()) is None else _less(stop, turns),
            onward=None if self.onward is None else Path(self.onward.q - turns),
        )


def _less(motion: Trajectory, turns: Float[Array, " nq"]) -> Trajectory:
    return Trajectory(motion.t, motion.q - turns, motion.qd, motion.qdd, motion.joints)


@final
@dataclass(frozen=True, eq=False)
class LeadIn:
    """A moving start.

    | field    | meaning                                                     | unit  | shape |
    |----------|-------------------------------------------------------------|-------|-------|
    | velocity | velocity at the start                                       | rad/s | nq    |
    | path     | path along it, in which the robot is able to stop           | rad   | n nq  |
    | is_clear | whether the fast checker finds that path free               |       |       |
    | stop     | a verified stop along it, from time 0 on                    |       |       |
    """

    velocity: Float[Array, " nq"]
    path: Path
    is_clear: bool
    stop: Trajectory

    def leading_to(self, ends: Endpoints) -> Endpoints:
        """Return the endpoints of a search from the end of the lead-in, with the lead-in before the departure."""
        departure = Path(np.vstack([self.path.q[:-1], ends.departure.q]))
        return replace(ends, departure=departure, clear_lead=self.is_clear and len(ends.departure) == 1)


@final
@dataclass(frozen=True, eq=False)
class RunIn:
    """A moving goal.

    | field    | meaning                                                       | unit  | shape |
    |----------|---------------------------------------------------------------|-------|-------|
    | velocity | velocity at the goal                                          | rad/s | nq    |
    | path     | path to it, in which the robot can reach the velocity         | rad   | n nq  |
    | is_clear | whether the fast checker finds that path free                 |       |       |
    | motion   | verified motion along it, from rest at time 0                 |       |       |
    | note     | why the robot cannot stop beyond the goal; empty if it can    |       |       |
    """

    velocity: Float[Array, " nq"]
    path: Path
    is_clear: bool
    motion: Trajectory
    note: str = ""

    def ending(self, ends: Endpoints) -> Endpoints:
        """Return the endpoints of a search to the beginning of the run-in, with the run-in after the arrival."""
        (arrival,) = ends.arrivals
        arrivals = (Path(np.vstack([arrival.q, self.path.q[1:]])),)
        notes = (*ends.notes, *([self.note] if self.note else []))
        return replace(ends, arrivals=arrivals, clear_run_in=self.is_clear and len(arrival) == 1, notes=notes)
