"""How hard are contacts? The energies that damage is predicted from, and those that FailBench observes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

import failbench
import graceful_plan as gp
from benchmarks import report, suite
from failbench.fault.registry import faults
from failbench.recording.score import energy_impact
from failbench.rollouts.sampling import make_jobs
from failbench.validation import predicted_impact
from graceful_plan.costs.consequence import (
    BODY_ENERGY,
    BODY_SPREAD,
    CARRIED_LOSS,
    arrival_energy,
    damaged_by_body,
    damaged_by_carried,
)
from graceful_plan.scene.harm.fragility import FragilityTable

TITLE = "Damage: predicted and observed energies of contacts"
MEASURED = """\
Paths of every task with w = 0 at 0.5 of the velocity limits, the object held by the fingers, or by a weld where these
do not hold it. "Carried": drops at random times; of each touch of an entity by the object, E is the kinetic energy with
which it is predicted to arrive at the entity's height, the share is what was observed along the normal over E, and the
damage is the probability by the entity's class, predicted from E or computed from the observed energy. Tables, floors
and things that nobody minds are left out. "Body": the same of touches by the robot's body after faults of drives,
sensors and power; its predicted energy has one distribution. "Energy-weighted impact": severities of what was touched
times the probability of damage, mean over the drops, and what `ImpactCost("mixture", consequence="energy")` predicts.
"""
IGNORED = ("table", "floor", "none")
BODY_FAULTS = ("power_loss", "complete_shutdown", "loose_joint", "stuck_position", "bias_drift")
DROPS, FAILURES = 200, 200
RATIO = (0.7, 1.4)


@dataclass(kw_only=True)
class TouchEnergies:
    """What happened along one motion."""

    scene: str
    arrived: list[float] = field(default_factory=list)
    """E of each touch by the carried object [J]."""
    energy: list[float] = field(default_factory=list)
    """Observed [J]."""
    predicted: list[float] = field(default_factory=list)
    """Damage."""
    observed: list[float] = field(default_factory=list)
    body_energy: list[float] = field(default_factory=list)
    body_predicted: list[float] = field(default_factory=list)
    body_observed: list[float] = field(default_factory=list)
    impact: tuple[float, float] = (0.0, 0.0)
    """Energy-weighted, predicted and observed."""
    refused: str = ""


def run(options: suite.Options) -> str:
    """Let robots fail in all tasks and return Markdown."""
    scale = 10 if options.quick else 1
    jobs = [(name, DROPS // scale, FAILURES // scale) for name in suite.task_names(options)]
    found = sorted(suite.spread(measure, jobs, options.processes, "energies"), key=lambda part: part.scene)
    return "\n".join(
        [
            MEASURED,
            report.targets(_targets(found)),
            report.table(_HEADER, _rows(found)),
            report.table(_BODY, _body(found)),
        ]
    )


def measure(job: tuple[str, int, int]) -> TouchEnergies:
    """Let things fail along one motion."""
    name, drops, failures = job
    task = suite.task(name)
    touches = TouchEnergies(scene=name.split("/")[0])
    if task.scene.carried is None:
        return touches
    motion = gp.plan(task.start, task.goal, task.scene, w=0.0, iterations=60, speed=0.5)
    for grasp in ("fingers", "weld"):
        try:
            execution = failbench.execute(motion, failbench.build_world(task.scene, failbench.SimSettings(grasp=grasp)))
            break
        except failbench.ExecutionRefused as error:
            touches.refused = error.what
    else:
        return touches
    drop = faults()["gripper_failure"](degree="critical")
    rollouts = failbench.run_rollouts(execution, make_jobs([drop], execution.duration, n=drops, seed=0), threads=1)
    _add_carried(touches, task.scene, execution, rollouts)
    cost = gp.ImpactCost("mixture", consequence="energy")
    times = np.array([rollout.onset for rollout in rollouts])
    touches.impact = (
        float(predicted_impact(execution.trajectory, task.scene, times, cost).sum(axis=1).mean()),
        float(np.mean([energy_impact(rollout, task.scene) for rollout in rollouts])),
    )
    broken = [faults()[kind](degree="severe") for kind in BODY_FAULTS]
    jobs = make_jobs(broken, execution.duration, n=failures, seed=0)
    _add_body(touches, task.scene, failbench.run_rollouts(execution, jobs, threads=1))
    return touches


def _add_carried(
    touches: TouchEnergies, scene: gp.Scene, execution: failbench.Execution, rollouts: Sequence[failbench.Rollout]
) -> None:
    table, names = FragilityTable.shipped(), list(scene.entities)
    state = execution.trajectory.at(execution.trajectory.t[0] + np.array([rollout.onset for rollout in rollouts]))
    speed = np.linalg.norm(state.qd, axis=1)
    direction = state.qd / np.where(speed > 0.0, speed, 1.0)[:, None]
    arrived = arrival_energy(gp.StateBatch(scene, state.q, direction, speed))
    for row, event in _events(rollouts, scene, "carried"):
        E, fragility = arrived[row, names.index(event.entity)], table.of(scene.entities[event.entity].category)
        touches.arrived.append(float(E))
        touches.energy.append(event.energy)
        touches.predicted.append(float(damaged_by_carried(np.array([E]), fragility)[0]))
        touches.observed.append(fragility.probability(event.energy))


def _add_body(touches: TouchEnergies, scene: gp.Scene, rollouts: Sequence[failbench.Rollout]) -> None:
    table = FragilityTable.shipped()
    for _, event in _events(rollouts, scene, "body"):
        fragility = table.of(scene.entities[event.entity].category)
        touches.body_energy.append(event.energy)
        touches.body_predicted.append(damaged_by_body(fragility))
        touches.body_observed.append(fragility.probability(event.energy))


def _events(
    rollouts: Sequence[failbench.Rollout], scene: gp.Scene, striker: str
) -> Iterator[tuple[int, failbench.ContactEvent]]:
    for row, rollout in enumerate(rollouts):
        for event in rollout.events:
            counts = not event.secondary and scene.entities[event.entity].category not in IGNORED
            if event.striker == striker and counts:
                yield row, event


# --- tables ----------------------------------------------------------------------------------------------------------

_HEADER = (
    "scene",
    "motions",
    "touches",
    "E [J], median",
    "observed [J], median",
    "mean of -ln share",
    "damage predicted",
    "damage observed",
    "energy-weighted impact predicted",
    "observed",
)
_BODY = ("scene", "touches by the body", "median [J]", "deviation of ln", "damage predicted", "damage observed")


def _all(parts: Sequence[TouchEnergies], name: str) -> list[float]:
    return [value for part in parts for value in getattr(part, name)]


def _loss(parts: Sequence[TouchEnergies]) -> float:
    """Mean of -ln of the share; where more was observed than arrived, the share counts as 1."""
    arrived, energy = (np.array(_all(parts, name)) for name in ("arrived", "energy"))
    known = arrived > 0.0
    share = np.maximum(energy[known], 1e-7) / np.maximum(arrived[known], 1e-7)
    return float(np.mean(-np.log(np.minimum(share, 1.0)))) if known.any() else np.nan


def _mean(parts: Sequence[TouchEnergies], name: str) -> float:
    values = _all(parts, name)
    return float(np.mean(values)) if values else np.nan


def _spread(energy: Sequence[float]) -> tuple[float, float]:
    """Median, and half the distance of the 16 % and 84 % quantiles of the logarithm."""
    if not energy:
        return np.nan, np.nan
    low, middle, high = np.quantile(np.log(np.maximum(energy, 1e-7)), (0.16, 0.5, 0.84))
    return float(np.exp(middle)), float(0.5 * (high - low))


def _targets(parts: Sequence[TouchEnergies]) -> Iterator[report.Target]:
    for what, predicted, observed in (
        ("carried", "predicted", "observed"),
        ("body", "body_predicted", "body_observed"),
    ):
        ratio = _mean(parts, predicted) / _mean(parts, observed)
        yield report.Target(
            what=f"{what}: predicted over observed damage, given a touch",
            wanted=f"{RATIO[0]} to {RATIO[1]}",
            measured=report.quantity(ratio),
            met=RATIO[0] <= ratio <= RATIO[1] if np.isfinite(ratio) else None,
        )
    energy = _spread(_all(parts, "body_energy"))
    for what, constant, measured in (
        ("mean of -ln share", CARRIED_LOSS, _loss(parts)),
        ("median energy of the body [J]", BODY_ENERGY, energy[0]),
        ("deviation of its logarithm", BODY_SPREAD, energy[1]),
    ):
        close = bool(abs(np.log(measured / constant)) <= np.log(1.5)) if np.isfinite(measured) else None
        yield report.Target(
            what=f"constant of the library: {what}",
            wanted=f"{constant:g} within a factor of 1.5",
            measured=report.quantity(measured),
            met=close,
        )


def _scenes(parts: Sequence[TouchEnergies]) -> Iterator[tuple[str, list[TouchEnergies]]]:
    for scene in dict.fromkeys(part.scene for part in parts):
        yield scene, [part for part in parts if part.scene == scene]
    yield "all", list(parts)


def _rows(parts: Sequence[TouchEnergies]) -> Iterator[Sequence[object]]:
    for scene, mine in _scenes(parts):
        impacts = np.array([part.impact for part in mine])
        yield (
            scene,
            len(mine),
            sum(len(part.energy) for part in mine),
            *(report.quantity(float(np.median(_all(mine, name) or [np.nan]))) for name in ("arrived", "energy")),
            report.quantity(_loss(mine)),
            *(report.quantity(_mean(mine, name)) for name in ("predicted", "observed")),
            *(report.quantity(float(x)) for x in impacts.mean(axis=0)),
        )


def _body(parts: Sequence[TouchEnergies]) -> Iterator[Sequence[object]]:
    for scene, mine in _scenes(parts):
        energy = _all(mine, "body_energy")
        yield (
            scene,
            len(energy),
            *(report.quantity(x) for x in _spread(energy)),
            *(report.quantity(_mean(mine, name)) for name in ("body_predicted", "body_observed")),
        )
