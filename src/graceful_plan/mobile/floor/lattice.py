"""A lattice over (x, y, heading): moves between states that a base can drive, searched by A*.

Moves are curves of bounded curvature that end on states exactly [Pivtoraiko2009]; states that are expanded are tried to
be joined to the goal by a curve of [ReedsShepp1990], see [Dolgov2010]. The heuristic is first trusted too much, then
less (anytime by restarting, [Richter2010]). Free means free: a footprint of discs is checked against a distance field
along whole moves, with what the disc moves between checks and how far it is off a cell's centre taken off.

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

from graceful_plan.array_types import Float
from graceful_plan.core import _native
from graceful_plan.exceptions import SettingError, ShapeError
from graceful_plan.mobile.floor.reeds_shepp import Curves, Steering
from graceful_plan.path import finite_array

Array = np.ndarray


class LatticeStatus(Enum):
    """How a search ended, and what may help."""

    SOLVED = "a path was found"
    NO_PATH = "no path leads from start to goal on this lattice: more headings, finer cells or a smaller margin may"
    STOPPED = "the limit of time or expansions came before a path"
    START_BLOCKED = "the footprint at the start is not free with its margin"
    GOAL_BLOCKED = "the footprint at the goal is not free with its margin"


@dataclass(frozen=True, kw_only=True)
class LatticeSettings:
    """How a lattice is made and searched.

    Raises:
        SettingError: If a number is out of its range.
    """

    steering: Steering
    headings: int = 72
    """A multiple of 4, from 8 on. 72: every 5 degrees, as Hybrid-A* of nav2 has."""
    margin: float = 0.0
    """What discs keep from obstacles [m], >= 0."""
    lead: float = 1.5
    """Weight, >= 1, of an estimate of what is left to go, for a first path soon: how far it is from the best one is not
    known beforehand, and `bound` says so afterwards. 0: no such search."""
    inflations: tuple[float, ...] = ()
    """Weights of a bound of what is left, one search each, >= 1: the path costs at most so many times the best on the
    lattice."""
    shots: int = 1
    """Curves to the goal, one every `shots` expansions per radius of distance to go; 0: none."""
    max_expansions: int = 2_000_000
    time_limit: float = math.inf
    """[s], > 0; the clock is read every 2048 expansions."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "inflations", tuple(self.inflations))
        checks = {
            "headings": (self.headings >= 8 and self.headings % 4 == 0, "a multiple of 4, from 8 on"),
            "margin": (0.0 <= self.margin < math.inf, "a finite number >= 0"),
            "lead": (self.lead == 0.0 or 1.0 <= self.lead < math.inf, "a finite number >= 1, or 0"),
            "inflations": (
                bool(self.lead or self.inflations) and all(1.0 <= one < math.inf for one in self.inflations),
                "finite numbers >= 1, one at least without a lead",
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
    """What a search found."""

    status: LatticeStatus
    curve: Curves | None = None
    """The path from the start to the goal, exactly; None without one. Its measure is that of `impact` too."""
    cost: float = math.inf
    """Cost of the curve [m] + w x impact."""
    impact: float = math.inf
    """Integral of the impact over the measure of the curve [m]."""
    bound: float = math.inf
    """The cost is at most so many times that of the best path on the lattice."""
    first_cost: float = math.inf
    """Cost of the path that the first search found."""
    expansions: int = 0


@dataclass(frozen=True, kw_only=True, eq=False)
class StateLattice:
    """A lattice on one map for one footprint; made once, searched many times.

    Args:
        distance: For each cell, row by row along y, a distance [m] not above that from its centre to the next obstacle;
            what is off the map is an obstacle.
        resolution: Size of a cell [m].
        discs: Cover of the footprint, (x, y, radius) in the frame of the base [m].
        settings: How it is made and searched.
        origin: Pose (x, y, yaw) of the lower left corner of cell (0, 0) in the world.
        impact: For each cell and heading k, whose yaw on the map is 2 pi k / headings, of a base that drives forward,
            >= 0; None: 0.
        impact_back: Likewise of one that drives backwards; None: the same as forward.

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
    """The same in the core."""

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
            raise SettingError("StateLattice.impact", None, "an array, as `impact_back` is one")
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
            goal: Likewise.
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
