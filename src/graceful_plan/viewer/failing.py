"""Failures on demand: FailBench breaks the robot at a moment of a motion; what it hits stands beside what is expected.

FailBench builds on this library, so it is imported only when somebody asks for a failure.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, final

import mujoco
import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.costs.fault_prior import DEGREES, REACTIONS, FaultPrior, shipped_effects
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.models.mixture.mixture import Footprint
from graceful_plan.exceptions import SettingError, UnknownNameError
from graceful_plan.mobile.coast.coast import Coast
from graceful_plan.mobile.coast.constants import CoastSettings
from graceful_plan.scene.scene import Scene
from graceful_plan.viewer.poses import Poses
from graceful_plan.viewer.recorded import RecordedRollouts
from graceful_plan.viewer.shapes import Part, parts
from graceful_plan.viewer.shown import ShownMotion, impact_by_entity

Array = np.ndarray

_HORIZON, _COASTING = 1.5, 4.0
"""How long is simulated after the failure of an arm, and of a base [s]."""
_STEP = 1.0 / 60.0
"""Time between frames [s]."""
_DEGREE = "severe"
"""What `shipped_effects` are of by default."""
_SAME_HARM = 1e-6
"""By how much harm may differ that is the same."""


@final
@dataclass(frozen=True, kw_only=True)
class Failure:
    """What fails, how badly and when.

    Args:
        fault: One of `faults_of(scene)`.
        degree: One of `DEGREES`; of no account for bases.
        moment: Share of the motion that is done by then, in [0, 1].
        seed: Of what is random about it.

    Raises:
        SettingError: If the moment is not a share.
        UnknownNameError: If there is no such degree.
    """

    fault: str
    degree: str = "severe"
    moment: float = 0.5
    seed: int = 0

    def __post_init__(self) -> None:
        if not 0.0 <= self.moment <= 1.0:
            raise SettingError("moment", self.moment, "a share of the motion, in [0, 1]")
        if self.degree not in DEGREES:
            raise UnknownNameError("degree", self.degree, DEGREES)


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Replay:
    """A failure to look at: the motion up to it, then what was simulated.

    | field     | meaning                                                               | unit | shape |
    |-----------|-----------------------------------------------------------------------|------|-------|
    | failure   | what failed                                                           |      |       |
    | label     | of the motion                                                         |      |       |
    | onset     | when, after the start of the motion                                   | s    |       |
    | t         | time of each frame, after the start of the motion                     | s    | frame |
    | poses     | of each drawn part                                                    |      |       |
    | predicted | harm to expect of such a failure then, by entity; none is left out    |      |       |
    | observed  | harm in this simulation, by entity; none is left out                  |      |       |
    | hits      | what touched whom, when [s after the onset] and where, in W           |      |       |
    | notes     | what else there is to say                                             |      |       |
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
        """When the last frame is [s]."""
        return float(self.t[-1])

    def frame(self, t: float) -> int:
        """Return the frame that is nearest to a time [s]."""
        return int(np.argmin(np.abs(self.t - t)))


def faults_of(scene: Scene) -> tuple[str, ...]:
    """Name what can fail in a scene: faults of FailBench; of a base that drives, the ways in which it comes to rest."""
    if scene.base is not None:
        return tuple(CoastSettings.shipped().ways)
    names = tuple(name for name in shipped_effects() if name not in REACTIONS)
    first = "gripper_failure"
    return (first, *(name for name in names if name != first)) if scene.carried is not None else names


