"""What is dropped, and what it hits: the events that a model of drops is fitted on and judged by.

For each rollout: configuration and velocity at the onset, and for every entity whether the carried object touched it.
What entities do to each other afterwards is not counted, nor what the object touches in the healthy run.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path as FilePath
from typing import Any
from zipfile import BadZipFile

import numpy as np

import graceful_plan as gp
from failbench.errors import ExecutionRefused
from failbench.execution import Execution, execute
from failbench.faults.end_effector import GripperFailure
from failbench.records import Rollout
from failbench.rollout import run
from failbench.sampling import make_jobs
from failbench.world import SimSettings, build_world
from graceful_plan import GracefulPlanError, Path, Scene, SettingError, Task, Trajectory
from graceful_plan.array_types import Bool, Float
from graceful_plan.exceptions import FormatError

Array = np.ndarray

_SCHEMA, _VERSION = "failbench.drops", 1
_VIA_SPREAD = 0.35
"""How far via points are from the straight way [rad], standard deviation of each joint."""
_VIA_ROOM = 0.01
"""Least clearance at a via point [m]."""
_VIA_TRIES = 30


@dataclass(frozen=True, kw_only=True)
class MotionKind:
    """How a motion for drops is made.

    Args:
        way: A planner, or "via": over a random configuration near the straight way.
        w: Safety weight of the planner; of none for "via".
        speed: Fraction of the velocity limits.
        iterations: Of the planner.
    """

    way: str
    w: float = 0.0
    speed: float = 0.5
    iterations: int = 100

    def __str__(self) -> str:
        return f"{self.way}, w {self.w:g}, speed {self.speed:g}"


@dataclass(frozen=True, kw_only=True, eq=False)
class Drops:
    """The drops along one motion. Made by `drop_along`.

    | field      | meaning                                                                          | shape       |
    |------------|----------------------------------------------------------------------------------|-------------|
    | scene      | name of the scene                                                                |             |
    | task       | name of the task, whose object is dropped                                        |             |
    | motion     | how the motion was made, if it is known                                          |             |
    | grasp      | what held the object: "fingers" or "weld"                                        |             |
    | entities   | names of the entities, in the order of the scene                                 | entity      |
    | categories | their classes                                                                    | entity      |
    | counted    | whether the entity counts: not one that the healthy run touches, too             | entity      |
    | q          | configuration at the onset [rad or m]                                            | n nq        |
    | qd         | velocity there                                                                   | n nq        |
    | hit        | whether the object touched the entity                                            | n entity    |
    | lost       | rollouts that diverged and are left out                                          |             |
    """

    scene: str
    task: str
    motion: str
    grasp: str
    entities: tuple[str, ...]
    categories: tuple[str, ...]
    counted: Bool[Array, " entity"]
    q: Float[Array, "n nq"]
    qd: Float[Array, "n nq"]
    hit: Bool[Array, "n entity"]
    lost: int = 0

    def __len__(self) -> int:
        return len(self.q)


def make_motion(task: Task, kind: MotionKind, seed: int) -> Trajectory | None:
    """Plan a motion for a task; None if none is found.

    Args:
        task: What to do.
        kind: How.
        seed: Of everything random; with iterations instead of time, it decides everything.
    """
    if kind.way != "via":
        result = gp.plan(
            task.start,
            task.goal,
            task.scene,
            w=kind.w,
            planner=kind.way,
            iterations=kind.iterations,
            seed=seed,
            speed=kind.speed,
        )
        return result.trajectory
    rng, scene = np.random.default_rng(seed), task.scene
    for _ in range(_VIA_TRIES):
        goal = task.goal[rng.integers(len(task.goal))]
        via = _via(scene, task.start, goal, rng)
        if via is None:
            continue
        try:
            parts = [_planned(a, b, scene, kind, seed) for a, b in ((task.start, via), (via, goal))]
            motion = gp.retime(Path(np.vstack(parts)), scene.limits, scene.joints, speed=kind.speed)
        except GracefulPlanError:
            continue
        if gp.verify(motion, scene).passed:
            return motion
    return None


def _planned(start: Array, goal: Array, scene: Scene, kind: MotionKind, seed: int) -> Float[Array, "point nq"]:
    result = gp.plan(start, goal, scene, w=0.0, planner="rrt_connect", iterations=kind.iterations, seed=seed)
    result.unwrap()
    assert result.path is not None
    return result.path.q


def _via(scene: Scene, start: Array, goal: Array, rng: np.random.Generator) -> Float[Array, " nq"] | None:
    low, high = scene.limits.position.T
    near = start + rng.uniform(0.2, 0.8) * (goal - start) + rng.normal(scale=_VIA_SPREAD, size=len(start))
    via = np.clip(near, low + 0.02, high - 0.02)
    return via if gp.clearance(scene, via) >= _VIA_ROOM else None


def drop_along(
    motion: Trajectory,
    scene: Scene,
    *,
    n: int,
    seed: int = 0,
    task: str = "",
    horizon: float = 1.0,
    threads: int = 1,
) -> Drops:
    """Let the gripper fail many times along a motion, and tell what the carried object hits.

    The object is held by the fingers where they can, otherwise by a weld.

    Args:
        motion: What is carried out.
        scene: Where, with the object attached.
        n: Number of drops.
        seed: Of everything random.
        task: Name of the task, for the record.
        horizon: How long is simulated after the onset [s].
        threads: Of the simulation; the result does not depend on it.

    Raises:
        ExecutionRefused: If the healthy robot cannot carry the motion out in either way.
        SettingError: If nothing is carried.
    """
    if scene.carried is None:
        raise SettingError("scene", scene.name, "one with an object in the gripper, such as task.scene")
    execution = _held(motion, scene)
    jobs = make_jobs([GripperFailure(degree="critical")], execution.duration, n=n, seed=seed)
    rollouts = run(execution, jobs, horizon=horizon, threads=threads)
    completed = [rollout for rollout in rollouts if rollout.status == "completed"]
    # What a planner would know: where the motion is to be, not where the servos have brought the arm.
    state = motion.at(motion.t[0] + np.array([rollout.onset for rollout in completed]))
    return Drops(
        scene=scene.name,
        task=task,
        motion="",
        grasp=execution.world.settings.grasp,
        entities=tuple(scene.entities),
        categories=tuple(entity.category for entity in scene.entities.values()),
        counted=np.array([("carried", name) not in execution.baseline for name in scene.entities], dtype=bool),
        q=state.q,
        qd=state.qd,
        hit=_hits(completed, tuple(scene.entities)),
        lost=len(rollouts) - len(completed),
    )


def _held(motion: Trajectory, scene: Scene) -> Execution:
    try:
        return execute(motion, build_world(scene, SimSettings(grasp="fingers")))
    except ExecutionRefused:
        return execute(motion, build_world(scene, SimSettings(grasp="weld")))


def _hits(rollouts: Sequence[Rollout], entities: tuple[str, ...]) -> Bool[Array, "n entity"]:
    hit = np.zeros((len(rollouts), len(entities)), dtype=bool)
    column = {name: i for i, name in enumerate(entities)}
    for row, rollout in zip(hit, rollouts, strict=True):
        for event in rollout.events:
            if event.striker == "carried" and not event.secondary:
                row[column[event.entity]] = True
    return hit


# --- many ------------------------------------------------------------------------------------------------------------

KINDS = (
    MotionKind(way="rrt_connect", speed=0.6),
    MotionKind(way="anytime", w=0.5, speed=0.4),
    MotionKind(way="via", speed=0.3),
    MotionKind(way="via", speed=0.7),
    MotionKind(way="via", speed=1.0),
)
"""Motions along which a model of drops is fitted and judged: planned with and without regard for failures, and none."""


@dataclass(frozen=True, kw_only=True)
class DropJob:
    """The drops along one motion that is still to be made.

    Args:
        load: Loads a scene by name; a function of a module, so that other processes find it.
        scene: Name of the scene.
        task: Name of the task.
        kind: How the motion is made.
        n: Number of drops.
        seed: Of everything random.
        horizon: How long is simulated after each onset [s].
    """

    load: Callable[[str], Scene]
    scene: str
    task: str
    kind: MotionKind
    n: int
    seed: int
    horizon: float = 1.0


def drop_jobs(
    load: Callable[[str], Scene],
    scenes: Sequence[str],
    *,
    n: int,
    seed: int = 0,
    kinds: Sequence[MotionKind] = KINDS,
    repeats: int = 1,
    horizon: float = 1.0,
) -> list[DropJob]:
    """Return jobs for every kind of motion on every task of some scenes that carries something.

    Args:
        load: Loads a scene by name.
        scenes: Names of scenes.
        n: Drops along each motion.
        seed: Of everything random; each motion gets its own.
        kinds: Of motions.
        repeats: Motions of each kind.
        horizon: How long is simulated after each onset [s].
    """
    tasks = [
        (scene, name) for scene in scenes for name, task in load(scene).tasks.items() if task.object_name is not None
    ]
    todo = [(scene, task, kind) for scene, task in tasks for kind in kinds for _ in range(repeats)]
    seeds = np.random.default_rng(seed).integers(2**31, size=len(todo))
    return [
        DropJob(load=load, scene=scene, task=task, kind=kind, n=n, seed=int(s), horizon=horizon)
        for (scene, task, kind), s in zip(todo, seeds, strict=True)
    ]


def do_job(job: DropJob) -> Drops | str:
    """Make the motion and drop along it; where that cannot be done, return why."""
    task, about = job.load(job.scene).tasks[job.task], f"{job.scene}/{job.task}, {job.kind}"
    motion = make_motion(task, job.kind, job.seed)
    if motion is None:
        return f"{about}: no motion"
    try:
        drops = drop_along(motion, task.scene, n=job.n, seed=job.seed, task=job.task, horizon=job.horizon)
    except ExecutionRefused as error:
        return f"{about}: {error}"
    return replace(drops, scene=job.scene, motion=str(job.kind))


# --- files -----------------------------------------------------------------------------------------------------------

_TEXTS = ("scene", "task", "motion", "grasp", "entities", "categories", "lost")
_ARRAYS = ("counted", "q", "qd", "hit")


def write_drops(file: str | FilePath, drops: Iterable[Drops]) -> None:
    """Write drops into one compressed NumPy file."""
    arrays: dict[str, Array] = {}
    about: list[dict[str, Any]] = []
    for i, part in enumerate(drops):
        about.append({name: getattr(part, name) for name in _TEXTS})
        arrays |= {f"{i}.{name}": getattr(part, name) for name in _ARRAYS}
    document = {"schema": _SCHEMA, "version": _VERSION, "drops": about}
    with FilePath(file).open("wb") as out:
        np.savez_compressed(out, about=np.array(json.dumps(document)), **arrays)  # pyright: ignore[reportArgumentType]


def read_drops(file: str | FilePath) -> list[Drops]:
    """Read what `write_drops` wrote.

    Raises:
        FormatError: If it is something else.
    """
    try:
        with FilePath(file).open("rb") as source, np.load(source, allow_pickle=False) as data:
            document = json.loads(str(data["about"]))
            if (document["schema"], document["version"]) != (_SCHEMA, _VERSION):
                raise FormatError(str(file), f"not {_SCHEMA} of version {_VERSION}")
            return [
                Drops(
                    **{name: tuple(x) if isinstance(x, list) else x for name, x in about.items()},
                    **{name: data[f"{i}.{name}"] for name in _ARRAYS},
                )
                for i, about in enumerate(document["drops"])
            ]
    except FormatError:
        raise
    except (ValueError, KeyError, TypeError, OSError, EOFError, BadZipFile) as error:
        raise FormatError(str(file), f"no file of drops: {error}") from None
