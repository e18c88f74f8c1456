"""Simulated failures for the viewer: FailBench breaks the robot at a moment of a motion.

FailBench depends on this library, so it is imported only when a failure is requested.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, final

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.costs.fault_prior import DEGREES, REACTIONS, FaultPrior, shipped_effects
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.models.mixture.mixture import FailureMixture
from graceful_plan.exceptions import SettingError, UnknownNameError
from graceful_plan.mobile.coast.coast import Coast
from graceful_plan.mobile.coast.constants import CoastSettings
from graceful_plan.path import plain_numbers
from graceful_plan.scene.scene import Scene
from graceful_plan.setting_checks import fraction
from graceful_plan.viewer.poses import Poses
from graceful_plan.viewer.recorded import RecordedRollouts
from graceful_plan.viewer.shapes import Part, parts
from graceful_plan.viewer.shown import ShownMotion, impact_by_entity

_HORIZON, _COASTING = 1.5, 4.0
"""Simulated time after the failure of an arm and of a base [s]."""
_STEP = 1.0 / 60.0
"""Time between frames [s]."""
_DEGREE = "severe"
"""Default degree of `shipped_effects`."""
_SAME_HARM = 1e-6
"""Tolerance for equal harm."""


@final
@dataclass(frozen=True, kw_only=True)
class Failure:
    """A fault with its degree and onset.

    Args:
        fault: One of `faults_of(scene)`.
        degree: One of `DEGREES`; ignored for bases.
        moment: Onset as a fraction of the duration of the motion, in [0, 1].
        seed: Seed of the random numbers.

    Raises:
        SettingError: If the moment is out of range.
        UnknownNameError: If the degree does not exist.
    """

    fault: str
    degree: str = "severe"
    moment: float = 0.5
    seed: int = 0

    def __post_init__(self) -> None:
        plain_numbers(self)
        fraction("moment", self.moment, "a share of the motion, in [0, 1]")
        if self.degree not in DEGREES:
            raise UnknownNameError("degree", self.degree, DEGREES)


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Replay:
    """A simulated failure for display: the motion up to the onset, then the simulation.

    | field     | meaning                                                               | unit | shape |
    |-----------|-----------------------------------------------------------------------|------|-------|
    | failure   | the failure                                                           |      |       |
    | label     | label of the motion                                                   |      |       |
    | onset     | failure onset after the start of the motion                           | s    |       |
    | t         | time of each frame, after the start of the motion                     | s    | frame |
    | poses     | poses of each drawn part                                              |      |       |
    | predicted | expected harm of this failure, by entity                              |      |       |
    | observed  | harm in this simulation, by entity                                    |      |       |
    | hits      | striker, entity, time after the onset [s] and position in W [m]       |      |       |
    | notes     | further remarks                                                       |      |       |
    """

    failure: Failure
    label: str
    onset: float
    t: Float[Array, " frame"]
    poses: Poses
    predicted: Mapping[str, float]
    observed: Mapping[str, float]
    hits: tuple[tuple[str, str, float, tuple[float, float, float] | None], ...]
    notes: tuple[str, ...] = ()

    @property
    def duration(self) -> float:
        """Time of the last frame [s]."""
        return float(self.t[-1])

    def frame(self, t: float) -> int:
        """Return the frame nearest to a time [s]."""
        return int(np.argmin(np.abs(self.t - t)))


def faults_of(scene: Scene) -> tuple[str, ...]:
    """Return the faults for a scene: those of FailBench, or for a base that drives its failure modes."""
    if scene.base is not None:
        return tuple(CoastSettings.shipped().ways)
    names = tuple(name for name in shipped_effects() if name not in REACTIONS)
    first = "gripper_failure"
    return (first, *(name for name in names if name != first)) if scene.carried is not None else names


@final
class FailureBench:
    """Simulator of failures, which caches the healthy execution of the last motion."""

    def __init__(self) -> None:
        self._kept: tuple[ShownMotion, Any, tuple[str, ...]] | None = None

    def replay(self, failure: Failure, motion: ShownMotion) -> Replay:
        """Simulate one failure along a motion.

        Raises:
            UnknownNameError: If the fault does not exist.
            SettingError: If the fault has no effect in this scene.
            GracefulPlanError: If FailBench cannot simulate the robot.
        """
        known = faults_of(motion.scene)
        if failure.fault not in known:
            raise UnknownNameError("fault", failure.fault, known)
        if motion.scene.base is not None:
            return _base_replay(failure, motion)
        kind = _failbench().faults()[failure.fault]
        if set(kind.TARGETS) == {"gripper"} and motion.scene.carried is None:
            raise SettingError("fault", failure.fault, "another one: nothing is in the gripper")
        job = _failbench().RolloutRequest(
            fault=kind(degree=failure.degree), onset=failure.moment * motion.duration, seed=failure.seed
        )
        execution, notes = self._execution(motion)
        return _arm_replay(failure, motion, (execution, job, _HORIZON), notes)

    def _execution(self, motion: ShownMotion) -> tuple[Any, tuple[str, ...]]:
        if self._kept is None or self._kept[0] is not motion:
            self._kept = (motion, *_executed(motion))
        return self._kept[1:]


def recorded_replay(rollouts: RecordedRollouts, number: int) -> Replay:
    """Repeat the simulation of a rollout of a dataset.

    Raises:
        SettingError: If its fault is defined in a custom file, which is not run here.
    """
    definition, work = (importlib.import_module(f"failbench.sweeps.{name}") for name in ("definition", "work"))
    row = rollouts[number]
    motion_index, fault_index, i = rollouts.sweep.place(number)
    if file := definition.own_file(rollouts.sweep.faults[fault_index]):
        what = f"a fault of FailBench's; `failbench replay` runs {file}, if you trust it"
        raise SettingError(f"fault of rollout {number}", row.fault, what)
    motion = rollouts.shown(number)[1].motions[0]
    job = work.jobs_of(rollouts.sweep, motion_index, fault_index)[i]
    failure = Failure(
        fault=row.fault, degree=row.degree, moment=min(1.0, row.onset / motion.duration), seed=int(job.seed)
    )
    execution = work.execution_of(rollouts.sweep, motion_index)
    replay = _arm_replay(failure, motion, (execution, job, rollouts.sweep.horizon), ())
    again = sum(replay.observed.values())
    if row.impact is None or abs(again - row.impact) <= _SAME_HARM:
        return replay
    said = f"The dataset has {row.impact:.2f}: it was made by other versions, or on another machine."
    return replace(replay, notes=(*replay.notes, said))


def _failbench() -> Any:
    return importlib.import_module("failbench")


def _executed(motion: ShownMotion) -> tuple[Any, tuple[str, ...]]:
    """Execute the healthy motion, with a constraint in the gripper if friction does not hold the object."""
    fb = _failbench()
    try:
        return fb.execute(motion.trajectory, fb.build_world(motion.scene)), ()
    except fb.ObjectLost as lost:
        world = fb.build_world(motion.scene, fb.SimSettings(grasp="weld"))
        return fb.execute(motion.trajectory, world), (f"The healthy grip slips ({lost}); here a constraint holds it.",)


def _arm_replay(
    failure: Failure, motion: ShownMotion, simulated: tuple[Any, Any, float], notes: tuple[str, ...]
) -> Replay:
    """Simulate a job of an execution for a time after its onset [s]."""
    fb, scene = _failbench(), motion.scene
    execution, job, horizon = simulated
    (rollout,) = fb.run_rollouts(execution, [job], horizon=horizon)
    each = max(1, round(_STEP / execution.dt))
    states = (data for _, data in fb.rollout_steps(execution, job, horizon=horizon))
    frames = [(data.xpos.copy(), data.xquat.copy()) for i, data in enumerate(states) if i % each == 0]
    score = importlib.import_module("failbench.recording.score")
    effects, told = _effects(failure.degree)
    prior = FaultPrior({failure.fault: 1.0}, effects, failure.fault)
    notes = (*notes, *told, *_said(rollout, scene))
    return Replay(
        failure=failure,
        label=motion.label,
        onset=rollout.onset,
        **_frames(motion, execution.world.model, rollout.onset, frames, each * execution.dt),
        predicted=_predicted(motion, rollout.onset, ImpactCost(model=FailureMixture(faults=prior))),
        observed={name: float(x) for name, x in score.impact_by_entity(rollout, scene).items() if x > 0.0},
        hits=tuple((event.striker, event.entity, event.time, event.position) for event in rollout.events),
        notes=notes,
    )


def _effects(degree: str) -> tuple[Any, tuple[str, ...]]:
    """Return the effects of faults of a degree, with a note if they are fitted for another degree only."""
    try:
        return shipped_effects(degree), ()
    except UnknownNameError:
        return shipped_effects(), (f"Predicted as for {_DEGREE} ones: effects of {degree} faults were not fitted.",)


def _said(rollout: Any, scene: Scene) -> tuple[str, ...]:
    if rollout.status != "completed":
        return ("The simulation diverged; its harm does not count.",)
    said = []
    if rollout.dropped and scene.carried is not None:
        said.append(f"{scene.carried.body} left the gripper.")
    if rollout.spilled > 0.0:
        said.append(f"{rollout.spilled:.0%} of its contents are spilt.")
    return tuple(said)


def _base_replay(failure: Failure, motion: ShownMotion) -> Replay:
    """Simulate the failure of a base on its wheels, without its carried object."""
    coasting = importlib.import_module("failbench.mobile.coasting")
    wheeled = importlib.import_module("failbench.mobile.wheeled")
    scene = motion.scene if motion.scene.carried is None else motion.scene.detach()
    wheels = wheeled.wheeled(scene)
    settings = CoastSettings.shipped()
    way, onset = settings.ways[failure.fault], failure.moment * motion.duration
    middle = way.deceleration[len(way.deceleration) // 2], way.drag, way.delay[len(way.delay) // 2]
    broken = coasting.BaseFailure(way.wheels, *middle, bend=way.bend[len(way.bend) // 2], steered=way.steered)
    state = motion.trajectory.at(motion.trajectory.t[0] + onset)
    hits = coasting.coasted(wheels, state.q, state.qd, broken, _COASTING)
    each = max(1, round(_STEP / wheeled.TIMESTEP))
    states = (data for data, _ in coasting.coasting(wheels, state.q, state.qd, broken, _COASTING))
    frames = [(data.xpos.copy(), data.xquat.copy()) for i, data in enumerate(states) if i % each == 0]
    alone = Coast(settings.only(failure.fault))
    entities = tuple(scene.entities.values())
    worth = [min(1.0, (hit.speed / settings.reference_speed) ** 2) for hit in hits]
    return Replay(
        failure=failure,
        label=motion.label,
        onset=onset,
        **_frames(motion, wheels.model, onset, frames, each * wheeled.TIMESTEP),
        predicted=_predicted(motion, onset, ImpactCost(model=alone, own_loss=False)),
        observed={
            entities[hit.entity].name: entities[hit.entity].severity["body"] * share
            for hit, share in zip(hits, worth, strict=True)
        },
        hits=tuple(("body", entities[hit.entity].name, hit.time, None) for hit in hits),
        notes=() if motion.scene.carried is None else ("The carried object is left out of the simulation.",),
    )


def _predicted(motion: ShownMotion, onset: float, impact: ImpactCost) -> dict[str, float]:
    """Return the expected harm of a failure at a time by entity, without entities that are safe."""
    values = impact_by_entity(motion.trajectory, motion.scene, np.array([onset]), impact)[0]
    found = zip(impact.harmed_entities(motion.scene), values.tolist(), strict=True)
    return {name: value for name, value in found if value > 1e-6}


def _frames(
    motion: ShownMotion, model: mujoco.MjModel, onset: float, frames: Sequence[tuple[Array, Array]], dt: float
) -> dict[str, Any]:
    """Return times and poses: the motion up to the onset, then the frames of a simulation."""
    drawn = parts(motion.scene)
    healthy = motion.t < onset
    t = np.concatenate([motion.t[healthy], onset + dt * np.arange(len(frames))])
    kept = np.append(np.flatnonzero(healthy), np.full(len(frames), motion.frame(onset)))
    position, quaternion = motion.poses.position[kept].copy(), motion.poses.quaternion[kept].copy()
    ids = [_body(model, part) for part in drawn]
    here = [k for k, body in enumerate(ids) if body >= 0]
    bodies = [ids[k] for k in here]
    first = int(healthy.sum())
    for i, (xpos, xquat) in enumerate(frames, start=first):
        position[i, here], quaternion[i, here] = xpos[bodies], xquat[bodies]
    for k, part in enumerate(drawn):
        if part.body < 0:  # moving entities follow their prediction
            place = motion.scene.moving[part.name].at(t)
            position[:, k] = place.position
    return {"t": t, "poses": Poses(position, quaternion)}


def _body(model: mujoco.MjModel, part: Part) -> int:
    return -1 if part.body < 0 else mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, part.name)
