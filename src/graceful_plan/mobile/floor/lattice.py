"""A* on a state lattice over (x, y, heading) whose moves a base can drive.

Moves are curves of bounded curvature that end exactly on states [Pivtoraiko2009]. Expanded states are connected to the
goal by a curve of [ReedsShepp1990] where it is free, as in [Dolgov2010]. The heuristic is inflated in the first search
and less so in later ones (anytime by restarting, [Richter2010]). The collision check is conservative: the discs of the
footprint are checked against a distance field along whole moves. The motion of a disc between checks and its offset
from a cell's centre are subtracted.

[Pivtoraiko2009] M. Pivtoraiko, R. A. Knepper, A. Kelly, "Differentially constrained mobile robot motion planning in
state lattices", J. Field Robotics 26. [Dolgov2010] D. Dolgov, S. Thrun, M. Montemerlo, J. Diebel, "Path planning for
autonomous vehicles in unknown semi-structured environments", IJRR 29. [Richter2010] S. Richter, J. Thayer, W. Ruml,
"The joy of forgetting: faster anytime search via restarting", ICAPS.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Float
from graceful_plan.core import _native
from graceful_plan.exceptions import SettingError, ShapeError
from graceful_plan.mobile.floor.reeds_shepp import Curves, Steering
from graceful_plan.path import finite_array, plain_numbers


class LatticeStatus(Enum):
    """Outcome of a search, with a remedy."""

    SOLVED = "a path was found"
    NO_PATH = "no path leads from start to goal on this lattice: try more headings, finer cells or a smaller margin"
    STOPPED = "the limit of time or expansions was reached before a path was found"
    START_BLOCKED = "the footprint at the start is not free with its margin"
    GOAL_BLOCKED = "the footprint at the goal is not free with its margin"


@dataclass(frozen=True, kw_only=True)
class LatticeSettings:
    """Settings of a lattice and its search.

    Raises:
        SettingError: If a number is out of its range.
    """

    steering: Steering
    headings: int = 72
    """Number of headings, a multiple of 4, at least 8. 72 headings are 5 degrees apart, as in Hybrid-A* of nav2."""
    margin: float = 0.0
    """Clearance of the discs to obstacles [m], >= 0."""
    lead: float = 1.5
    """Weight, >= 1, of an estimated cost to go in an initial search that finds a first path soon. The estimate gives no
    guarantee in advance; `bound` is computed afterwards. 0: no such search."""
    inflations: tuple[float, ...] = ()
    """Weights, >= 1, of a lower bound on the cost to go, one search for each: the path then costs at most this factor
    times
    the best path on the lattice."""
    shots: int = 1
    """Connection attempts to the goal: one every `shots` expansions per radius of remaining distance; 0: none."""
    max_expansions: int = 2_000_000
    time_limit: float = math.inf
    """Time limit [s], > 0; the clock is read every 2048 expansions."""

    def __post_init__(self) -> None:
        plain_numbers(self)
        object.__setattr__(self, "inflations", tuple(self.inflations))
        checks = {
            "headings": (self.headings >= 8 and self.headings % 4 == 0, "a multiple of 4, from 8 on"),
            "margin": (0.0 <= self.margin < math.inf, "a finite number >= 0"),
            "lead": (self.lead == 0.0 or 1.0 <= self.lead < math.inf, "a finite number >= 1, or 0"),
            "inflations": (
                bool(self.lead or self.inflations) and all(1.0 <= one < math.inf for one in self.inflations),
                "finite numbers >= 1, at least one unless `lead` is given",
            ),
            "shots": (self.shots >= 0, ">= 0"),
            "max_expansions": (self.max_expansions > 0, "> 0"),
            "time_limit": (self.time_limit > 0.0, "> 0"),
        }
        for name, (holds, expected) in checks.items():
            if not holds:
                raise SettingError(f"LatticeSettings.{name}", getattr(self, name), expected)


@dataclass(frozen=True, kw_only=True, eq=False)
class LatticePath:
    """Result of a search."""

    status: LatticeStatus
    curve: Curves | None = None
    """Path from start to goal, exactly; None without one. `impact` is integrated over its measure."""
    cost: float = math.inf
    """Cost of the curve [m] + w x impact."""
    impact: float = math.inf
    """Integral of the impact over the measure of the curve [m]."""
    bound: float = math.inf
    """Upper bound on the ratio of the cost to that of the best path on the lattice."""
    first_cost: float = math.inf
    """Cost of the first path found."""
    expansions: int = 0


@dataclass(frozen=True, kw_only=True, eq=False)
class StateLattice:
    """State lattice for one map and one footprint; made once, searched many times.

    Args:
        distance: For each cell, row by row along y, a lower bound on the distance [m] from its centre to the next
            obstacle. The outside of the map is an obstacle.
        resolution: Size of a cell [m].
        discs: Cover of the footprint, (x, y, radius) in the frame of the base [m].
        settings: Settings of the lattice and its search.
        origin: Pose (x, y, yaw) of the lower left corner of cell (0, 0) in the world.
        impact: Impact per metre for each cell and heading k, with yaw 2 pi k / headings on the map, of a base that
            drives forward, >= 0; None: 0.
        impact_back: The same for a base that drives backwards; None: equal to forward.

    Raises:
        ShapeError: If arrays do not fit each other.
        NonFiniteError: If there is a NaN or an infinity in one.
        SettingError: If the resolution or a radius is not > 0, or an impact < 0.
    """

    distance: Float[Array, "row column"]
    resolution: float
    discs: Float[Array, "disc 3"]
    settings: LatticeSettings
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    impact: Float[Array, "row column heading"] | None = None
    impact_back: Float[Array, "row column heading"] | None = None
    native: _native.StateLattice = field(init=False, repr=False)
    """The lattice in the core."""

    def __post_init__(self) -> None:
        distance = np.ascontiguousarray(finite_array("distance", self.distance), dtype=np.float32)
        discs = np.ascontiguousarray(finite_array("discs", self.discs), dtype=float)
        if distance.ndim != 2 or distance.size == 0:
            raise ShapeError("distance", distance.shape, "(rows, columns)")
        if distance.size * self.settings.headings >= 2**32:
            raise ShapeError("distance", distance.shape, "less than 2^32 states")
        if discs.ndim != 2 or discs.shape[1] != 3 or len(discs) == 0:
            raise ShapeError("discs", discs.shape, "(n, 3), at least one")
        if not (self.resolution > 0.0 and math.isfinite(self.resolution)):
            raise SettingError("StateLattice.resolution", self.resolution, "a finite number > 0")
        if not (discs[:, 2] > 0.0).all():
            raise SettingError("StateLattice.discs", float(discs[:, 2].min()), "radii > 0")
        if self.impact is None and self.impact_back is not None:
            raise SettingError("StateLattice.impact", None, "an array, because `impact_back` is given")
        native = _native.StateLattice(
            distance=distance,
            resolution=self.resolution,
            discs=discs,
            headings=self.settings.headings,
            steering=self.settings.steering.native(),
            margin=self.settings.margin,
            impact=self._field("impact"),
            impact_back=self._field("impact_back"),
        )
        object.__setattr__(self, "native", native)

    def path(self, start: ArrayLike, goal: ArrayLike, w: float = 0.0) -> LatticePath:
        """Search a path.

        Args:
            start: Pose (x, y, yaw) in the world [m, m, rad]; need not be on the lattice.
            goal: Goal pose, likewise.
            w: Weight of the impact, >= 0.

        Raises:
            ShapeError: If a pose is not (3,).
            NonFiniteError: If a pose is not finite.
            SettingError: If w is not >= 0.
        """
        ends = {name: finite_array(name, pose) for name, pose in (("start", start), ("goal", goal))}
        for name, pose in ends.items():
            if pose.shape != (3,):
                raise ShapeError(name, pose.shape, "(3,)")
        if not (w >= 0.0 and math.isfinite(w)):
            raise SettingError("w", w, "a finite number >= 0")
        s = self.settings
        found = self.native.search(
            start=self._on_map(ends["start"]),
            goal=self._on_map(ends["goal"]),
            w=w,
            lead=s.lead,
            inflations=list(s.inflations),
            shots=s.shots,
            max_expansions=s.max_expansions,
            time_limit=s.time_limit,
        )
        status = LatticeStatus[found["status"]]
        if status is not LatticeStatus.SOLVED:
            return LatticePath(status=status, expansions=found["expansions"])
        return LatticePath(
            status=status,
            curve=Curves(steering=s.steering, start=ends["start"], pieces=found["pieces"]),
            cost=found["cost"],
            impact=found["impact"],
            bound=found["bound"],
            first_cost=found["first_cost"],
            expansions=found["expansions"],
        )

    def _field(self, name: str) -> Float[Array, "row column heading"] | None:
        given = getattr(self, name)
        if given is None:
            return None
        field = np.ascontiguousarray(finite_array(name, given), dtype=np.float32)
        wanted = (*np.shape(self.distance), self.settings.headings)
        if field.shape != wanted:
            raise ShapeError(name, field.shape, str(wanted))
        if field.min() < 0.0:
            raise SettingError(f"StateLattice.{name}", float(field.min()), ">= 0")
        return field

    def _on_map(self, pose: Array) -> Array:
        x, y, yaw = self.origin
        c, s = math.cos(yaw), math.sin(yaw)
        dx, dy = pose[0] - x, pose[1] - y
        return np.array([c * dx + s * dy, c * dy - s * dx, pose[2] - yaw])
