"""Execution of the chunks of a sweep; jobs, worlds and executions are cached for the next chunk."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import lru_cache

from failbench.basics.chunks import Chunk, Rows
from failbench.fault.registry import Fault
from failbench.recording.records import RolloutRequest
from failbench.rollouts.execution import Execution, execute
from failbench.rollouts.rollout import run_rollouts
from failbench.rollouts.sampling import make_requests
from failbench.simulated.world import SimSettings, World, build_world
from failbench.surroundings.registry import Disturbance, scene_with_intruder
from failbench.sweeps.definition import Sweep, fault_of, scene_of
from failbench.sweeps.rows import contact_rows, rollout_row
from graceful_plan import Trajectory
from graceful_plan.exceptions import SettingError


def run_chunk(sweep: Sweep, chunk: Chunk) -> Rows:
    """Run a chunk of a planned sweep and return its rows. World and execution are cached for the next chunk.

    Raises:
        ExecutionRefused: If the healthy robot cannot execute the motion.
    """
    execution = execution_of(sweep, chunk.motion)
    jobs = jobs_of(sweep, chunk.motion, chunk.fault)[chunk.first : chunk.last]
    rollouts = list(enumerate(run_rollouts(execution, jobs, horizon=sweep.horizon), start=sweep.first_rollout(chunk)))
    motion = sweep.motions[chunk.motion]
    about = {"motion": motion.name, "scene": motion.scene, "task": motion.task}
    return {
        "rollouts": [{"rollout": number, **about, **rollout_row(rollout, execution)} for number, rollout in rollouts],
        "contacts": [row for number, rollout in rollouts for row in contact_rows(number, rollout)],
    }


def execution_of(sweep: Sweep, motion: int) -> Execution:
    """Return the healthy execution of a motion of a planned sweep."""
    what = sweep.motions[motion]
    if what.trajectory is None:
        raise SettingError(f"trajectory of motion {what.name!r}", None, "a trajectory; use Sweep.planned()")
    settings = sweep.settings if what.grasp is None else replace(sweep.settings, grasp=what.grasp)
    comers = tuple(fault for fault in map(fault_of, sweep.faults) if isinstance(fault, Disturbance) and fault.visitor())
    return _execution(what.scene, what.task, settings, what.trajectory.to_json(), comers)


def jobs_of(sweep: Sweep, motion: int, fault: int) -> tuple[RolloutRequest, ...]:
    """Return the jobs of all rollouts of a fault on a motion."""
    document = json.dumps(dict(sweep.faults[fault]), sort_keys=True)
    return _jobs(document, execution_of(sweep, motion).duration, sweep.rollouts, sweep.seed)


# Cached for all rollouts of a fault on a motion: with a million of them, making the jobs takes longer than a chunk.
@lru_cache(maxsize=1)
def _jobs(fault: str, duration: float, rollouts: int, seed: int) -> tuple[RolloutRequest, ...]:
    return make_requests([fault_of(json.loads(fault))], duration, n=rollouts, seed=seed)


# Cached by value, since a worker may get a new copy of the sweep with every chunk. Consecutive chunks share a motion,
# so a small cache suffices.
@lru_cache(maxsize=2)
def _execution(
    scene: str, task: str | None, settings: SimSettings, trajectory: str, comers: tuple[Fault, ...]
) -> Execution:
    return execute(Trajectory.from_json(trajectory), _world(scene, task, settings, comers))


@lru_cache(maxsize=2)
def _world(scene: str, task: str | None, settings: SimSettings, comers: tuple[Fault, ...]) -> World:
    found = scene_of(scene, task)
    for fault in comers:
        found = scene_with_intruder(fault, found)
    return build_world(found, settings)
