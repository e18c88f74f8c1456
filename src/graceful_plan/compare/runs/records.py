"""Record of a run, and its JSON format."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Float
from graceful_plan.documents import finite
from graceful_plan.exceptions import FormatError
from graceful_plan.path import finite_array
from graceful_plan.result import TracePoint
from graceful_plan.timing.trajectory import Trajectory

SOLVED = "SOLVED"
EARLY = (0.01, 0.1)
"""Times at which the path of a running call is recorded [s]."""
_LATER = frozenset(
    {"self_clearance", "certified", "times", "velocities", "motion_wall", "motion_cpu", "early", "path_cost"}
)
"""Fields missing in the first version of the format."""
RAISED, CRASHED, HUNG = "RAISED", "CRASHED", "HUNG"
"""Outcomes in addition to `PlanStatus`: an exception, a crashed process, and a process that did not end."""


@dataclass(frozen=True, kw_only=True)
class Run:
    """One run of a planner on a problem; by default with infinite cost and without measurements.

    | field      | meaning                                                                                          |
    |------------|--------------------------------------------------------------------------------------------------|
    | problem    | name of the problem                                                                              |
    | planner    | label of the planner                                                                             |
    | seed       | seed of the random numbers                                                                       |
    | status     | name of a `PlanStatus`; RAISED, CRASHED or HUNG if it did not end with one                       |
    | detail     | explanation of the status                                                                        |
    | seconds    | time of the whole call, until the verified result [s]                                            |
    | first      | time until the first path [s]; infinite if the call was not solved in the end                    |
    | motion_wall | time of a call that ends with its first path, until its verified motion [s]; none: infinite     |
    | motion_cpu | processor time of that call, of all threads [s]                                                  |
    | total      | least total cost J reached, of the verified result                                               |
    | motion     | its motion cost                                                                                  |
    | impact     | its impact                                                                                       |
    | jerk_peak  | greatest joint jerk of the timed trajectory [rad/s^3], see `measures.jerk`                       |
    | jerk_rms   | root of the mean square over time [rad/s^3]                                                      |
    | duration   | duration of the timed trajectory [s]                                                             |
    | length     | joint-space length of the motion [rad]                                                           |
    | clearance  | least exact distance of robot and carried object to the surroundings [m], see `measures`         |
    | self_clearance | least exact self-clearance of robot and carried object [m]                                   |
    | certified  | clearance proven between samples, including self-collision [m]; see `Certificate`                |
    | iterations | iterations of the planner                                                                        |
    | path_cost  | total of the planner's own best path, as its search estimates it                                 |
    | early      | motion cost of the best path, as estimated by the search, at the times `EARLY`; infinite: none  |
    | trace      | improvements: time [s], total, motion, impact; paths by search estimate, the result last         |
    | path       | configurations of the result; samples of a motion                                                |
    | times      | times of the samples [s]; none for analytic problems, which are not timed                        |
    | velocities | joint velocities at the samples [rad/s or m/s]                                                   |
    """

    problem: str
    planner: str
    seed: int
    status: str
    detail: str = ""
    seconds: float = math.nan
    first: float = math.inf
    motion_wall: float = math.nan
    motion_cpu: float = math.nan
    total: float = math.inf
    motion: float = math.inf
    impact: float = math.inf
    jerk_peak: float = math.nan
    jerk_rms: float = math.nan
    duration: float = math.nan
    length: float = math.nan
    clearance: float = math.nan
    self_clearance: float = math.nan
    certified: float = math.nan
    iterations: float = math.nan
    path_cost: float = math.nan
    early: tuple[float, ...] = ()
    trace: tuple[TracePoint, ...] = ()
    path: tuple[tuple[float, ...], ...] = ()
    times: tuple[float, ...] = ()
    velocities: tuple[tuple[float, ...], ...] = ()

    @property
    def solved(self) -> bool:
        """Whether a verified result was returned."""
        return self.status == SOLVED

    @property
    def key(self) -> tuple[str, str, int]:
        """Unique key of the run."""
        return self.problem, self.planner, self.seed

    def trajectory(self, joints: tuple[str, ...]) -> Trajectory | None:
        """Return the motion as a trajectory of the joints, None if it is not timed.

        Raises:
            GracefulPlanError: If it is not a motion of these joints.
        """
        return cubics(self.times, self.path, self.velocities, joints) if self.times else None

    def totals_at(self, seconds: ArrayLike | float) -> Float[Array, "*time"]:
        """Return the total cost of the best path at times; infinite without a path or a verified result."""
        trace = self.trace if self.solved else ()
        times = np.array([point.time for point in trace])
        totals = np.minimum.accumulate([math.inf, *(point.total for point in trace)])
        return np.asarray(totals[np.searchsorted(times, seconds, side="right")])

    def to_json(self) -> str:
        """Return one line of strict JSON; non-finite numbers become null."""
        document = asdict(self)
        document["trace"] = [[p.time, p.total, p.motion, p.impact] for p in self.trace]
        return json.dumps(finite(document), allow_nan=False, separators=(",", ":"))

    @classmethod
    def from_document(cls, document: Any, source: str, *, complete: bool = True) -> Run:
        """Read a run written by `to_json`.

        Args:
            document: JSON values.
            source: Name of the source in messages.
            complete: Whether all fields must be present; else those of later versions may be missing.

        Raises:
            FormatError: If the document is not a run.
        """
        defaults = {item.name: item.default for item in fields(cls)}
        if isinstance(document, Mapping) and not complete:
            document = {**{key: defaults[key] for key in _LATER}, **document}
        if not isinstance(document, Mapping) or document.keys() != defaults.keys():
            raise FormatError(source, f"not a run with the keys {', '.join(defaults)}")
        given: dict[str, Any] = {key: defaults[key] if value is None else value for key, value in document.items()}
        try:
            given["trace"] = tuple(
                TracePoint(time=t, total=total, motion=motion, impact=impact)
                for t, total, motion, impact in document["trace"]
            )
            given |= {key: tuple(tuple(float(x) for x in q) for q in document[key]) for key in ("path", "velocities")}
            given["early"] = tuple(math.inf if x is None else float(x) for x in document["early"])
            given["times"] = tuple(float(t) for t in document["times"])
            given |= {key: float(given[key]) for key, default in defaults.items() if isinstance(default, float)}
            texts = all(isinstance(given[key], str) for key in ("problem", "planner", "status", "detail"))
            if not (texts and type(given["seed"]) is int):
                raise TypeError("names have to be text, and the seed a whole number")
        except (TypeError, ValueError, OverflowError) as error:
            raise FormatError(source, f"not a run: {error}") from None
        return cls(**given)


def cubics(
    times: Sequence[float],
    path: Sequence[Sequence[float]],
    velocities: Sequence[Sequence[float]],
    joints: tuple[str, ...],
) -> Trajectory:
    """Return the trajectory of cubics through the positions and velocities of samples.

    Args:
        times: Times of the samples [s].
        path: Positions [rad or m].
        velocities: Velocities [rad/s or m/s].
        joints: Names of the joints.

    Raises:
        GracefulPlanError: If the samples are not a motion of these joints.
    """
    q, qd = (
        finite_array(name, [list(row) for row in rows], ndim=2, last=len(joints))
        for name, rows in (("path", path), ("velocities", velocities))
    )
    motion = Trajectory(finite_array("times", list(times), ndim=1), q, qd, np.zeros_like(q), joints)
    if len(motion) == 1:
        return motion
    begin, end = motion.piece_accelerations
    return replace(motion, qdd=np.concatenate([begin, end[-1:]]))
