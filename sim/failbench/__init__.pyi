"""The public names of `failbench`: `__init__.py` imports each on first access from the module named here."""

from failbench.basics.errors import ExecutionRefused as ExecutionRefused
from failbench.basics.onset import AtFraction as AtFraction
from failbench.basics.onset import AtTime as AtTime
from failbench.basics.onset import Uniform as Uniform
from failbench.basics.statistics import Estimate as Estimate
from failbench.comparison import compare as compare
from failbench.comparison import harm_ratio as harm_ratio
from failbench.fault.fault import Fault as Fault
from failbench.fault.registry import faults as faults
from failbench.fault.registry import reactions as reactions
from failbench.front_validation import FrontValidation as FrontValidation
from failbench.front_validation import validate_front as validate_front
from failbench.mobile.driving import drive_base as drive_base
from failbench.pictures.playback import replay as replay
from failbench.recording.healthy import HealthyHarm as HealthyHarm
from failbench.recording.records import ContactEvent as ContactEvent
from failbench.recording.records import Job as Job
from failbench.recording.records import Rollout as Rollout
from failbench.recording.score import (
    energy_impact as energy_impact,
)
from failbench.recording.score import (
    observed_impact as observed_impact,
)
from failbench.recording.score import (
    own_loss as own_loss,
)
from failbench.recording.score import (
    secondary_impact as secondary_impact,
)
from failbench.report import EntityReport as EntityReport
from failbench.report import ValidationReport as ValidationReport
from failbench.rollouts.execution import Execution as Execution
from failbench.rollouts.execution import ObjectLost as ObjectLost
from failbench.rollouts.execution import execute as execute
from failbench.rollouts.rollout import run_rollouts as run_rollouts
from failbench.rollouts.single import rollout_steps as rollout_steps
from failbench.scenario import Scenario as Scenario
from failbench.scenario import scenarios as scenarios
from failbench.simulated.simulation import Simulation as Simulation
from failbench.simulated.world import SimSettings as SimSettings
from failbench.simulated.world import World as World
from failbench.simulated.world import build_world as build_world
from failbench.surroundings.registry import disturbances as disturbances
from failbench.surroundings.registry import scene_with_intruder as scene_with_intruder
from failbench.sweeps.dataset import Dataset as Dataset
from failbench.sweeps.dataset import read_dataset as read_dataset
from failbench.sweeps.sweep import generate_dataset as generate_dataset
from failbench.sweeps.sweep import resume as resume
from failbench.validation import validate as validate
