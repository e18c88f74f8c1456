"""FailBench: execute a trajectory in MuJoCo, break the robot, and record what was really hit, and how hard.

It uses what is public in `graceful_plan`, which never imports it.
"""

from failbench.basics.errors import ExecutionRefused
from failbench.basics.onset import AtFraction, AtTime, Uniform
from failbench.basics.statistics import Estimate
from failbench.comparison import compare, harm_ratio
from failbench.fault.fault import Fault
from failbench.fault.registry import faults, reactions
from failbench.front_validation import FrontValidation, validate_front
from failbench.pictures.playback import replay
from failbench.recording.healthy import HealthyHarm
from failbench.recording.records import ContactEvent, Job, Rollout
from failbench.recording.score import energy_impact, observed_impact, own_loss, secondary_impact
from failbench.report import EntityReport, ValidationReport
from failbench.rollouts.execution import Execution, ObjectLost, execute
from failbench.rollouts.rollout import run
from failbench.rollouts.single import steps
from failbench.scenario import Scenario, scenarios
from failbench.simulated.plant import Plant
from failbench.simulated.world import SimSettings, World, build_world
from failbench.surroundings.registry import disturbances, staged_for
from failbench.sweeps.dataset import Dataset, read_dataset
from failbench.sweeps.sweep import generate, resume
from failbench.validation import validate

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
    "HealthyHarm",
    "Job",
    "ObjectLost",
    "Plant",
    "Rollout",
    "Scenario",
    "SimSettings",
    "Uniform",
    "ValidationReport",
    "World",
    "build_world",
    "compare",
    "disturbances",
    "energy_impact",
    "execute",
    "faults",
    "generate",
    "harm_ratio",
    "observed_impact",
    "own_loss",
    "reactions",
    "read_dataset",
    "replay",
    "resume",
    "run",
    "scenarios",
    "secondary_impact",
    "staged_for",
    "steps",
    "validate",
    "validate_front",
]
