"""The public names of `graceful_plan`: `__init__.py` imports each on first access from the module named here."""

from graceful_plan import costs as costs
from graceful_plan._version import __version__ as __version__
from graceful_plan.analysis.certificate import certify as certify
from graceful_plan.analysis.checks import clearance as clearance
from graceful_plan.analysis.checks import interaction_probability as interaction_probability
from graceful_plan.analysis.explanation import explain as explain
from graceful_plan.analysis.impact_maps import impact_map as impact_map
from graceful_plan.analysis.risk_measures import RiskMeasure as RiskMeasure
from graceful_plan.analysis.risk_measures import risk as risk
from graceful_plan.annotation.asking import annotate as annotate
from graceful_plan.compare.problems.problem_files import load_problems as load_problems
from graceful_plan.constraints.axes import AxisWithin as AxisWithin
from graceful_plan.constraints.axes import Upright as Upright
from graceful_plan.constraints.constraint import Constraint as Constraint
from graceful_plan.constraints.contents import KeepContents as KeepContents
from graceful_plan.constraints.distance import KeepDistance as KeepDistance
from graceful_plan.constraints.grasp import GraspHolds as GraspHolds
from graceful_plan.constraints.standing import KeepStanding as KeepStanding
from graceful_plan.constraints.tool import ToolSpeed as ToolSpeed
from graceful_plan.constraints.tool import ToolWithin as ToolWithin
from graceful_plan.constraints.torque import TorqueWithin as TorqueWithin
from graceful_plan.costs.blocks.clearance_cost import ClearanceCost as ClearanceCost
from graceful_plan.costs.cost import Cost as Cost
from graceful_plan.costs.cost import StateBatch as StateBatch
from graceful_plan.costs.fault_prior import FaultPrior as FaultPrior
from graceful_plan.costs.impact import ImpactCost as ImpactCost
from graceful_plan.costs.interaction import InteractionModel as InteractionModel
from graceful_plan.costs.models.drop.network import DropNetwork as DropNetwork
from graceful_plan.costs.models.mixture.mixture import FailureMixture as FailureMixture
from graceful_plan.costs.models.published.box_overlap import BoxOverlap as BoxOverlap
from graceful_plan.costs.motion import JointLength as JointLength
from graceful_plan.costs.objective import Objective as Objective
from graceful_plan.costs.objective import evaluate as evaluate
from graceful_plan.exceptions import GracefulPlanError as GracefulPlanError
from graceful_plan.judge.verification import VerificationSettings as VerificationSettings
from graceful_plan.judge.verification import verify as verify
from graceful_plan.mobile.control.dwa import DWA as DWA
from graceful_plan.mobile.floor.occupancy_grid import OccupancyGrid as OccupancyGrid
from graceful_plan.mobile.planners.drive_lattice import DriveLattice as DriveLattice
from graceful_plan.path import Path as Path
from graceful_plan.plan import plan as plan
from graceful_plan.planners import (
    CHOMP as CHOMP,
)
from graceful_plan.planners import (
    PLANNERS as PLANNERS,
)
from graceful_plan.planners import (
    STOMP as STOMP,
)
from graceful_plan.planners import (
    Anytime as Anytime,
)
from graceful_plan.planners import (
    Auto as Auto,
)
from graceful_plan.planners import (
    CasADi as CasADi,
)
from graceful_plan.planners import (
    Planner as Planner,
)
from graceful_plan.planners import (
    PRMStar as PRMStar,
)
from graceful_plan.planners import (
    RRTConnect as RRTConnect,
)
from graceful_plan.planners import (
    RRTStar as RRTStar,
)
from graceful_plan.query.cartesian.straight import plan_cartesian as plan_cartesian
from graceful_plan.query.stop import plan_stop as plan_stop
from graceful_plan.result import (
    CostBreakdown as CostBreakdown,
)
from graceful_plan.result import (
    PlanningFailed as PlanningFailed,
)
from graceful_plan.result import (
    PlanResult as PlanResult,
)
from graceful_plan.result import (
    PlanStatus as PlanStatus,
)
from graceful_plan.result import (
    Verdict as Verdict,
)
from graceful_plan.roadmap import Roadmap as Roadmap
from graceful_plan.scene.edit import StaticBody as StaticBody
from graceful_plan.scene.elements import (
    AllowedContact as AllowedContact,
)
from graceful_plan.scene.elements import (
    EntityAnnotation as EntityAnnotation,
)
from graceful_plan.scene.elements import (
    Granular as Granular,
)
from graceful_plan.scene.elements import (
    Liquid as Liquid,
)
from graceful_plan.scene.harm.severity import SeverityTable as SeverityTable
from graceful_plan.scene.loading.bundled import (
    load_scene as load_scene,
)
from graceful_plan.scene.loading.bundled import (
    mobile_scenes as mobile_scenes,
)
from graceful_plan.scene.loading.bundled import (
    scenes as scenes,
)
from graceful_plan.scene.mobile.base_pose import BasePose as BasePose
from graceful_plan.scene.mobile.diff_drive import DiffDrive as DiffDrive
from graceful_plan.scene.moving import MovingEntity as MovingEntity
from graceful_plan.scene.pose_goal import PoseGoal as PoseGoal
from graceful_plan.scene.roles import FROM_ABOVE as FROM_ABOVE
from graceful_plan.scene.scene import Scene as Scene
from graceful_plan.scene.scene import Task as Task
from graceful_plan.scene.sensed.cloud import PointCloud as PointCloud
from graceful_plan.scene.sensed.height_map import HeightMap as HeightMap
from graceful_plan.timing.retiming import retime as retime
from graceful_plan.timing.trajectory import Trajectory as Trajectory
from graceful_plan.transcription.trajectory_optimisation import optimise_trajectory as optimise_trajectory
from graceful_plan.tuning.fronts import ParetoFront as ParetoFront
from graceful_plan.tuning.fronts import pareto as pareto
from graceful_plan.viewer.opening import view as view
