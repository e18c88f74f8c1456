"""Planners: each a frozen settings object with one method, `solve`. `PLANNERS` lists them by name."""

from graceful_plan.planners.anytime.anytime import Anytime
from graceful_plan.planners.anytime.auto import Auto
from graceful_plan.planners.ompl.planners import RRT, BITStar
from graceful_plan.planners.optimisers.chomp import CHOMP
from graceful_plan.planners.optimisers.ipopt import CasADi
from graceful_plan.planners.optimisers.stomp import STOMP
from graceful_plan.planners.planner import Planner
from graceful_plan.planners.roadmaps.prm import PRM, PRMStar
from graceful_plan.planners.trees.bitrrt import BiTRRT
from graceful_plan.planners.trees.rrt_connect import RRTConnect
from graceful_plan.planners.trees.rrt_star import InformedRRTStar, RRTStar
from graceful_plan.planners.trees.tool_rrt import ToolRRT
from graceful_plan.planners.trees.trrt import TRRT

_ALL = (
    Auto,
    Anytime,
    RRTConnect,
    PRM,
    PRMStar,
    TRRT,
    BiTRRT,
    ToolRRT,
    RRT,
    RRTStar,
    InformedRRTStar,
    BITStar,
    STOMP,
    CHOMP,
    CasADi,
)

PLANNERS: dict[str, type[Planner]] = {planner.name: planner for planner in _ALL}
"""Planners by the name that selects them in `plan(planner=...)`."""

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
    "ToolRRT",
]
