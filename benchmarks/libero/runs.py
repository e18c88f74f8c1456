"""Motions of a transport with several costs, drops along them, and their hits; one line of JSON per task."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

import failbench as fb
import graceful_plan as gp
from benchmarks.libero.scenes import NoTransport, Transport, arrived, kind_of, transport
from benchmarks.prevention.runs import least_severity
from benchmarks.store import read_lines
from failbench.calibrations.failures import DROP
from failbench.fault.end_effector import GripperFailure
from failbench.recording.records import Rollout
from failbench.recording.score import damage_by_energy, impact_by_entity
from failbench.rollouts.rollout import run_rollouts
from failbench.rollouts.sampling import make_requests
from graceful_plan.costs.models.mixture.mixture import FailureMixture
from graceful_plan.scene.harm.fragility import FragilityTable

Array = np.ndarray

SEED, SPEED = 2026, 0.5
"""Seed of plans and drops; fraction of the velocity limits."""
NONE, OURS, HEAVY, ENERGY = "w = 0", "default", "w = 10", "by energy"
_SETTLES = 2.0
"""Time in which a released object comes to rest [s]."""
_PUBLISHED, _BY_ENERGY = gp.ImpactCost(model="box_overlap"), gp.ImpactCost(consequence="energy")
OBJECTIVES: Mapping[str, gp.Objective] = MappingProxyType(
    {
        NONE: gp.Objective(w=0.0),
        OURS: gp.Objective(impact=gp.ImpactCost(consequence="contact")),
        HEAVY: gp.Objective(impact=gp.ImpactCost(consequence="contact"), w=10.0),
        ENERGY: gp.Objective(impact=_BY_ENERGY),
        **{f"Algorithm 1, w = {w:g}": gp.Objective(impact=_PUBLISHED, w=w) for w in (0.3, 3.0)},
    }
)
"""Objective of each motion, by label."""
PUBLISHED = tuple(label for label in OBJECTIVES if label.startswith("Algorithm"))
OBSERVED = (NONE, OURS)
"""Motions whose drops are compared with predictions, event by event."""
PARTS = ("target", "bystanders", "table and floor", "own loss")
"""Parts of the harm: the entity that the object is put on, other things and furniture, the support, the object."""
MODELS: Mapping[str, gp.InteractionModel | str] = MappingProxyType(
    {"mixture": FailureMixture(), "Algorithm 1": "box_overlap"}
)
"""Interaction models whose predictions are compared with observed contacts."""


@dataclass(frozen=True, kw_only=True)
class Events:
    """Drops and entities: kind of each entity, predicted probability of a contact by model, and whether it happened."""

    kind: list[str]
    predicted: Mapping[str, list[float]]
    happened: list[bool]


@dataclass(frozen=True, kw_only=True)
class Motion:
    """A planned motion and the mean harm of a drop along it.

    Args:
        refused: Reason why there is no motion or the healthy robot cannot execute it; otherwise "".
        first: Duration of the call [s].
        duration: [s].
        contact: Mean harm of a drop by part, see `PARTS`; every contact counts in full.
        energy: The same with each contact weighted by the probability of damage at its energy.
        predicted: Mean predicted harm of a drop by contact, and by energy.
        held: Share of the drops after which the object is still in the gripper.
        arrives: Whether the object lies where the task wants it 2 s after its release at the end; of the motions in
            `OBSERVED`.
        events: Of the motions in `OBSERVED`.
    """

    refused: str = ""
    first: float = float("nan")
    duration: float = float("nan")
    contact: Mapping[str, float] = field(default_factory=dict)
    energy: Mapping[str, float] = field(default_factory=dict)
    predicted: Sequence[float] = ()
    held: float = float("nan")
    arrives: bool = False
    events: Events | None = None


@dataclass(frozen=True, kw_only=True)
class Done:
    """A task with its motions by label.

    Args:
        task: "SUITE.TASK".
        refused: Reason why there is no transport; otherwise "".
        grasp: "fingers" or "weld".
        load: Time to load the scene, find a grasp and the goals [s].
        least: Least positive severity of the scene.
        drops: Number of drops along each motion.
        motions: By label.
    """

    task: str
    refused: str = ""
    grasp: str = ""
    load: float = float("nan")
    least: float = float("nan")
    drops: int = 0
    motions: Mapping[str, Motion] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Job:
    """An exported task, and the number of drops along each motion."""

    folder: str
    drops: int
    labels: tuple[str, ...] = tuple(OBJECTIVES)


def do(job: Job) -> Done:
    """Plan a task with each objective, and drop the object along all motions at the same fractions of their time."""
    started, name = time.perf_counter(), Path(job.folder).name
    try:
        carry = transport(Path(job.folder))
    except (NoTransport, gp.GracefulPlanError) as error:
        return Done(task=name, refused=f"{type(error).__name__}: {error}")
    load = time.perf_counter() - started
    results, seconds = {}, {}
    for label in job.labels:
        started = time.perf_counter()
        results[label] = gp.plan(
            carry.start, carry.goal, carry.scene, objective=OBJECTIVES[label], seed=SEED, speed=SPEED
        )
        seconds[label] = time.perf_counter() - started
    grasp, held = held_by(carry, results)
    motions = {}
    for label, found in held.items():
        if isinstance(found, str):
            motions[label] = Motion(refused=found, first=seconds[label])
        else:
            motions[label] = _drops(carry, found, job.drops, seconds[label], observed=label in OBSERVED)
    least = least_severity(carry.scene)
    return Done(task=name, grasp=grasp, load=load, least=least, drops=job.drops, motions=motions)


def held_by(carry: Transport, results: Mapping[str, gp.PlanResult]) -> tuple[str, dict[str, fb.Execution | str]]:
    """Return the grasp, and the executions or refusals of all motions.

    The grasp is a weld if fingers lose the object along any motion, or let it slip until it touches something: contacts
    of the healthy run do not count as harm of a failure, so motions would be compared without them.
    """
    found: dict[str, fb.Execution | str] = {}
    grasp = "weld"
    for grasp in ("fingers", "weld"):
        # The arms have motors, so computed torques drive them.
        world = fb.build_world(carry.scene, fb.SimSettings(grasp=grasp, control="torque"))
        found = {label: _executed(result, world) for label, result in results.items()}
        planned = [found[label] for label, result in results.items() if result.trajectory is not None]
        if all(isinstance(one, fb.Execution) and not one.baseline for one in planned):
            break
    return grasp, found


def _executed(result: gp.PlanResult, world: fb.World) -> fb.Execution | str:
    if result.trajectory is None:
        return f"{result.status.name}: {result.detail}"
    try:
        return fb.execute(result, world)
    except fb.ExecutionRefused as error:
        return str(error)


def _drops(carry: Transport, execution: fb.Execution, drops: int, seconds: float, *, observed: bool) -> Motion:
    scene, trajectory = carry.scene, execution.trajectory
    rollouts = [
        rollout
        for rollout in run_rollouts(execution, make_requests(DROP, execution.duration, n=drops, seed=SEED), threads=1)
        if rollout.status == "completed"
    ]
    state = trajectory.at(trajectory.t[0] + np.array([rollout.onset for rollout in rollouts]))
    damage = damage_by_energy(FragilityTable.shipped())
    predicted = [
        gp.evaluate(trajectory, scene, gp.Objective(impact=gp.ImpactCost(consequence=by))).impact / trajectory.duration
        for by in ("contact", "energy")
    ]
    return Motion(
        first=seconds,
        duration=trajectory.duration,
        contact=_parts(carry, [impact_by_entity(rollout, scene) for rollout in rollouts]),
        energy=_parts(carry, [impact_by_entity(rollout, scene, factor=damage) for rollout in rollouts]),
        predicted=predicted,
        held=float(np.mean([not rollout.dropped for rollout in rollouts])),
        arrives=observed and _arrives(carry, execution),
        events=_events(carry, execution, rollouts, state.q, state.qd) if observed else None,
    )


def _arrives(carry: Transport, execution: fb.Execution) -> bool:
    release = fb.RolloutRequest(fault=GripperFailure(degree="critical"), onset=execution.duration, seed=SEED)
    *_, (model, data) = fb.rollout_steps(execution, release, horizon=_SETTLES)
    return arrived(carry, model, data)


def _parts(carry: Transport, harms: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Return the mean harm by part."""
    assert carry.scene.carried is not None
    sums = dict.fromkeys(PARTS, 0.0)
    for harm in harms:
        for name, value in harm.items():
            if name == carry.scene.carried.body:
                part = "own loss"
            elif name == carry.target:
                part = "target"
            else:
                part = "table and floor" if _is_support(name) else "bystanders"
            sums[part] += value
    return {part: value / len(harms) for part, value in sums.items()}


