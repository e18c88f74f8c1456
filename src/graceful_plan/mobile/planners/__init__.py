"""Planners for a base that rolls along its heading and turns in place. `DRIVING` lists them by name."""

from graceful_plan.mobile.planners.drive_lattice import DriveLattice
from graceful_plan.mobile.planners.floor_in_time import FloorInTime
from graceful_plan.mobile.planners.floor_theta_star import FloorThetaStar
from graceful_plan.mobile.planners.reeds_shepp import PoseSpace, ReedsSheppPRM, ReedsSheppRRT, ReedsSheppRRTStar
from graceful_plan.planners.planner import Planner

DRIVING: dict[str, type[Planner]] = {
    planner.name: planner
    for planner in (DriveLattice, FloorInTime, FloorThetaStar, ReedsSheppPRM, ReedsSheppRRT, ReedsSheppRRTStar)
}
"""All planners for bases, by the name that `plan(planner=...)` accepts."""

__all__ = [
    "DRIVING",
    "DriveLattice",
    "FloorInTime",
    "FloorThetaStar",
    "PoseSpace",
    "ReedsSheppPRM",
    "ReedsSheppRRT",
    "ReedsSheppRRTStar",
]