@final
class FailureBench:
    """Simulates failures of motions; the healthy execution of the last motion is kept."""

    def __init__(self) -> None:
        self._kept: tuple[ShownMotion, Any, tuple[str, ...]] | None = None

    def replay(self, failure: Failure, motion: ShownMotion) -> Replay:
        """Let the robot fail once along a motion.

        Raises:
            UnknownNameError: If there is no such fault.
            SettingError: If nothing can come of the fault in this scene.
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
        job = _failbench().Job(
            fault=kind(degree=failure.degree), onset=failure.moment * motion.duration, seed=failure.seed
        )
        execution, notes = self._execution(motion)
        return _arm_replay(failure, motion, (execution, job, _HORIZON), notes)

    def _execution(self, motion: ShownMotion) -> tuple[Any, tuple[str, ...]]:
        if self._kept is None or self._kept[0] is not motion:
            self._kept = (motion, *_executed(motion))
        return self._kept[1:]


def recorded_replay(rollouts: RecordedRollouts, number: int) -> Replay:
    """Let a rollout of a dataset happen once more, as it was simulated for it.

    Raises:
        SettingError: If its fault is in a file of somebody's own, which is not run here.
    """
    work, row = importlib.import_module("failbench.sweeps.work"), rollouts[number]
    motion_index, fault_index, i = rollouts.sweep.place(number)
    if file := work.own_file(rollouts.sweep.faults[fault_index]):
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
    """Carry the motion out; by a constraint in the gripper if friction alone does not hold the object."""
    fb = _failbench()
    try:
        return fb.execute(motion.trajectory, fb.build_world(motion.scene)), ()
    except fb.ObjectLost as lost:
        world = fb.build_world(motion.scene, fb.SimSettings(grasp="weld"))
        return fb.execute(motion.trajectory, world), (f"The healthy grip slips ({lost}); here a constraint holds it.",)


def _arm_replay(
    failure: Failure, motion: ShownMotion, simulated: tuple[Any, Any, float], notes: tuple[str, ...]
) -> Replay:
    """Simulate a job of an execution for so many seconds after its onset."""
    fb, scene = _failbench(), motion.scene
    execution, job, horizon = simulated
    (rollout,) = fb.run(execution, [job], horizon=horizon)
    each = max(1, round(_STEP / execution.dt))
    states = (data for _, data in fb.steps(execution, job, horizon=horizon))
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
        predicted=_predicted(motion, rollout.onset, ImpactCost(model=Footprint(faults=prior))),
        observed={name: float(x) for name, x in score.impact_by_entity(rollout, scene).items() if x > 0.0},
        hits=tuple((event.striker, event.entity, event.time, event.position) for event in rollout.events),
        notes=notes,
    )


def _effects(degree: str) -> tuple[Any, tuple[str, ...]]:
    """Return what faults of a degree act like, and what there is to say if that is known of another degree only."""
    try:
        return shipped_effects(degree), ()
    except UnknownNameError:
        return shipped_effects(), (f"Predicted as for {_DEGREE} ones: what {degree} faults act like was not fitted.",)


def _said(rollout: Any, scene: Scene) -> tuple[str, ...]:
    if rollout.status != "completed":
        return ("The simulation blew up; nothing of it counts.",)
    said = []
    if rollout.dropped and scene.carried is not None:
        said.append(f"{scene.carried.body} left the gripper.")
    if rollout.spilled > 0.0:
        said.append(f"{rollout.spilled:.0%} of its contents are spilt.")
    return tuple(said)


def _base_replay(failure: Failure, motion: ShownMotion) -> Replay:
    """Let a base fail on its wheels; of what it carries nothing is simulated."""
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
        notes=() if motion.scene.carried is None else ("What the base carries is left out of the simulation.",),
    )


def _predicted(motion: ShownMotion, onset: float, impact: ImpactCost) -> dict[str, float]:
    """Return the harm to expect of a failure at a time by entity, without those whom it spares."""
    values = impact_by_entity(motion.trajectory, motion.scene, np.array([onset]), impact)[0]
    found = zip(impact.hazards(motion.scene), values.tolist(), strict=True)
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
        if part.body < 0:  # what walks goes on as predicted
            place = motion.scene.moving[part.name].at(t)
            position[:, k] = place.position
    return {"t": t, "poses": Poses(position, quaternion)}


def _body(model: mujoco.MjModel, part: Part) -> int:
    return -1 if part.body < 0 else mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, part.name)
