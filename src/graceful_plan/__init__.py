"""graceful_plan: motion planning that chooses paths along which a failure at any moment does little harm."""

from graceful_plan._version import __version__
from graceful_plan.arrays import HazardArrays, RobotArrays, WorldArrays
from graceful_plan.certificate import certify
from graceful_plan.checks import clearance, interaction_probability
from graceful_plan.costs.cost import Cost, StateBatch
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.interactions import BoxOverlap, Footprint, InteractionModel
from graceful_plan.costs.motion import JointLength
from graceful_plan.costs.objective import Objective, evaluate
from graceful_plan.dynamics import RobotDynamics
from graceful_plan.elements import AllowedContact, Dry, EntityNote, Limits, Liquid, Task
from graceful_plan.exceptions import (
    CostError,
    GracefulPlanError,
    NonFiniteError,
    PlanningFailed,
    SceneError,
    SettingError,
    ShapeError,
    UnknownNameError,
    UnsupportedError,
)
from graceful_plan.explain import Contribution, Explanation, explain
from graceful_plan.fault_prior import FaultPrior
from graceful_plan.fragility import FragilityTable
from graceful_plan.impact_map import ImpactMap, impact_map
from graceful_plan.moving import MovingEntity
from graceful_plan.optimise import OptimisationStatus, OptimisedTrajectory, optimise_trajectory
from graceful_plan.path import Path
from graceful_plan.plan import plan
from graceful_plan.planners import (
    CHOMP,
    PLANNERS,
    PRM,
    RRT,
    STOMP,
    TRRT,
    Anytime,
    Auto,
    BiTRRT,
    BITStar,
    CasADi,
    InformedRRTStar,
    Planner,
    PRMStar,
    RRTConnect,
    RRTStar,
)
from graceful_plan.pose_goal import PoseGoal
from graceful_plan.problem_files import ProblemFile, load_problems
from graceful_plan.result import Certificate, Check, CostBreakdown, PlanResult, PlanStatus, TracePoint, Verdict
from graceful_plan.retime import retime
from graceful_plan.risk import Risk, RiskMeasure, risk
from graceful_plan.roadmap import FrontPath, QueryResult, QueryStatus, Roadmap, RoadmapPlanner, StaleRoadmapError
from graceful_plan.scene import Scene
from graceful_plan.scenes import load_scene, scenes
from graceful_plan.sensitivity import SeveritySensitivity, severity_sensitivity
from graceful_plan.severity import SeverityTable
from graceful_plan.trajectory import Trajectory
from graceful_plan.tuning import Choice, ChoiceStatus, ParetoFront, ParetoPoint, pareto
from graceful_plan.verify import verify

__all__ = [
    "PLANNERS",
    "CHOMP",
    "PRM",
    "RRT",
    "STOMP",
    "TRRT",
    "AllowedContact",
    "Anytime",
    "Auto",
    "BITStar",
    "BiTRRT",
    "BoxOverlap",
    "Footprint",
    "CasADi",
    "Certificate",
    "Check",
    "Choice",
    "ChoiceStatus",
    "Contribution",
    "Cost",
    "CostBreakdown",
    "CostError",
    "Dry",
    "EntityNote",
    "Explanation",
    "FaultPrior",
    "FragilityTable",
    "FrontPath",
    "GracefulPlanError",
    "HazardArrays",
    "ImpactCost",
    "ImpactMap",
    "InformedRRTStar",
    "InteractionModel",
    "JointLength",
    "Limits",
    "Liquid",
    "MovingEntity",
    "NonFiniteError",
    "Objective",
    "OptimisationStatus",
    "OptimisedTrajectory",
    "PRMStar",
    "ParetoFront",
    "ParetoPoint",
    "Path",
    "PlanResult",
    "PlanStatus",
    "Planner",
    "PlanningFailed",
    "PoseGoal",
    "QueryResult",
    "QueryStatus",
    "ProblemFile",
    "RRTConnect",
    "RRTStar",
    "Risk",
    "RiskMeasure",
    "Roadmap",
    "RoadmapPlanner",
    "RobotArrays",
    "RobotDynamics",
    "Scene",
    "SceneError",
    "SettingError",
    "SeveritySensitivity",
    "SeverityTable",
    "ShapeError",
    "StaleRoadmapError",
    "StateBatch",
    "Task",
    "TracePoint",
    "Trajectory",
    "UnknownNameError",
    "UnsupportedError",
    "Verdict",
    "WorldArrays",
    "__version__",
    "certify",
    "clearance",
    "evaluate",
    "explain",
    "impact_map",
    "interaction_probability",
    "load_problems",
    "load_scene",
    "optimise_trajectory",
    "pareto",
    "plan",
    "retime",
    "risk",
    "scenes",
    "severity_sensitivity",
    "verify",
]
