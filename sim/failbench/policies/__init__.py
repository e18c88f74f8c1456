"""Closed-loop policies under the same faults as trajectories.

Imported on demand: `import failbench.policies`. Only the Gymnasium environments in `failbench.policies.gym` need the
extra `policies`.
"""

from failbench.policies.adapters import LeRobotPolicy, OpenLoop, Scripted, executor, planned, reach, scripted
from failbench.policies.evaluation import evaluate
from failbench.policies.mlp import Mlp
from failbench.policies.monitoring import SensorErrors, Watch, healthy_records, monitored, varied_task
from failbench.policies.policy import Acting, Observation, Policy, PolicyFactory, imported_policy
from failbench.policies.recovery import (
    BrakeOnFailure,
    PreparedStop,
    Recovering,
    Recovery,
    ReplanOnFailure,
    StopOnFailure,
    recovering,
)
from failbench.policies.report import PolicyReport
from failbench.policies.rollouts import PolicyRollout, roll_out
from failbench.policies.task import PolicySettings, PolicyTask, policy_task

__all__ = [
    "Acting",
    "BrakeOnFailure",
    "LeRobotPolicy",
    "Mlp",
    "Observation",
    "OpenLoop",
    "Policy",
    "PolicyFactory",
    "PolicyReport",
    "PolicyRollout",
    "PolicySettings",
    "PolicyTask",
    "PreparedStop",
    "Recovering",
    "Recovery",
    "ReplanOnFailure",
    "Scripted",
    "SensorErrors",
    "StopOnFailure",
    "Watch",
    "evaluate",
    "executor",
    "healthy_records",
    "imported_policy",
    "monitored",
    "planned",
    "policy_task",
    "reach",
    "recovering",
    "roll_out",
    "scripted",
    "varied_task",
]
