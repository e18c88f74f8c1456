"""Motions along which robots fail, and many failures along many motions: simulated, or taken from a file."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path as FilePath
from typing import Any

import numpy as np

import graceful_plan as gp
from failbench.basics.errors import ExecutionRefused
from failbench.calibrations.failures import DROP, Failures, fail_along, read_failures, write_failures
from failbench.calibrations.varied import Variation
from failbench.fault.fault import Fault
from failbench.rollouts.sampling import MOST, check_whole
from graceful_plan import GracefulPlanError, Path, Scene, Task, Trajectory
from graceful_plan.array_types import Float
from graceful_plan.exceptions import UnknownNameError

Array = np.ndarray

Progress = Callable[[int, int], None]
"""Called with the number of motions done and the number of all."""

_VIA_SPREAD = 0.35
"""How far via points are from the straight way [rad], standard deviation of each joint."""
_VIA_ROOM = 0.01
"""Least clearance at a via point [m]."""
_VIA_TRIES = 30


@dataclass(frozen=True, kw_only=True)
class MotionKind:
    """How a motion along which things fail is made.

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
            constraints=(),  # what is spilt is what the models are about
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
        if gp.verify(motion, scene, constraints=()).passed:
            return motion
    return None


def _planned(start: Array, goal: Array, scene: Scene, kind: MotionKind, seed: int) -> Float[Array, "point nq"]:
    result = gp.plan(
        start, goal, scene, w=0.0, planner="rrt_connect", iterations=kind.iterations, seed=seed, constraints=()
    )
    result.unwrap()
    assert result.path is not None
    return result.path.q


def _via(scene: Scene, start: Array, goal: Array, rng: np.random.Generator) -> Float[Array, " nq"] | None:
    low, high = scene.limits.position.T
    near = start + rng.uniform(0.2, 0.8) * (goal - start) + rng.normal(scale=_VIA_SPREAD, size=len(start))
    via = np.clip(near, low + 0.02, high - 0.02)
    return via if gp.clearance(scene, via) >= _VIA_ROOM else None


KINDS = (
    MotionKind(way="rrt_connect", speed=0.6),
    MotionKind(way="auto", w=0.1, speed=0.6, iterations=300),
    MotionKind(way="auto", w=0.3, speed=0.5, iterations=300),
    MotionKind(way="auto", w=1.0, speed=0.8, iterations=300),
    MotionKind(way="via", speed=0.3),
    MotionKind(way="via", speed=0.7),
    MotionKind(way="via", speed=1.0),
)
"""Motions along which a model of failures is fitted and judged: planned with regard for failures, without, and not.

Planning seeks out what the model thinks harmless, so that its errors there are what a user suffers."""


@dataclass(frozen=True, kw_only=True)
class FailureJob:
    """The failures along one motion that is still to be made.

    Args:
        load: Loads a scene by name; a function of a module, so that other processes find it.
        scene: Name of the scene.
        task: Name of the task.
        kind: How the motion is made.
        faults: What fails.
        n: Number of failures.
        seed: Of everything random.
        horizon: How long is simulated after each onset [s].
        variation: How what is carried differs from what the scene says.
    """

    load: Callable[[str], Scene]
    scene: str
    task: str
    kind: MotionKind
    faults: tuple[Fault, ...]
    n: int
    seed: int
    horizon: float = 1.0
    variation: Variation | None = None


def failure_jobs(
    load: Callable[[str], Scene],
    scenes: Sequence[str],
    faults: Sequence[Fault] = DROP,
    *,
    n: int,
    seed: int = 0,
    kinds: Sequence[MotionKind] = KINDS,
    repeats: int = 1,
    horizon: float = 1.0,
    variation: Variation | None = None,
) -> list[FailureJob]:
    """Return jobs for every kind of motion on every task of some scenes that carries something.

    Args:
        load: Loads a scene by name.
        scenes: Names of scenes.
        faults: What fails.
        n: Failures along each motion.
        seed: Of everything random; each motion gets its own.
        kinds: Of motions.
        repeats: Motions of each kind.
        horizon: How long is simulated after each onset [s].
        variation: How what is carried differs from what the scenes say.
    """
    tasks = [
        (scene, name) for scene in scenes for name, task in load(scene).tasks.items() if task.object_name is not None
    ]
    todo = [(scene, task, kind) for scene, task in tasks for kind in kinds for _ in range(repeats)]
    seeds = np.random.default_rng(seed).integers(2**31, size=len(todo))
    return [
        FailureJob(
            load=load,
            scene=scene,
            task=task,
            kind=kind,
            faults=tuple(faults),
            n=n,
            seed=int(s),
            horizon=horizon,
            variation=variation,
        )
        for (scene, task, kind), s in zip(todo, seeds, strict=True)
    ]


