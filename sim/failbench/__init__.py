"""FailBench: execute a trajectory in MuJoCo, break the robot, and record what was really hit, and how hard.

It uses what is public in `graceful_plan`, which never imports it.
"""

from failbench.errors import ExecutionRefused
from failbench.execution import Execution, execute
from failbench.faults.fault import Fault
from failbench.onset import AtFraction, AtTime, Uniform
from failbench.plant import Plant
from failbench.records import ContactEvent, Job, Rollout
from failbench.rollout import run
from failbench.single import steps
from failbench.world import SimSettings, World, build_world

__all__ = [
    "AtFraction",
    "AtTime",
    "ContactEvent",
    "Execution",
    "ExecutionRefused",
    "Fault",
    "Job",
    "Plant",
    "Rollout",
    "SimSettings",
    "Uniform",
    "World",
    "build_world",
    "execute",
    "run",
    "steps",
]
