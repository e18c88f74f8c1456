"""Validation of the planner's impact: observed and predicted harm of failures, with confidence intervals.

Both are severities per failure, summed over components and entities, including the carried object itself.
Observed: the mean over rollouts of the summed severities of all touches. Predicted: the mean of the planner's sum of
P S over the onsets of the same faults. Times the expected number of failures during the motion, either is the expected
harm of failures per executed task. Harm of the healthy robot is added with probability 1, and is reported first.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import ArrayLike

import graceful_plan as gp
from failbench.basics.statistics import (
    Estimate,
    check_confidence,
    effective_sample_size,
    estimate_mean,
    estimate_probability,
)
from failbench.fault.fault import Fault
from failbench.recording.healthy import HealthyHarm, whole_execution
from failbench.recording.records import Rollout, RolloutRequest
from failbench.recording.score import (
    Touches,
    energy_impact,
    greatest_touch,
    impact_by_entity,
    own_damage,
    own_loss,
    secondary_impact,
)
from failbench.report import FAILURES_PER_HOUR, EntityReport, ValidationReport
from failbench.rollouts.execution import Execution, execute
from failbench.rollouts.rollout import run_rollouts
from failbench.rollouts.sampling import MOST, check_whole, make_requests, quantile_grid, thread_count
from failbench.scenario import scenarios as find_scenarios
from failbench.simulated.world import SimSettings, build_world
from failbench.surroundings.registry import scene_with_intruder
from graceful_plan import ImpactCost, Path, PlanResult, Scene, Trajectory
from graceful_plan.array_types import Array, Bool, Float
from graceful_plan.costs.cost_samples import trajectory_batch
from graceful_plan.exceptions import SettingError
from graceful_plan.scene.harm.fragility import FragilityTable
from graceful_plan.setting_checks import not_negative

Motion = Trajectory | Path | PlanResult | ArrayLike
Scenarios = str | Fault | Sequence[str | Fault]
Progress = Callable[[int, int], None]
"""Called with the numbers of finished and of all rollouts."""

_CHUNK = 128
"""Rollouts between calls of `progress`."""


def validate(
    motion: Motion,
    scene: Scene,
    scenarios: Scenarios = "drop/*/severe",
    *,
    n: int = 400,
    horizon: float = 1.0,
    seed: int = 0,
    importance: bool = False,
    threads: int | None = None,
    settings: SimSettings | None = None,
    prediction: ImpactCost | None = None,
    controller: object = None,
    rate: float = FAILURES_PER_HOUR,
    confidence: float = 0.95,
    progress: Progress | None = None,
) -> ValidationReport:
    """Simulate many failures along a motion, and compare their observed impact with the planner's prediction.

    Args:
        motion: A trajectory, the result of `plan`, or a path or configurations, which are timed within the limits.
        scene: The scene with the carried object attached: `task.scene`.
        scenarios: Faults, equally weighted: fault objects, or patterns of the registry's tags or names such as
            "drop/*", of which only the faults are used.
        n: Number of rollouts, rounded up to a multiple of the number of faults.
        horizon: Simulated time after the onset [s].
        seed: Seed of all random numbers. Validations with the same seed, n and faults have common random numbers.
        importance: Whether to sample onsets more densely where harm is predicted. Other motions then have different
            onsets.
        threads: Number of simulation threads; None for one per core. It does not affect the result.
        settings: Settings of the simulation.
        prediction: The impact cost that predicts; None for the planner's default. If it excludes the loss of the
            carried object itself (`ImpactCost.own_loss`), the observed impact excludes it as well.
        controller: Controller of a driving base, see `execute`. It continues after the onset.
        rate: Failures per hour of motion, of all these faults together, for the harm per executed task.
        confidence: Confidence level of the intervals.
        progress: Called with the numbers of finished and of all rollouts.

    Raises:
        ExecutionRefused: If the healthy robot cannot execute the motion, or loses the object (`ObjectLost`). A healthy
            robot that spills is not refused; the report begins with its harm.
        UnknownNameError: If a pattern matches nothing, or a fault strikes a joint that the robot does not have.
        PlanningFailed: If `motion` is the result of a failed plan.
        SettingError: If a setting is out of range, or all faults are of the gripper and it holds no object.
    """
    faults = chosen_faults(scenarios)
    _check_droppable(faults, scene)
    check_whole("n", n, 1, MOST)
    check_whole("seed", seed, 0)
    cores = thread_count(threads)
    check_confidence(confidence)
    _check_rate(rate)
    for fault in faults:
        scene = scene_with_intruder(fault, scene)
    execution = execute(motion, build_world(scene, settings), controller=controller)
    cost = ImpactCost() if prediction is None else prediction

    def predict(times: Float[Array, " n"]) -> Float[Array, "n entity"]:
        return predicted_impact(execution.trajectory, scene, times, cost)

    proposal = (lambda times: predict(times).sum(axis=1)) if importance else None
    jobs = make_requests(faults, execution.duration, n=n, seed=seed, predicted=proposal)
    rollouts: list[Rollout] = []
    for first in range(0, len(jobs), _CHUNK):
        rollouts += run_rollouts(execution, jobs[first : first + _CHUNK], horizon=horizon, threads=cores)
        if progress is not None:
            progress(len(rollouts), len(jobs))
    expected = np.mean([predict(_onsets(fault, execution.duration)).mean(axis=0) for fault in faults], axis=0)
    failures = _Failures(faults, jobs, rollouts, _Expected(cost, expected))
    return _report(execution, failures, rate, seed=seed, horizon=horizon, confidence=confidence)


def chosen_faults(scenarios: Scenarios) -> tuple[Fault, ...]:
    """Return the faults given directly or by patterns of the registry, each once.

    Raises:
        UnknownNameError: If a pattern matches nothing.
        SettingError: If an entry is neither a pattern nor a fault, or there are no entries.
    """
    given = [scenarios] if isinstance(scenarios, str) or not isinstance(scenarios, Sequence) else list(scenarios)
    found: dict[Fault, None] = {}
    for entry in given:
        if isinstance(entry, Fault):
            found[entry] = None
        elif isinstance(entry, str):
            found |= {scenario.fault: None for scenario in find_scenarios(entry)}
        else:
            raise SettingError("scenarios", entry, "patterns such as 'drop/*', or faults")
    if not found:
        raise SettingError("scenarios", tuple(given), "at least one pattern or fault")
    return tuple(found)


def _check_rate(rate: float) -> None:
    not_negative("rate", rate, "failures per hour, a finite number >= 0")


def strikes(fault: Fault, scene: Scene) -> bool:
    """Tell whether a fault can do harm in a scene: a fault of the gripper only while it holds an object."""
    return scene.carried is not None or set(fault.targets or fault.TARGETS) != {"gripper"}


def _check_droppable(faults: Sequence[Fault], scene: Scene) -> None:
    """Raise SettingError if all faults are of the gripper and it holds no object."""
    if not any(strikes(fault, scene) for fault in faults):
        raise SettingError("scene", scene.name, "one with an object in the gripper, such as task.scene")


def predicted_impact(
    trajectory: Trajectory, scene: Scene, times: Float[Array, " n"], cost: ImpactCost
) -> Float[Array, "n entity"]:
    """Predict the impact of a failure at times after the start of a trajectory [s].

    Returns:
        Impact for the scene's entities, then moving entities, then the carried object itself if its loss counts.
    """
    clock = trajectory.t[0] + times
    batch = trajectory_batch(scene, trajectory, clock, clock if scene.moving else None)
    return np.einsum("nch,ch->nh", cost.probability(batch), cost.severity_table(scene))


def _onsets(fault: Fault, duration: float) -> Float[Array, " n"]:
    """Return equally probable onsets of a fault."""
    return np.array([fault.when.onset(u, duration) for u in quantile_grid()])


class _Expected(NamedTuple):
    """The predicted impact, and the cost that predicts it."""

    cost: ImpactCost
    impact: Float[Array, " harmed"]


class _Failures(NamedTuple):
    """The faults, their rollouts, and the prediction."""

    faults: Sequence[Fault]
    jobs: tuple[RolloutRequest, ...]
    rollouts: Sequence[Rollout]
    expected: _Expected


def _report(
    execution: Execution,
    failures: _Failures,
    rate: float,
    *,
    seed: int,
    horizon: float,
    confidence: float,
) -> ValidationReport:
    scene, (faults, jobs, rollouts, expected) = execution.world.scene, failures
    valid = np.array([rollout.status == "completed" for rollout in rollouts])
    weights = np.array([job.weight for job in jobs])
    own, table = expected.cost.own_loss and scene.carried is not None, expected.cost.fragility
    shares = _shares(scene, rollouts, table, own=own)
    healthy = execution.healthy
    executions = [whole_execution(rollout, healthy) for rollout in rollouts]
    greatest = greatest_touch(scene, own=own)

    def mean(values: ArrayLike, bound: float = greatest, among: Bool[Array, " n"] = valid) -> Estimate:
        observed = np.asarray(values, dtype=float)[among]
        return estimate_mean(observed, (0.0, bound), weights=weights[among], confidence=confidence)

    def fraction(hits: ArrayLike) -> Estimate:
        return estimate_probability(np.asarray(hits)[valid], weights=weights[valid], confidence=confidence)

    impacts = shares.sum(axis=1)
    wholes = impacts if healthy.harmless else _shares(scene, executions, table, own=own).sum(axis=1)
    by_entity = {
        entity.name: EntityReport(
            probability=fraction([_touches(rollout, entity.name) for rollout in rollouts]),
            impact=mean(shares[:, i], sum(entity.severity.values())),
            predicted=float(expected.impact[i]),
        )
        for i, entity in enumerate(scene.entities.values())
    }
    if own and scene.carried is not None:
        by_entity[scene.carried.body] = EntityReport(
            probability=mean([own_damage(rollout, scene, table) for rollout in rollouts], 1.0),
            impact=mean(shares[:, -1], scene.own_severity),
            predicted=float(expected.impact[len(scene.entities) :].sum()),  # 0 if the model excludes it
        )
    struck = {label: np.array([job.fault == fault for job in jobs]) for label, fault in _labels(faults).items()}
    return ValidationReport(
        scene=scene.notes.name,
        healthy=_counted(healthy, scene, table, own=own),
        observed=mean(impacts),
        whole=mean(wholes),
        energy=mean([energy_impact(rollout, scene, table, own=own) for rollout in rollouts]),
        own_loss=mean([own_loss(rollout, scene, table) for rollout in rollouts], scene.own_severity),
        secondary=mean([secondary_impact(rollout, scene) for rollout in rollouts]),
        predicted=float(expected.impact.sum()),
        duration=execution.duration,
        rate=rate,
        by_fault={label: mean(impacts, among=valid & mine) for label, mine in struck.items()},
        by_entity=by_entity,
        dropped=fraction([rollout.dropped for rollout in rollouts]),
        spilled=mean([rollout.spilled for rollout in rollouts], 1.0),
        diverged=int(np.count_nonzero(~valid)),
        n=len(jobs),
        effective_n=effective_sample_size(weights),
        seed=seed,
        horizon=horizon,
        confidence=confidence,
        greatest=greatest,
        versions={"graceful_plan": gp.__version__, "mujoco": mujoco.__version__},
        jobs=jobs,
        impacts=np.where(valid, impacts, np.nan),
        wholes=np.where(valid, wholes, np.nan),
    )


def _counted(healthy: HealthyHarm, scene: Scene, fragility: FragilityTable, *, own: bool) -> HealthyHarm:
    """Return the healthy harm by the same rule as for failures."""
    found = impact_by_entity(healthy, scene, fragility, own=own)
    return replace(healthy, by_entity={name: x for name, x in found.items() if x > 0.0})


def _shares(
    scene: Scene, rollouts: Sequence[Touches], fragility: FragilityTable, *, own: bool
) -> Float[Array, "n harmed"]:
    """Return each entity's part of the observed impacts, with the carried object's own loss last if it counts."""
    names = [*scene.entities, *([scene.carried.body] if own and scene.carried is not None else [])]
    found = [impact_by_entity(rollout, scene, fragility, own=own) for rollout in rollouts]
    return np.array([[impact.get(name, 0.0) for name in names] for impact in found]).reshape(-1, len(names))


def _touches(rollout: Rollout, entity: str) -> bool:
    return any(event.entity == entity and not event.secondary for event in rollout.events)


def _labels(faults: Sequence[Fault]) -> dict[str, Fault]:
    """Label each fault with its name and degree, numbered if taken."""
    found: dict[str, Fault] = {}
    for fault in faults:
        name = label = f"{fault.NAME}/{fault.degree}"
        number = 1
        while label in found:
            number += 1
            label = f"{name} ({number})"
        found[label] = fault
    return found
