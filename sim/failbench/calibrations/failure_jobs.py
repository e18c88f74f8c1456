"""Motions for calibration, and failures along many motions, simulated or read from a file."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path as FilePath
from typing import Any

import numpy as np

import graceful_plan as gp
from failbench.basics.errors import ExecutionRefused
from failbench.calibrations.failures import DROP, Failures, read_failures, simulate_failures, write_failures
from failbench.calibrations.varied import Variation
from failbench.fault.fault import Fault
from failbench.rollouts.sampling import MOST, check_whole
from graceful_plan import GracefulPlanError, Path, Scene, Task, Trajectory
from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import UnknownNameError
from graceful_plan.path import plain_numbers

Progress = Callable[[int, int], None]
"""Called with the numbers of finished and of all motions."""

_VIA_SPREAD = 0.35
"""Standard deviation of via points from the straight path, for each joint [rad]."""
_VIA_ROOM = 0.01
"""Least clearance at a via point [m]."""
_VIA_TRIES = 30


@dataclass(frozen=True, kw_only=True)
class MotionKind:
    """Settings for a motion along which failures are simulated.

    Args:
        way: A planner, or "via": over a random configuration near the straight path.
        w: Safety weight of the planner; ignored for "via".
        speed: Fraction of the velocity limits.
        iterations: Iterations of the planner.
    """

    way: str
    w: float = 0.0
    speed: float = 0.5
    iterations: int = 100

    def __str__(self) -> str:
        return f"{self.way}, w {self.w:g}, speed {self.speed:g}"


def make_motion(task: Task, kind: MotionKind, seed: int) -> Trajectory | None:
    """Plan a motion for a task; return None if the planner finds none.

    Args:
        task: The task.
        kind: Settings of the motion.
        seed: Seed of all random numbers. The result depends on it alone, since planning is limited by iterations.
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
            constraints=(),  # spilling motions are allowed, since the models are about spills
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
    return via if gp.clearance(via, scene) >= _VIA_ROOM else None


KINDS = (
    MotionKind(way="rrt_connect", speed=0.6),
    MotionKind(way="auto", w=0.1, speed=0.6, iterations=300),
    MotionKind(way="auto", w=0.3, speed=0.5, iterations=300),
    MotionKind(way="auto", w=1.0, speed=0.8, iterations=300),
    MotionKind(way="via", speed=0.3),
    MotionKind(way="via", speed=0.7),
    MotionKind(way="via", speed=1.0),
)
"""Motions for fitting and evaluating failure models: planned with and without impact costs, or random.

Planning seeks out motions that the model considers harmless, so the model's errors there are those that users meet."""


@dataclass(frozen=True, kw_only=True)
class FailureJob:
    """Specification of the failures along one motion, which is planned later.

    Args:
        load: Loads a scene by name; a module-level function, so that other processes can import it.
        scene: Name of the scene.
        task: Name of the task.
        kind: Settings of the motion.
        faults: Faults to simulate.
        n: Number of failures.
        seed: Seed of all random numbers.
        horizon: Simulated time after each onset [s].
        variation: Deviation of the carried object from the scene's; None for none.
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
    """Return jobs for every kind of motion and every task with a carried object.

    Args:
        load: Loads a scene by name.
        scenes: Names of the scenes.
        faults: Faults to simulate.
        n: Number of failures along each motion.
        seed: Seed of all random numbers; each motion gets its own seed.
        kinds: Kinds of motions.
        repeats: Number of motions of each kind.
        horizon: Simulated time after each onset [s].
        variation: Deviation of the carried objects from the scenes'; None for none.
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


def run_job(job: FailureJob) -> Failures | str:
    """Plan the motion and simulate its failures; return the reason as text if that is not possible."""
    task, about = job.load(job.scene).tasks[job.task], f"{job.scene}/{job.task}, {job.kind}"
    motion = make_motion(task, job.kind, job.seed)
    if motion is None:
        return f"{about}: no motion"
    try:
        failures = simulate_failures(
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
    """Numbers of failures and motions.

    Args:
        n: Number of failures along each motion.
        repeats: Number of motions of each kind for each task.
        seed: Seed of all random numbers. Results depend on it alone, not on `processes`.
        processes: Number of processes.
        variation: Deviation of the carried objects from the scenes', applied along every second motion.
    """

    n: int = 30
    repeats: int = 2
    seed: int = 0
    processes: int = 1
    variation: Variation | None = None

    def __post_init__(self) -> None:
        plain_numbers(self)
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
    """Simulate failures along several motions for every task with a carried object.

    Args:
        scenes: Names of the scenes.
        faults: Faults to simulate.
        settings: Numbers of failures and motions; the defaults if None.
        load: Loads a scene by name; a module-level function.
        progress: Called after each motion.

    Returns:
        The failures, and the reasons why some motions have none.
    """
    settings = FailureSettings() if settings is None else settings
    jobs = failure_jobs(load, scenes, faults, n=settings.n, seed=settings.seed, repeats=settings.repeats)
    jobs = [replace(job, variation=settings.variation if i % 2 else None) for i, job in enumerate(jobs)]
    return run_jobs(jobs, settings.processes, progress)


def run_jobs(
    jobs: Sequence[FailureJob], processes: int = 1, progress: Progress | None = None
) -> tuple[list[Failures], list[str]]:
    """Run jobs in several processes; return the failures in their order, and reasons why motions have none."""
    found: list[Failures] = []
    refused: list[str] = []

    def take(outcome: Failures | str) -> None:
        found.append(outcome) if isinstance(outcome, Failures) else refused.append(outcome)
        if progress is not None:
            progress(len(found) + len(refused), len(jobs))

    if processes <= 1:
        for job in jobs:
            take(run_job(job))
    else:
        # Spawned, not forked, since the libraries start threads.
        with multiprocessing.get_context("spawn").Pool(processes) as pool:
            for outcome in pool.imap(run_job, jobs):
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
    """Simulate failures in bundled scenes as `generate` does, or read them from a file.

    Args:
        scenes: Names of bundled scenes.
        faults: Returns the faults to simulate; called only if needed.
        settings: Numbers of failures and motions.
        kept: File to store the failures in, or to read them from if it exists. Only failures in `scenes` are used.
        progress: Called after each motion.

    Returns:
        The failures, and their provenance for the record.

    Raises:
        UnknownNameError: If there is no such scene.
        FormatError: If the file exists and holds something else.
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
