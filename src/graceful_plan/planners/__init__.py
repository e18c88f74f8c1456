"""Planners: each a frozen settings object with one method, `solve`. `PLANNERS` lists them by name."""

from graceful_plan.planners.anytime import Anytime
from graceful_plan.planners.auto import Auto
from graceful_plan.planners.bitrrt import BiTRRT
from graceful_plan.planners.chomp import CHOMP
from graceful_plan.planners.ompl import RRT, BITStar, InformedRRTStar, RRTStar
from graceful_plan.planners.planner import Planner
from graceful_plan.planners.prm import PRM, PRMStar
from graceful_plan.planners.rrt_connect import RRTConnect
from graceful_plan.planners.stomp import STOMP
from graceful_plan.planners.transcription import CasADi
from graceful_plan.planners.trrt import TRRT

_ALL = (
    Auto,
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
    STOMP,
    CHOMP,
    CasADi,
)

PLANNERS: dict[str, type[Planner]] = {planner.name: planner for planner in _ALL}
"""Every planner that `plan(planner=...)` knows by name."""

__all__ = [
    "PLANNERS",
    "Anytime",
    "Auto",
    "BITStar",
    "BiTRRT",
    "CHOMP",
    "CasADi",
    "InformedRRTStar",
    "PRM",
    "PRMStar",
    "Planner",
    "RRT",
    "RRTConnect",
    "RRTStar",
    "STOMP",
    "TRRT",
]
