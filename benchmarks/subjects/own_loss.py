"""Damage of falls to the carried object itself: predicted, observed, and the share of the energy that causes it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

import failbench
import graceful_plan as gp
from benchmarks import report, suite
from failbench.fault.registry import faults
from failbench.recording.score import own_damage
from failbench.rollouts.sampling import make_requests
from graceful_plan.costs.models.drop.loss import LANDING_LOSS, carried_mass
from graceful_plan.costs.models.drop.release import heights, release
from graceful_plan.costs.models.drop.tables import drop_tables
from graceful_plan.costs.objective import moving_batch
from graceful_plan.scene.harm.fragility import FragilityTable

TITLE = "Own loss: damage by falls to the carried object itself, predicted and observed"
QUESTION = "Is the predicted damage to the dropped object itself the damage that simulated falls cause?"
HEADLINE = "predicted over observed loss"
DEPENDS_ON = ("src/graceful_plan/costs", "src/graceful_plan/scene", *suite.SIMULATION)
MEASURED = """\
Paths of every task with w = 0 at 0.5 of the velocity limits. Fingers hold the object, or a weld where they fail. Drops
at random times, simulated for 1.5 s. "Damage": probability that the object is damaged, predicted by the drop model, and
computed from the energies of all its touches, of which the hardest counts. "First only": damage by the first touch
alone. "-ln share": of the energy along the normal at the first touch over that of the predicted vertical speed at that
height; a share above 1 counts as 1. "Loss": damage times the severity of the loss.
"""
DROPS, LONG_DROPS = 100, 200
RATIO = (0.75, 1.25)
_HORIZON = 1.5
"""Simulated time after a failure [s], long enough for falls off a table."""
_LEAST = 1e-7  # [J]


@dataclass(kw_only=True)
class OwnLosses:
    """Result along one motion."""

    task: str
    object_class: str = ""
    severity: float = 0.0
    predicted: list[float] = field(default_factory=list)
    """Predicted probability of damage of each drop."""
    observed: list[float] = field(default_factory=list)
    first: list[float] = field(default_factory=list)
    """Observed damage by the first touch alone."""
    share: list[float] = field(default_factory=list)
    """-ln of the share of each first touch."""


def run(options: suite.Options) -> str:
    """Simulate drops in all tasks."""
    jobs = [(name, options.pick(DROPS, quick=20, long=LONG_DROPS)) for name in suite.task_names(options)]
    found = sorted(suite.spread(measure, jobs, options.processes, "own losses"), key=lambda part: part.task)
    found = [part for part in found if part.predicted]
    return "\n".join([MEASURED, report.targets(_targets(found)), report.table(_HEADER, _rows(found))])


def measure(job: tuple[str, int]) -> OwnLosses:
    """Simulate drops of the carried object along one motion."""
    name, drops = job
    task = suite.task(name)
    losses = OwnLosses(task=name)
    if task.scene.carried is None:
        return losses
    losses.object_class, losses.severity = task.scene.carried.object_class, task.scene.own_severity
    motion = gp.plan(task.start, task.goal, task.scene, w=0.0, iterations=60, speed=0.5)
    for grasp in ("fingers", "weld"):
        try:
            execution = failbench.execute(motion, failbench.build_world(task.scene, failbench.SimSettings(grasp=grasp)))
            break
        except failbench.ExecutionRefused:
            continue
    else:
        return losses
    drop = faults()["gripper_failure"](degree="critical")
    jobs = make_requests([drop], execution.duration, n=drops, seed=0)
    _add(losses, task.scene, execution, failbench.run_rollouts(execution, jobs, horizon=_HORIZON, threads=1))
    return losses


def _add(
    losses: OwnLosses, scene: gp.Scene, execution: failbench.Execution, rollouts: Sequence[failbench.Rollout]
) -> None:
    times = execution.trajectory.t[0] + np.array([rollout.onset for rollout in rollouts])
    state = execution.trajectory.at(times)
    batch = moving_batch(scene, state.q, state.qd)
    losses.predicted += gp.FailureMixture().own_loss(batch, FragilityTable.shipped())["drop"].tolist()
    tables = drop_tables(scene)
    let_go = release(batch, tables)
    low, mass = heights(let_go, tables)[0].min(axis=1), carried_mass(scene)
    for row, rollout in enumerate(rollouts):
        losses.observed.append(own_damage(rollout, scene))
        touches = [event for event in (*rollout.events, *rollout.landings) if event.striker == "carried"]
        touches = [event for event in touches if event.energy > 0.0 and not event.secondary]
        if not touches:
            losses.first.append(0.0)
            continue
        touch = min(touches, key=lambda event: event.time)
        category = scene.entities[touch.entity].category if touch.entity else ""
        losses.first.append(FragilityTable.shipped().loss(losses.object_class, category, touch.energy))
        height = max(low[row] - touch.position[2], 0.0)
        arrived = mass * (0.5 * let_go.v[row, 2] ** 2 + 9.81 * height)
        losses.share.append(max(0.0, float(np.log(max(arrived, _LEAST) / max(touch.energy, _LEAST)))))


# --- tables ----------------------------------------------------------------------------------------------------------

_HEADER = (
    "task",
    "class",
    "severity",
    "drops",
    "-ln share",
    "damage predicted",
    "observed",
    "first only",
    "loss predicted",
    "observed",
    "ratio",
)


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else np.nan


def _losses(parts: Sequence[OwnLosses]) -> tuple[float, float]:
    """Predicted and observed loss of a drop, tasks weighted alike."""
    predicted = [part.severity * _mean(part.predicted) for part in parts]
    return _mean(predicted), _mean([part.severity * _mean(part.observed) for part in parts])


def _targets(parts: Sequence[OwnLosses]) -> Iterator[report.Target]:
    predicted, observed = _losses(parts)
    ratio = predicted / observed if observed else np.nan
    yield report.Target(
        what="predicted over observed loss",
        wanted=f"{RATIO[0]} to {RATIO[1]}",
        measured=report.quantity(ratio),
        met=RATIO[0] <= ratio <= RATIO[1] if np.isfinite(ratio) else None,
    )
    share = _mean([x for part in parts for x in part.share])
    yield report.Target(
        what="constant of the library: mean of -ln share at the first touch",
        wanted=f"{LANDING_LOSS:g} within a factor of 1.25",
        measured=report.quantity(share),
        met=bool(abs(np.log(share / LANDING_LOSS)) <= np.log(1.25)) if np.isfinite(share) else None,
    )


def _rows(parts: Sequence[OwnLosses]) -> Iterator[Sequence[object]]:
    for name, mine in [*((part.task, [part]) for part in parts), ("all", parts)]:
        predicted, observed = _losses(mine)
        figures = [_mean([x for part in mine for x in getattr(part, what)]) for what in ("predicted", "observed")]
        yield (
            name,
            mine[0].object_class if len(mine) == 1 else "",
            f"{mine[0].severity:g}" if len(mine) == 1 else "",
            sum(len(part.observed) for part in mine),
            report.quantity(_mean([x for part in mine for x in part.share])),
            *(report.quantity(x) for x in figures),
            report.quantity(_mean([x for part in mine for x in part.first])),
            report.quantity(predicted),
            report.quantity(observed),
            report.quantity(predicted / observed if observed else np.nan),
        )
