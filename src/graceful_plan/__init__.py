"""graceful_plan: motion planning that chooses paths along which a failure at any moment does little harm."""

from graceful_plan._version import __version__
from graceful_plan.analysis.certificate import certify
from graceful_plan.analysis.checks import clearance, interaction_probability
from graceful_plan.analysis.explanation import Contribution, Explanation, explain
from graceful_plan.analysis.impact_maps import ImpactMap, impact_map
from graceful_plan.analysis.risk_measures import Risk, RiskMeasure, risk
from graceful_plan.analysis.sensitivity import SeveritySensitivity, severity_sensitivity
from graceful_plan.compare.problems.problem_files import ProblemFile, load_problems
from graceful_plan.core.arrays import HazardArrays, RobotArrays, WorldArrays
from graceful_plan.costs.cost import Cost, StateBatch
from graceful_plan.costs.fault_prior import FaultPrior
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.interaction import InteractionModel
from graceful_plan.costs.models.mixture.mixture import Footprint
from graceful_plan.costs.models.published.box_overlap import BoxOverlap
from graceful_plan.costs.motion import JointLength
from graceful_plan.costs.objective import Objective, evaluate
from graceful_plan.exceptions import (
    CostError,
    GracefulPlanError,
    NonFiniteError,
    SceneError,
    SettingError,
    ShapeError,
    UnknownNameError,
    UnsupportedError,
)
from graceful_plan.judge.verification import verify
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
from graceful_plan.result import (
    Certificate,
    Check,
    CostBreakdown,
    PlanningFailed,
    PlanResult,
    PlanStatus,
    TracePoint,
    Verdict,
)
from graceful_plan.roadmap import FrontPath, QueryResult, QueryStatus, Roadmap
from graceful_plan.scene.elements import AllowedContact, Dry, EntityNote, Limits, Liquid
from graceful_plan.scene.harm.fragility import FragilityTable
from graceful_plan.scene.harm.severity import SeverityTable
from graceful_plan.scene.loading.bundled import load_scene, scenes
from graceful_plan.scene.moving import MovingEntity
from graceful_plan.scene.pose_goal import PoseGoal
from graceful_plan.scene.scene import Scene, Task
from graceful_plan.timing.dynamics import RobotDynamics
from graceful_plan.timing.retiming import retime
from graceful_plan.timing.trajectory import Trajectory
from graceful_plan.transcription.trajectory_optimisation import (
    OptimisationStatus,
    OptimisedTrajectory,
    optimise_trajectory,
)
from graceful_plan.tuning.fronts import Choice, ChoiceStatus, ParetoFront, ParetoPoint, pareto

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
    "RobotArrays",
    "RobotDynamics",
    "Scene",
    "SceneError",
    "SettingError",
    "SeveritySensitivity",
    "SeverityTable",
    "ShapeError",
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
