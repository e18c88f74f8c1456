"""What protective stops spill: predicted by the spill model, and observed in FailBench."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

import failbench
import graceful_plan as gp
from benchmarks import report, suite
from failbench.fault.registry import ProtectiveStop
from failbench.rollouts.sampling import make_jobs
from graceful_plan.costs.fault_prior import FaultPrior
from graceful_plan.costs.models.spill.constants import StopSettings
from graceful_plan.costs.models.spill.stop import stop_spill
from graceful_plan.costs.objective import moving_batch
from graceful_plan.scene.rules.vessel import find_vessel

TITLE = "Stops: what the robot's own protective stops spill, predicted and observed"
MEASURED = """\
All bundled tasks that carry a container with contents; `plan` with w = 0 and with its defaults, full speed, seed 0.
FailBench stops the healthy robot at times spread over the motion (category 1, degree by degree), and simulates 1.2 s.
"Spilled": share of stops that lose more than 1 % of the contents, predicted by `stop_spill` at the degree's
deceleration. "Lost": share of the contents that is lost in the mean. "Reached": entities that contents reach per stop;
predicted by the native kernel. "Dropped": stops in which the object left the gripper. The constants of `stop.yaml` were
fitted to moderate and severe stops along motions of these tasks; its head says what those of every other task predict
for the others.
"""
RATIO = (0.8, 1.25)
DEGREES = ("moderate", "severe", "critical")
_STOPS, _HORIZON, _NOTICED = 24, 1.2, 0.01


@dataclass(kw_only=True)
class Stops:
    """What stops of one degree do along one motion; predictions and observations, a number a stop."""

    task: str
    w: float | None
    degree: str
    spilled: list[tuple[float, float]] = field(default_factory=list)
    lost: list[tuple[float, float]] = field(default_factory=list)
    reached: list[tuple[float, float]] = field(default_factory=list)
    dropped: int = 0


def run(options: suite.Options) -> str:
    """Stop the robot in all tasks with containers and return Markdown."""
    tasks = [name for name in suite.task_names(options) if find_vessel(suite.task(name).scene) is not None]
    jobs = [(name, w, _STOPS // (4 if options.quick else 1)) for name in tasks for w in (0.0, None)]
    found = [stops for part in suite.spread(measure, jobs, options.processes, "stops") for stops in part]
    found.sort(key=lambda x: (x.task, DEGREES.index(x.degree)))
    return "\n".join([MEASURED, report.targets(_targets(found)), report.table(_HEADER, _rows(found))])


def measure(job: tuple[str, float | None, int]) -> list[Stops]:
    """Stop the robot along one motion, at each degree."""
    name, w, count = job
    task = suite.task(name)
    weight = {} if w is None else {"w": w}
    plan = gp.plan(task.start, task.goal, task.scene, seed=0, iterations=60, **weight)
    execution = _execution(name, plan)
    return [] if execution is None else [_stopped(name, w, degree, count, execution) for degree in DEGREES]


def _execution(name: str, plan: gp.PlanResult) -> failbench.Execution | None:
    """Carry a motion out, with a weld where fingers lose what they hold."""
    if plan.trajectory is None:
        return None
    for grasp in ("fingers", "weld"):
        world = failbench.build_world(suite.task(name).scene, failbench.SimSettings(grasp=grasp))
        try:
            return failbench.execute(plan.trajectory, world)
        except failbench.ExecutionRefused:
            continue
    return None


def _stopped(name: str, w: float | None, degree: str, count: int, execution: failbench.Execution) -> Stops:
    scene, stop = suite.task(name).scene, ProtectiveStop(degree=degree)
    rollouts = failbench.run_rollouts(
        execution, make_jobs([stop], execution.duration, n=count, seed=0), horizon=_HORIZON
    )
    state = execution.trajectory.at(execution.trajectory.t[0] + np.array([one.onset for one in rollouts]))
    batch = moving_batch(scene, state.q, state.qd)
    hard = replace(StopSettings.shipped(), deceleration=stop.amount)
    out = stop_spill(batch, hard)
    model = gp.FailureMixture(faults=FaultPrior({stop.NAME: 1.0}), stop=hard)
    reached = model.probability(batch)[:, list(scene.components).index("contents")].sum(axis=1)
    inside = 1.0 / max(1.0, _full(scene))
    stops = Stops(task=name, w=w, degree=degree, dropped=sum(one.dropped for one in rollouts))
    for i, one in enumerate(rollouts):
        wet = {event.entity for event in one.events if event.striker == "contents"}
        stops.spilled.append((float(out.chance[i]), float(one.spilled > _NOTICED)))
        stops.lost.append((float(out.chance[i] * min(1.0, out.lost[i] / inside)), one.spilled))
        stops.reached.append((float(reached[i]), float(len(wet))))
    return stops


def _full(scene: gp.Scene) -> float:
    """Return how many times the contents go into the container."""
    vessel = find_vessel(scene)
    assert vessel is not None
    return float(np.pi * vessel.radius**2 * vessel.height / vessel.volume)


# --- tables ----------------------------------------------------------------------------------------------------------

_HEADER = (
    "task",
    "w",
    "degree",
    "stops",
    "spilled predicted",
    "observed",
    "lost predicted",
    "observed",
    "reached predicted",
    "observed",
    "ratio",
    "dropped",
)
_WHAT = ("spilled", "lost", "reached")


def _means(parts: Sequence[Stops], what: str) -> tuple[float, float]:
    """Predicted and observed, motions weighted alike."""
    pairs = np.array([np.mean(getattr(part, what), axis=0) for part in parts])
    return (float(pairs[:, 0].mean()), float(pairs[:, 1].mean())) if len(pairs) else (np.nan, np.nan)


def _ratio(pair: tuple[float, float]) -> float:
    return pair[0] / pair[1] if pair[1] else np.nan


def _targets(parts: Sequence[Stops]) -> Iterator[report.Target]:
    for degree in DEGREES:
        for what in ("spilled", "reached"):
            ratio = _ratio(_means([part for part in parts if part.degree == degree], what))
            yield report.Target(
                what=f"{what}, {degree} stops: predicted over observed",
                wanted=f"{RATIO[0]} to {RATIO[1]}",
                measured=report.quantity(ratio),
                met=RATIO[0] <= ratio <= RATIO[1] if np.isfinite(ratio) else None,
            )
    total, dropped = sum(len(part.spilled) for part in parts), sum(part.dropped for part in parts)
    yield report.Target(
        what="stops that make the gripper lose the object (the prior says none)",
        wanted="below 1 %",
        measured=f"{dropped} of {total}",
        met=dropped < 0.01 * total,
    )


def _rows(parts: Sequence[Stops]) -> Iterator[Sequence[object]]:
    groups = [(part.task, "default" if part.w is None else f"{part.w:g}", [part]) for part in parts]
    groups += [("all", "", [part for part in parts if part.degree == degree]) for degree in DEGREES]
    for name, w, mine in groups:
        if not mine:
            continue
        pairs = {what: _means(mine, what) for what in _WHAT}
        figures = [report.quantity(x) for what in _WHAT for x in pairs[what]]
        count, dropped = sum(len(part.spilled) for part in mine), sum(part.dropped for part in mine)
        yield (name, w, mine[0].degree, count, *figures, report.quantity(_ratio(pairs["reached"])), dropped)
