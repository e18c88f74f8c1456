"""Motions that carry vessels with contents, planned with and without the default constraints, and executed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

import failbench as fb
import graceful_plan as gp
from benchmarks import suite
from failbench import ExecutionRefused, SimSettings
from failbench.recording.spill import kept_volume
from graceful_plan.constraints.contents import KeepContents
from graceful_plan.judge.rule_checks import rule_checks
from graceful_plan.scene.rules.vessel import Vessel, find_vessel

DEFAULT, NOTHING = "default", "[]"
"""Values of `constraints`: the default ones, and none."""
WEIGHTS = (0.0, 0.3, 1.0)
FILLS = (0.5, 0.7, 0.8, 0.9, 0.95)
FILLED = ("desk/bring_coffee", "stove/carry_bucket")
"""Tasks whose vessels are filled to each of `FILLS`: a narrow one and a wide one."""


@dataclass(frozen=True, kw_only=True)
class ContentsJob:
    """A motion to plan and execute.

    Args:
        task: "scene/task".
        w: Safety weight.
        seed: Of the planner.
        constraints: `DEFAULT` or `NOTHING`.
        fill: How full the vessel is; None as the scene says.
    """

    task: str
    w: float
    seed: int
    constraints: str
    fill: float | None = None


@dataclass(frozen=True, kw_only=True)
class Kept:
    """Result for a motion; NaN if there is no motion or it cannot be executed.

    Args:
        job: The job.
        status: Of the plan.
        detail: Message of the plan.
        duration: [s].
        total: J.
        seconds: Duration of the call.
        lost: Share of the contents that FailBench's healthy robot loses.
        swung: Share that the judge's pendulum leaves above the rim at worst.
        grasp: "fingers", or "weld" if the fingers lose the vessel.
        lost_grip: Message when the fingers fail; otherwise "".
        refused: Reason why the motion cannot be executed even with a weld; otherwise "".
    """

    job: ContentsJob
    status: str
    detail: str
    duration: float = float("nan")
    total: float = float("nan")
    seconds: float = float("nan")
    lost: float = float("nan")
    swung: float = float("nan")
    grasp: str = ""
    lost_grip: str = ""
    refused: str = ""


def task_names(options: suite.Options) -> list[str]:
    """Names "scene/task" of all tasks that carry a vessel with contents, bundled and in `vessels/`."""
    bundled = [name for name in suite.task_names() if find_vessel(suite.task(name).scene) is not None]
    names = suite.chosen([*bundled, *suite.vessel_task_names()], options.tasks)
    return names[:1] + names[-1:] if options.quick else names


def jobs(options: suite.Options) -> list[ContentsJob]:
    """List every motion: tasks as they are over weights, some of them over fills at the default weight.

    Seed by seed, so an interrupted run covers all tasks.
    """
    weights, seeds, fills = options.pick((WEIGHTS, 1, FILLS), quick=((0.3,), 1, (0.9,)), long=(WEIGHTS, 5, FILLS))
    asked, both = task_names(options), (DEFAULT, NOTHING)
    filled = suite.chosen(FILLED, options.tasks)[: options.pick(len(FILLED), quick=1)]
    return [
        *(
            ContentsJob(task=name, w=w, seed=seed, constraints=c)
            for seed, w, name, c in product(range(seeds), weights, asked, both)
        ),
        *(
            ContentsJob(task=name, w=0.3, seed=seed, constraints=c, fill=fill)
            for seed, name, fill, c in product(range(seeds), filled, fills, both)
        ),
    ]


def examine(job: ContentsJob) -> Kept:
    """Plan within the default time limit at full speed, and carry it out."""
    task = suite.task(job.task)
    scene = task.scene if job.fill is None else filled_scene(task, job.fill)
    constraints = None if job.constraints == DEFAULT else []
    result = gp.plan(task.start, task.goal, scene, w=job.w, seed=job.seed, constraints=constraints)
    seconds = result.stats.get("total_time", float("nan"))
    plain = Kept(job=job, status=result.status.name, detail=result.detail, seconds=seconds)
    if result.trajectory is None or result.cost is None:
        return plain
    checks = rule_checks(result.trajectory, scene, [KeepContents().rule(scene)])
    known = replace(
        plain, duration=result.trajectory.duration, total=result.cost.total, swung=max(checks["contents"].worst, 0.0)
    )
    return _carried_out(known, result, scene)


def _carried_out(known: Kept, result: gp.PlanResult, scene: gp.Scene) -> Kept:
    """Let the healthy robot do it, with fingers if they hold."""
    vessel, lost_grip, refused = _vessel(scene), "", ""
    for grasp in ("fingers", "weld"):
        world = fb.build_world(scene, SimSettings(grasp=grasp))
        try:
            states = fb.execute(result, world).states
        except ExecutionRefused as error:
            lost_grip, refused = (str(error), refused) if grasp == "fingers" else (lost_grip, str(error))
            continue
        lost = 1.0 - kept_volume(world, states) / vessel.volume
        return replace(known, lost=max(float(lost), 0.0), grasp=grasp, lost_grip=lost_grip)
    return replace(known, lost_grip=lost_grip, refused=refused)


def filled_scene(task: gp.Task, fill: float) -> gp.Scene:
    """Return the scene of a task with its vessel filled to a share of its volume."""
    scene = task.scene
    assert scene.contents is not None and task.object_name is not None
    vessel = _vessel(scene)
    litres = 1e3 * fill * float(np.pi) * vessel.radius**2 * vessel.height
    contents = replace(scene.contents, volume=litres)
    return task.world.attach(task.object_name, support=task.support, contents=contents)


def fill_of(name: str) -> float:
    """Return how full the vessel of a task is."""
    vessel = _vessel(suite.task(name).scene)
    return vessel.volume / (float(np.pi) * vessel.radius**2 * vessel.height)


def _vessel(scene: gp.Scene) -> Vessel:
    vessel = find_vessel(scene)
    assert vessel is not None
    return vessel
