"""Closed-loop policies under the same faults as trajectories.

Imported on demand: `import failbench.policies`. Only the Gymnasium environments in `failbench.policies.gym` need the
extra `policies`.
"""

from failbench.policies.adapters import LeRobotPolicy, OpenLoop, Scripted, executor, planned, reach, scripted
from failbench.policies.evaluation import evaluate
from failbench.policies.mlp import Mlp
from failbench.policies.policy import Acting, Observation, Policy, PolicyFactory, imported_policy
from failbench.policies.recovery import Recovering, Recovery, ReplanOnFailure, StopOnFailure, recovering
from failbench.policies.report import PolicyReport
from failbench.policies.rollouts import PolicyRollout, roll_out
from failbench.policies.task import PolicySettings, PolicyTask, policy_task

__all__ = [
    "Acting",
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
    "Recovering",
    "Recovery",
    "ReplanOnFailure",
    "Scripted",
    "StopOnFailure",
    "evaluate",
    "executor",
    "imported_policy",
    "planned",
    "policy_task",
    "reach",
    "recovering",
    "roll_out",
    "scripted",
]
