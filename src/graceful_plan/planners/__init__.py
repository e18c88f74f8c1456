"""Planners: each a frozen settings object with one method, `solve`. `PLANNERS` lists them by name."""

from graceful_plan.planners.anytime import Anytime
from graceful_plan.planners.bitrrt import BiTRRT
from graceful_plan.planners.chomp import CHOMP
from graceful_plan.planners.ompl import RRT, BITStar, InformedRRTStar, RRTStar
from graceful_plan.planners.planner import Planner
from graceful_plan.planners.prm import PRM, PRMStar
from graceful_plan.planners.rrt_connect import RRTConnect
from graceful_plan.planners.transcription import CasADi
from graceful_plan.planners.trrt import TRRT

PLANNERS: dict[str, type[Planner]] = {
    planner.name: planner
    for planner in (
        Anytime,
        RRTConnect,
        PRM,
        PRMStar,
        TRRT,
        BiTRRT,
        RRT,
        RRTStar,
        InformedRRTStar,
        BITStar,
        CHOMP,
        CasADi,
    )
}
"""Every planner that `plan(planner=...)` knows by name."""

__all__ = [
    "CHOMP",
    "PLANNERS",
    "PRM",
    "RRT",
    "TRRT",
    "Anytime",
    "BITStar",
    "BiTRRT",
    "CasADi",
    "InformedRRTStar",
    "PRMStar",
    "Planner",
    "RRTConnect",
    "RRTStar",
]
