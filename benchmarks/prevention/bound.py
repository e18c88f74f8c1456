"""The bound of prevention: many motions of one task, and the harm that the best of them prevents.

A motion is chosen on one set of failures and judged on another one, so that luck in the choice does not count. The
model's predictions for all motions tell whether the model, the search or the weight keeps the planner from the best
one. One line of JSON per task.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np

import failbench as fb
import graceful_plan as gp
from benchmarks import report, suite
from benchmarks.prevention.bound_record import (
    DEFAULT,
    DISTINCT,
    LONG_SIZES,
    MOST,
    NAMED,
    OTHER_SPEEDS,
    PLANNERS,
    PRIORS,
    SECONDS,
    SEEDS,
    SIZES,
    SPEED,
    TASKS,
    WEIGHTS,
    Array,
    Bound,
    BoundJob,
    Modelled,
    at_speed,
    name_of,
)
from benchmarks.prevention.bound_tables import bound_targets, tables
from benchmarks.prevention.runs import NONE, SEED, kinds, least_severity
from benchmarks.store import read_lines, tasks_left
from failbench import ExecutionRefused, SimSettings
from failbench.fault.fault import Fault
from failbench.rollouts.sampling import make_requests

PLACES = 50
"""Positions along a motion that are compared."""
MEASURED = f"""\
How much less harm could any choice among many motions do? Each task is planned in {SECONDS:g} s per call with the
default, the service and the arm prior at w = 0.3, 1 and 3, with other seeds, planners and speeds. Each call returns up
to {DISTINCT} distinct motions (`candidates={DISTINCT}`), of which up to {MOST} a task count. Every motion fails in the
same ways. "Best": the motion with the least harm per executed task on some failures. It is judged on other failures, as
all motions of the tables are. **Share of the attainable**: the relative reduction of harm per task against w = 0,
summed over the tasks, over that of the best motion. "At the same speed": over that of the best motion among those at
{SPEED:g} of the velocity limits, the speed of the named motions. The choice of the best is noisy, so shares may exceed
1. Intervals (95 %) come from resampled tasks. Harm and failures are those of `prevention`, damage to the carried object
included; "others only" leaves it out.
"""


def do_bound(job: BoundJob) -> Bound:
    """Plan a task in all ways, choose the best motion on some failures, and judge it on others."""
    task = suite.task(job.task)
    executions = _executed(dict(islice(_planned(task), MOST)), task)
    motions = {name: execution.trajectory for name, execution in executions.items()}
    first: dict[str, dict[str, float]] = {}
    second: dict[str, dict[str, float]] = {}
    others: dict[str, dict[str, float]] = {}
    best: dict[str, str] = {}
    best_at_speed: dict[str, str] = {}
    for kind, (choosing, judging) in job.sizes.items() if {NONE, DEFAULT} <= motions.keys() else ():
        faults = kinds(task)[kind]
        first[kind] = {name: _harm(one, faults, choosing, SEED + 1)[0] for name, one in executions.items()}
        ranked = sorted(motions, key=lambda name: first[kind][name] * motions[name].duration)
        best[kind] = ranked[0]
        best_at_speed[kind] = next(name for name in ranked if at_speed(name))
        second[kind], others[kind] = {}, {}
        for name in dict.fromkeys([*NAMED, best[kind], best_at_speed[kind]]):
            if name in executions:
                second[kind][name], others[kind][name] = _harm(executions[name], faults, judging, SEED + 2)
    return Bound(
        task=job.task,
        duration={name: motion.duration for name, motion in motions.items()},
        modelled=_modelled(motions, task) if first else {},
        first=first,
        second=second,
        others=others,
        best=best,
        best_at_speed=best_at_speed,
    )


def _harm(execution: fb.Execution, faults: Sequence[Fault], n: int, seed: int) -> tuple[float, float]:
    """Return the harm per failure, and without the loss of the carried object; one hit counts if there is none."""
    jobs = make_requests(faults, execution.trajectory.duration, n=n, seed=seed)
    rollouts = [one for one in fb.run_rollouts(execution, jobs, threads=1) if one.status == "completed"]
    scene = execution.world.scene
    least = least_severity(scene) / len(jobs)
    own = float(np.mean([fb.own_loss(one, scene) for one in rollouts]))
    whole = float(np.mean([fb.observed_impact(one, scene) for one in rollouts]))
    return max(whole, least), max(whole - own, least)


def _planned(task: gp.Task) -> Iterator[tuple[str, gp.Trajectory]]:
    """Yield motions by name."""
    gp.prepare(task.scene)

    def planned(impact: gp.ImpactCost, w: float, **settings: object) -> gp.PlanResult:
        objective = gp.Objective(impact=impact, w=w)
        asked = {"time_limit": SECONDS, "seed": SEED, "speed": SPEED, **settings}
        return gp.plan(task.start, task.goal, task.scene, objective=objective, **asked)  # type: ignore[arg-type]

    usual = PRIORS["default"]
    calls = {NONE: (usual, 0.0, {})}
    calls |= {name_of(prior, w): (impact, w, {}) for w in WEIGHTS for prior, impact in PRIORS.items()}
    calls |= {f"w = 1, seed {seed}": (usual, 1.0, {"seed": SEED + seed}) for seed in SEEDS}
    calls |= {f"w = 1, {planner}": (usual, 1.0, {"planner": planner}) for planner in PLANNERS}
    calls |= {f"w = 0.3, speed {speed:g}": (usual, 0.3, {"speed": speed}) for speed in OTHER_SPEEDS}
    results = {
        name: planned(impact, w, candidates=DISTINCT if w > 0.0 else 1, **settings)
        for name, (impact, w, settings) in calls.items()
    }
    for name, result in results.items():
        if result.trajectory is not None:
            yield name, result.trajectory
    for k in range(1, DISTINCT):
        for name, result in results.items():
            if k < len(result.candidates):
                yield f"{name}, candidate {k}", result.candidates[k].unwrap()


def _modelled(motions: Mapping[str, gp.Trajectory], task: gp.Task) -> dict[str, Modelled]:
    places = {name: _places(motion, task.scene) for name, motion in motions.items()}
    around, end = places[DEFAULT], motions[DEFAULT].q[-1]
    found: dict[str, Modelled] = {}
    for name, motion in motions.items():
        costs = {
            prior: gp.evaluate(motion, task.scene, gp.Objective(impact=impact, w=1.0))
            for prior, impact in PRIORS.items()
        }
        found[name] = Modelled(
            motion=costs["default"].motion,
            impact={prior: cost.impact for prior, cost in costs.items()},
            height=float(places[name][:, 2].mean()),
            aside=float(np.linalg.norm((places[name] - around)[:, :2], axis=1).max()),
            end=float(np.linalg.norm(motion.q[-1] - end)),
        )
    return found


def _places(motion: gp.Trajectory, scene: gp.Scene) -> Array:
    """Return the object's (or the tool's) positions in W at equal shares of the duration [n, 3] [m]."""
    times = np.linspace(motion.t[0], motion.t[-1], PLACES)
    batch = gp.StateBatch(scene, np.stack([np.interp(times, motion.t, q) for q in motion.q.T], axis=1))
    return (batch.tool_poses if scene.carried is None else batch.object_poses)[:, :3, 3]


def _executed(motions: Mapping[str, gp.Trajectory], task: gp.Task) -> dict[str, fb.Execution]:
    """Return the executions of the motions that the healthy robot can execute without harm.

    Fingers hold the object, or a weld if they lose it at w = 0 or with the default.
    """
    can: dict[str, fb.Execution] = {}
    for grasp in ("fingers", "weld"):
        world = fb.build_world(task.scene, SimSettings(grasp=grasp))
        tried = {name: _execution(motion, world) for name, motion in motions.items()}
        can = {name: one for name, one in tried.items() if one is not None}
        if {NONE, DEFAULT} <= can.keys():
            break
    return can


def _execution(motion: gp.Trajectory, world: fb.World) -> fb.Execution | None:
    """Return the execution of a motion; None if the healthy robot cannot execute it or does harm."""
    try:
        execution = fb.execute(motion, world)
    except ExecutionRefused:
        return None
    return execution if execution.healthy.harmless else None


def bound_sizes(options: suite.Options) -> Mapping[str, tuple[int, int]]:
    """Return the numbers of failures of each kind: to choose, and to judge."""
    return options.pick(SIZES, quick={"drops": (8, 8), "mixed": (19, 19)}, long=LONG_SIZES)


def bound_jobs(file: Path, options: suite.Options) -> list[BoundJob]:
    """Return the jobs that are left."""
    return [BoundJob(task=name, sizes=bound_sizes(options)) for name in tasks_left(file, TASKS, options)]


def read_bounds(file: Path) -> list[Bound]:
    """Return the finished tasks in which w = 0 and the default motion can be executed."""
    found = (
        replace(Bound(**line), modelled={name: Modelled(**one) for name, one in line["modelled"].items()})
        for line in read_lines(file)
    )
    return [one for one in found if {NONE, DEFAULT} <= one.duration.keys()]


def bound_table(found: Sequence[Bound], sizes: Mapping[str, tuple[int, int]]) -> str:
    """Return the document of the bound."""
    if not found:
        return f"{MEASURED}\nNo task is finished yet.\n"
    unseen = sum(one.task.split("/")[0] in suite.unseen_scenes() for one in found)
    counts = [len(one.duration) for one in found]
    told = "; ".join(f"{kind}: {a} failures of each motion choose, {b} judge" for kind, (a, b) in sizes.items())
    parts = [
        MEASURED,
        f"{len(found)} of {len(TASKS)} tasks, {unseen} of them unseen, with {min(counts)} to {max(counts)} motions."
        f" {told}.\n",
        report.targets(bound_targets(found)),
        *tables(found, sizes),
    ]
    return "\n".join(parts)
