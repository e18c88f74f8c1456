"""graceful_plan: motion planning for motions along which a failure at any moment does little harm."""

from typing import TYPE_CHECKING

from graceful_plan import lazy_imports
from graceful_plan._version import __version__

# Names are imported on first access; type checkers read the imports below.
if TYPE_CHECKING:
    from graceful_plan import costs
    from graceful_plan.analysis.certificate import certify
    from graceful_plan.analysis.checks import clearance, interaction_probability
    from graceful_plan.analysis.explanation import explain
    from graceful_plan.analysis.impact_maps import impact_map
    from graceful_plan.analysis.risk_measures import RiskMeasure, risk
    from graceful_plan.annotation.asking import annotate
    from graceful_plan.compare.problems.problem_files import load_problems
    from graceful_plan.constraints.axes import AxisWithin, Upright
    from graceful_plan.constraints.constraint import Constraint
    from graceful_plan.constraints.contents import KeepContents
    from graceful_plan.constraints.distance import KeepDistance
    from graceful_plan.constraints.grasp import GraspHolds
    from graceful_plan.constraints.standing import KeepStanding
    from graceful_plan.constraints.tool import ToolSpeed, ToolWithin
    from graceful_plan.costs.blocks.clearance_cost import ClearanceCost
    from graceful_plan.costs.cost import Cost, StateBatch
    from graceful_plan.costs.fault_prior import FaultPrior
    from graceful_plan.costs.impact import ImpactCost
    from graceful_plan.costs.interaction import InteractionModel
    from graceful_plan.costs.models.drop.network import DropNetwork
    from graceful_plan.costs.models.mixture.mixture import FailureMixture
    from graceful_plan.costs.models.published.box_overlap import BoxOverlap
    from graceful_plan.costs.motion import JointLength
    from graceful_plan.costs.objective import Objective, evaluate
    from graceful_plan.exceptions import GracefulPlanError
    from graceful_plan.judge.verification import VerificationSettings, verify
    from graceful_plan.mobile.control.dwa import DWA
    from graceful_plan.mobile.floor.occupancy_grid import OccupancyGrid
    from graceful_plan.mobile.planners.drive_lattice import DriveLattice
    from graceful_plan.path import Path
    from graceful_plan.plan import plan
    from graceful_plan.planners import (
        CHOMP,
        PLANNERS,
        STOMP,
        Anytime,
        Auto,
        CasADi,
        Planner,
        PRMStar,
        RRTConnect,
        RRTStar,
    )
    from graceful_plan.query.cartesian.straight import plan_cartesian
    from graceful_plan.result import CostBreakdown, PlanningFailed, PlanResult, PlanStatus, Verdict
    from graceful_plan.roadmap import Roadmap
    from graceful_plan.scene.edit import StaticBody
    from graceful_plan.scene.elements import AllowedContact, EntityAnnotation, Granular, Liquid
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
else:
    lazy_imports.install(
        __name__,
        {
            "AllowedContact": "graceful_plan.scene.elements",
            "Anytime": "graceful_plan.planners",
            "Auto": "graceful_plan.planners",
            "AxisWithin": "graceful_plan.constraints.axes",
            "BasePose": "graceful_plan.scene.mobile.base_pose",
            "BoxOverlap": "graceful_plan.costs.models.published.box_overlap",
            "CHOMP": "graceful_plan.planners",
            "CasADi": "graceful_plan.planners",
            "ClearanceCost": "graceful_plan.costs.blocks.clearance_cost",
            "Constraint": "graceful_plan.constraints.constraint",
            "Cost": "graceful_plan.costs.cost",
            "CostBreakdown": "graceful_plan.result",
            "DWA": "graceful_plan.mobile.control.dwa",
            "DiffDrive": "graceful_plan.scene.mobile.diff_drive",
            "DriveLattice": "graceful_plan.mobile.planners.drive_lattice",
            "DropNetwork": "graceful_plan.costs.models.drop.network",
            "Granular": "graceful_plan.scene.elements",
            "EntityAnnotation": "graceful_plan.scene.elements",
            "FaultPrior": "graceful_plan.costs.fault_prior",
            "OccupancyGrid": "graceful_plan.mobile.floor.occupancy_grid",
            "FailureMixture": "graceful_plan.costs.models.mixture.mixture",
            "GracefulPlanError": "graceful_plan.exceptions",
            "GraspHolds": "graceful_plan.constraints.grasp",
            "HeightMap": "graceful_plan.scene.sensed.height_map",
            "ImpactCost": "graceful_plan.costs.impact",
            "InteractionModel": "graceful_plan.costs.interaction",
            "JointLength": "graceful_plan.costs.motion",
            "KeepContents": "graceful_plan.constraints.contents",
            "KeepDistance": "graceful_plan.constraints.distance",
            "KeepStanding": "graceful_plan.constraints.standing",
            "Liquid": "graceful_plan.scene.elements",
            "MovingEntity": "graceful_plan.scene.moving",
            "Objective": "graceful_plan.costs.objective",
            "PLANNERS": "graceful_plan.planners",
            "PRMStar": "graceful_plan.planners",
            "ParetoFront": "graceful_plan.tuning.fronts",
            "Path": "graceful_plan.path",
            "PlanResult": "graceful_plan.result",
            "PlanStatus": "graceful_plan.result",
            "Planner": "graceful_plan.planners",
            "PlanningFailed": "graceful_plan.result",
            "PointCloud": "graceful_plan.scene.sensed.cloud",
            "PoseGoal": "graceful_plan.scene.pose_goal",
            "RRTConnect": "graceful_plan.planners",
            "RRTStar": "graceful_plan.planners",
            "RiskMeasure": "graceful_plan.analysis.risk_measures",
            "Roadmap": "graceful_plan.roadmap",
            "STOMP": "graceful_plan.planners",
            "Scene": "graceful_plan.scene.scene",
            "SeverityTable": "graceful_plan.scene.harm.severity",
            "StaticBody": "graceful_plan.scene.edit",
            "StateBatch": "graceful_plan.costs.cost",
            "Task": "graceful_plan.scene.scene",
            "ToolSpeed": "graceful_plan.constraints.tool",
            "ToolWithin": "graceful_plan.constraints.tool",
            "Trajectory": "graceful_plan.timing.trajectory",
            "Upright": "graceful_plan.constraints.axes",
            "Verdict": "graceful_plan.result",
            "VerificationSettings": "graceful_plan.judge.verification",
            "annotate": "graceful_plan.annotation.asking",
            "certify": "graceful_plan.analysis.certificate",
            "clearance": "graceful_plan.analysis.checks",
            "costs": "graceful_plan.costs",
            "evaluate": "graceful_plan.costs.objective",
            "explain": "graceful_plan.analysis.explanation",
            "impact_map": "graceful_plan.analysis.impact_maps",
            "interaction_probability": "graceful_plan.analysis.checks",
            "load_problems": "graceful_plan.compare.problems.problem_files",
            "load_scene": "graceful_plan.scene.loading.bundled",
            "mobile_scenes": "graceful_plan.scene.loading.bundled",
            "optimise_trajectory": "graceful_plan.transcription.trajectory_optimisation",
            "pareto": "graceful_plan.tuning.fronts",
            "plan": "graceful_plan.plan",
            "retime": "graceful_plan.timing.retiming",
            "risk": "graceful_plan.analysis.risk_measures",
            "scenes": "graceful_plan.scene.loading.bundled",
            "plan_cartesian": "graceful_plan.query.cartesian.straight",
            "verify": "graceful_plan.judge.verification",
            "view": "graceful_plan.viewer.opening",
        },
    )

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
    "DropNetwork",
    "Granular",
    "EntityAnnotation",
    "FaultPrior",
    "OccupancyGrid",
    "FailureMixture",
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
    "PlanningFailed",
    "PointCloud",
    "PoseGoal",
    "RRTConnect",
    "RRTStar",
    "RiskMeasure",
    "Roadmap",
    "STOMP",
    "Scene",
    "SeverityTable",
    "StaticBody",
    "StateBatch",
    "Task",
    "ToolSpeed",
    "ToolWithin",
    "Trajectory",
    "Upright",
    "Verdict",
    "VerificationSettings",
    "__version__",
    "annotate",
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
    "plan_cartesian",
    "verify",
    "view",
]