def do_job(job: FailureJob) -> Failures | str:
    """Make the motion and fail along it; where that cannot be done, return why."""
    task, about = job.load(job.scene).tasks[job.task], f"{job.scene}/{job.task}, {job.kind}"
    motion = make_motion(task, job.kind, job.seed)
    if motion is None:
        return f"{about}: no motion"
    try:
        failures = fail_along(
            motion,
            task.scene,
            job.faults,
            n=job.n,
            seed=job.seed,
            task=job.task,
            horizon=job.horizon,
            variation=job.variation,
        )
    except ExecutionRefused as error:
        return f"{about}: {error}"
    return replace(failures, scene=job.scene, motion=str(job.kind))


# --- many ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class FailureSettings:
    """How much is to fail in each scene.

    Args:
        n: Failures along each motion.
        repeats: Motions of each kind for each task.
        seed: Of everything random. What comes out depends on it alone, not on `processes`.
        processes: How many to work in.
        variation: How what is carried differs from what the scenes say, along every second motion: what the scenes say
            counts, too.
    """

    n: int = 30
    repeats: int = 2
    seed: int = 0
    processes: int = 1
    variation: Variation | None = None

    def __post_init__(self) -> None:
        check_whole("n", self.n, 1, MOST)
        check_whole("repeats", self.repeats, 1, MOST)


def generate(
    scenes: Sequence[str],
    faults: Sequence[Fault] = DROP,
    settings: FailureSettings | None = None,
    *,
    load: Callable[[str], Scene] = gp.load_scene,
    progress: Progress | None = None,
) -> tuple[list[Failures], list[str]]:
    """Let a robot fail along several motions for every task of some scenes that carries something.

    Args:
        scenes: Names of scenes.
        faults: What fails.
        settings: How often; see there for what is usual.
        load: Loads a scene by name; a function of a module.
        progress: Called after each motion.

    Returns:
        What happened, and why some motions have none.
    """
    settings = FailureSettings() if settings is None else settings
    jobs = failure_jobs(load, scenes, faults, n=settings.n, seed=settings.seed, repeats=settings.repeats)
    jobs = [replace(job, variation=settings.variation if i % 2 else None) for i, job in enumerate(jobs)]
    return do_all(jobs, settings.processes, progress)


def do_all(
    jobs: Sequence[FailureJob], processes: int = 1, progress: Progress | None = None
) -> tuple[list[Failures], list[str]]:
    """Do jobs in so many processes; return what happened, in their order, and why some motions have no failures."""
    found: list[Failures] = []
    refused: list[str] = []

    def take(outcome: Failures | str) -> None:
        found.append(outcome) if isinstance(outcome, Failures) else refused.append(outcome)
        if progress is not None:
            progress(len(found) + len(refused), len(jobs))

    if processes <= 1:
        for job in jobs:
            take(do_job(job))
    else:
        # Spawned, not forked: libraries below have threads.
        with multiprocessing.get_context("spawn").Pool(processes) as pool:
            for outcome in pool.imap(do_job, jobs):
                take(outcome)
    return found, refused


def fetch(
    scenes: Sequence[str],
    faults: Callable[[], Sequence[Fault]],
    settings: FailureSettings,
    *,
    kept: FilePath | None = None,
    progress: Progress | None = None,
) -> tuple[list[Failures], dict[str, Any]]:
    """Let a robot fail in bundled scenes, or take failures from a file; see `generate`.

    Args:
        scenes: Names of bundled scenes.
        faults: Returns what fails; asked only if something is to be simulated.
        settings: How often.
        kept: File that the failures are kept in, or taken from if it is there. Then only those in `scenes` count.
        progress: Called after each motion.

    Returns:
        What happened, and what a record should say of where it comes from.

    Raises:
        UnknownNameError: If there is no such scene.
        FormatError: If the file is there and holds something else.
    """
    for name in scenes:
        if name not in gp.scenes():
            raise UnknownNameError("scene", name, gp.scenes())
    if kept is not None and kept.exists():
        return [part for part in read_failures(kept) if part.scene in scenes], {"failures_from": kept.name}
    failures, refused = generate(scenes, faults(), settings, progress=progress)
    if kept is not None:
        write_failures(kept, failures)
    varied = {} if settings.variation is None else {"every_second_motion_varied": asdict(settings.variation)}
    return failures, {"motions_without": refused, **varied}
