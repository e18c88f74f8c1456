"""FailBench: execute a trajectory in MuJoCo, break the robot, and record what was really hit, and how hard.

It uses what is public in `graceful_plan`, which never imports it.
"""

from failbench.dataset import Dataset, read_dataset
from failbench.errors import ExecutionRefused
from failbench.execution import Execution, execute
from failbench.faults import faults
from failbench.faults.fault import Fault
from failbench.front_validation import FrontValidation, validate_front
from failbench.onset import AtFraction, AtTime, Uniform
from failbench.plant import Plant
from failbench.records import ContactEvent, Job, Rollout
from failbench.replay import replay
from failbench.report import EntityReport, ValidationReport
from failbench.rollout import run
from failbench.scenarios import Scenario, scenarios
from failbench.score import energy_impact, observed_impact, secondary_impact
from failbench.single import steps
from failbench.statistics import Estimate
from failbench.sweep import generate, resume
from failbench.validate import compare, validate
from failbench.world import SimSettings, World, build_world

__all__ = [
    "AtFraction",
    "AtTime",
    "ContactEvent",
    "Dataset",
    "EntityReport",
    "Estimate",
    "Execution",
    "ExecutionRefused",
    "Fault",
    "FrontValidation",
    "Job",
    "Plant",
    "Rollout",
    "Scenario",
    "SimSettings",
    "Uniform",
    "ValidationReport",
    "World",
    "build_world",
    "compare",
    "energy_impact",
    "execute",
    "faults",
    "generate",
    "observed_impact",
    "read_dataset",
    "replay",
    "resume",
    "run",
    "scenarios",
    "secondary_impact",
    "steps",
    "validate",
    "validate_front",
]