def _is_support(name: str) -> bool:
    return name == "floor" or "table" in name


def _events(carry: Transport, execution: fb.Execution, rollouts: Sequence[Rollout], q: Array, qd: Array) -> Events:
    scene = carry.scene
    row = list(scene.components).index("carried")
    counted = [("carried", name) not in execution.baseline for name in scene.entities]
    hit = np.array(
        [
            [any(e.entity == name and e.striker == "carried" and not e.secondary for e in x.events) for name in
             scene.entities]
            for x in rollouts
        ]
    )  # fmt: skip
    kinds = [kind_of(name) for name in scene.entities]
    predicted = {
        label: gp.interaction_probability(q, scene, model, qd)[:, row][:, counted].ravel().round(5).tolist()
        for label, model in MODELS.items()
    }
    kept = [kind for kind, counts in zip(kinds, counted, strict=True) if counts]
    return Events(kind=kept * len(rollouts), predicted=predicted, happened=hit[:, counted].ravel().tolist())


# --- stored lines -----------------------------------------------------------------------------------------------------


def read(file: Path) -> Iterator[Done]:
    """Yield the finished tasks."""
    for line in read_lines(file):
        line["motions"] = {label: _motion(x) for label, x in line["motions"].items()}
        yield Done(**line)


def _motion(x: dict[str, Any]) -> Motion:
    x["events"] = None if x["events"] is None else Events(**x["events"])
    return Motion(**x)
