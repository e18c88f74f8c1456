"""FailBench: execute a trajectory in MuJoCo, break the robot, and record all hits and their force.

It uses only the public interface of `graceful_plan`, which never imports it.
"""

from typing import TYPE_CHECKING

from graceful_plan import lazy_imports

# Names are imported at their first use; type checkers read these imports.
if TYPE_CHECKING:
    from failbench.basics.errors import ExecutionRefused
    from failbench.basics.onset import AtFraction, AtTime, Uniform
    from failbench.basics.statistics import Estimate
    from failbench.comparison import compare, harm_ratio
    from failbench.fault.fault import Fault
    from failbench.fault.registry import faults, reactions
    from failbench.front_validation import FrontValidation, validate_front
    from failbench.mobile.driving import drive_base
    from failbench.pictures.playback import replay
    from failbench.recording.healthy import HealthyHarm
    from failbench.recording.records import ContactEvent, Job, Rollout
    from failbench.recording.score import energy_impact, observed_impact, own_loss, secondary_impact
    from failbench.report import EntityReport, ValidationReport
    from failbench.rollouts.execution import Execution, ObjectLost, execute
    from failbench.rollouts.rollout import run_rollouts
    from failbench.rollouts.single import rollout_steps
    from failbench.scenario import Scenario, scenarios
    from failbench.simulated.simulation import Simulation
    from failbench.simulated.world import SimSettings, World, build_world
    from failbench.surroundings.registry import disturbances, scene_with_intruder
    from failbench.sweeps.dataset import Dataset, read_dataset
    from failbench.sweeps.sweep import generate_dataset, resume
    from failbench.validation import validate
else:
    lazy_imports.install(
        __name__,
        {
            "AtFraction": "failbench.basics.onset",
            "AtTime": "failbench.basics.onset",
            "ContactEvent": "failbench.recording.records",
            "Dataset": "failbench.sweeps.dataset",
            "EntityReport": "failbench.report",
            "Estimate": "failbench.basics.statistics",
            "Execution": "failbench.rollouts.execution",
            "ExecutionRefused": "failbench.basics.errors",
            "Fault": "failbench.fault.fault",
            "FrontValidation": "failbench.front_validation",
            "HealthyHarm": "failbench.recording.healthy",
            "Job": "failbench.recording.records",
            "ObjectLost": "failbench.rollouts.execution",
            "Simulation": "failbench.simulated.simulation",
            "Rollout": "failbench.recording.records",
            "Scenario": "failbench.scenario",
            "SimSettings": "failbench.simulated.world",
            "Uniform": "failbench.basics.onset",
            "ValidationReport": "failbench.report",
            "World": "failbench.simulated.world",
            "build_world": "failbench.simulated.world",
            "compare": "failbench.comparison",
            "disturbances": "failbench.surroundings.registry",
            "drive_base": "failbench.mobile.driving",
            "energy_impact": "failbench.recording.score",
            "execute": "failbench.rollouts.execution",
            "faults": "failbench.fault.registry",
            "generate_dataset": "failbench.sweeps.sweep",
            "harm_ratio": "failbench.comparison",
            "observed_impact": "failbench.recording.score",
            "own_loss": "failbench.recording.score",
            "reactions": "failbench.fault.registry",
            "read_dataset": "failbench.sweeps.dataset",
            "replay": "failbench.pictures.playback",
            "resume": "failbench.sweeps.sweep",
            "run_rollouts": "failbench.rollouts.rollout",
            "scenarios": "failbench.scenario",
            "secondary_impact": "failbench.recording.score",
            "scene_with_intruder": "failbench.surroundings.registry",
            "rollout_steps": "failbench.rollouts.single",
            "validate": "failbench.validation",
            "validate_front": "failbench.front_validation",
        },
    )

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
    "Simulation",
    "Rollout",
    "Scenario",
    "SimSettings",
    "Uniform",
    "ValidationReport",
    "World",
    "build_world",
    "compare",
    "disturbances",
    "drive_base",
    "energy_impact",
    "execute",
    "faults",
    "generate_dataset",
    "harm_ratio",
    "observed_impact",
    "own_loss",
    "reactions",
    "read_dataset",
    "replay",
    "resume",
    "run_rollouts",
    "scenarios",
    "secondary_impact",
    "scene_with_intruder",
    "rollout_steps",
    "validate",
    "validate_front",
]
