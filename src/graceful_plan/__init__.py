"""graceful_plan: motion planning that chooses paths along which a failure at any moment does little harm."""

from graceful_plan import costs
from graceful_plan._version import __version__
from graceful_plan.analysis.certificate import certify
from graceful_plan.analysis.checks import clearance, interaction_probability
from graceful_plan.analysis.explanation import explain
from graceful_plan.analysis.impact_maps import impact_map
from graceful_plan.analysis.risk_measures import RiskMeasure, risk
from graceful_plan.compare.problems.problem_files import load_problems
from graceful_plan.constraints.axes import AxisWithin, Upright
from graceful_plan.constraints.constraint import Constraint
from graceful_plan.constraints.contents import KeepContents
from graceful_plan.constraints.distance import KeepDistance
from graceful_plan.constraints.grasp import GraspHolds
from graceful_plan.constraints.standing import KeepStanding
from graceful_plan.constraints.tool import ToolSpeed, ToolWithin
from graceful_plan.control.dwa import DWA
from graceful_plan.costs.blocks.clearance_cost import ClearanceCost
from graceful_plan.costs.cost import Cost, StateBatch
from graceful_plan.costs.fault_prior import FaultPrior
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.interaction import InteractionModel
from graceful_plan.costs.models.mixture.mixture import Footprint
from graceful_plan.costs.models.published.box_overlap import BoxOverlap
from graceful_plan.costs.motion import JointLength
from graceful_plan.costs.objective import Objective, evaluate
from graceful_plan.exceptions import GracefulPlanError
from graceful_plan.judge.verification import Verification, verify
from graceful_plan.path import Path
from graceful_plan.plan import plan
from graceful_plan.planners import CHOMP, PLANNERS, STOMP, Anytime, Auto, CasADi, Planner, PRMStar, RRTConnect, RRTStar
from graceful_plan.planners.driving.drive_lattice import DriveLattice
from graceful_plan.query.cartesian.straight import straight_motion
from graceful_plan.result import CostBreakdown, PlanningFailed, PlanResult, PlanStatus, Verdict
from graceful_plan.roadmap import Roadmap
from graceful_plan.scene.edit import Solid
from graceful_plan.scene.elements import AllowedContact, Dry, EntityNote, Liquid
from graceful_plan.scene.harm.severity import SeverityTable
from graceful_plan.scene.loading.bundled import load_scene, mobile_scenes, scenes
from graceful_plan.scene.mobile.base_pose import BasePose
from graceful_plan.scene.mobile.diff_drive import DiffDrive
from graceful_plan.scene.moving import MovingEntity
from graceful_plan.scene.pose_goal import PoseGoal
from graceful_plan.scene.scene import Scene, Task
from graceful_plan.scene.sensed.cloud import PointCloud
from graceful_plan.scene.sensed.height_map import HeightMap
from graceful_plan.timing.retiming import retime
from graceful_plan.timing.trajectory import Trajectory
from graceful_plan.transcription.trajectory_optimisation import optimise_trajectory
from graceful_plan.tuning.fronts import ParetoFront, pareto
from graceful_plan.viewer.opening import view

__all__ = [
    "AllowedContact",
    "Anytime",
    "Auto",
    "AxisWithin",
    "BasePose",
    "BoxOverlap",
    "CHOMP",
    "CasADi",
    "ClearanceCost",
    "Constraint",
    "Cost",
    "CostBreakdown",
    "DWA",
    "DiffDrive",
    "DriveLattice",
    "Dry",
    "EntityNote",
    "FaultPrior",
    "Footprint",
    "GracefulPlanError",
    "GraspHolds",
    "HeightMap",
    "ImpactCost",
    "InteractionModel",
    "JointLength",
    "KeepContents",
    "KeepDistance",
    "KeepStanding",
    "Liquid",
    "MovingEntity",
    "Objective",
    "PLANNERS",
    "PRMStar",
    "ParetoFront",
    "Path",
    "PlanResult",
    "PlanStatus",
    "Planner",
    "PointCloud",
    "PlanningFailed",
    "PoseGoal",
    "RRTConnect",
    "RRTStar",
    "RiskMeasure",
    "Roadmap",
    "STOMP",
    "Scene",
    "SeverityTable",
    "Solid",
    "StateBatch",
    "Task",
    "ToolSpeed",
    "ToolWithin",
    "Trajectory",
    "Upright",
    "Verdict",
    "Verification",
    "__version__",
    "certify",
    "clearance",
    "costs",
    "evaluate",
    "explain",
    "impact_map",
    "interaction_probability",
    "load_problems",
    "load_scene",
    "mobile_scenes",
    "optimise_trajectory",
    "pareto",
    "plan",
    "retime",
    "risk",
    "scenes",
    "straight_motion",
    "verify",
    "view",
]
