"""Replay of a rollout, step by step: the time before the onset of the failure, then its consequences.

The rollout is simulated again from its job, bit-identical to its batch simulation, and drawn. Nothing needs to be
stored.
"""

from __future__ import annotations

import copy
import importlib
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from failbench.basics.errors import NoPicture
from failbench.pictures.drawing import TouchPaint
from failbench.pictures.film import captioned, check_output, write_film
from failbench.pictures.offscreen import Offscreen, find_camera, has_display
from failbench.recording.records import Rollout, RolloutRequest
from failbench.rollouts import single
from failbench.rollouts.execution import Execution
from failbench.simulated.moving_entities import EntityPoses, set_entity_poses
from failbench.simulated.states import CHECKPOINT, STATE, warnings_counted_only
from graceful_plan.exceptions import SettingError

if TYPE_CHECKING:
    from PIL.Image import Image

_BEFORE, _AFTER = "#2a7f4f", "#c2185b"
"""Colours of the caption's strip before and after the onset."""
_NAMES = 4
"""Greatest number of entities that a caption names."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Moment:
    """One step of a film. The next step changes model and data in place.

    Args:
        time: Time since the onset [s], < 0 before it.
        model: The model as currently simulated.
        data: Data after the step; derived quantities belong to the state before it.
        diverged: Whether the simulation has just blown up; this is then the last moment.
    """

    time: float
    model: mujoco.MjModel
    data: mujoco.MjData
    diverged: bool = False


def replay(
    execution: Execution,
    rollout: RolloutRequest | Rollout,
    *,
    output: str | Path | None = None,
    horizon: float = 1.0,
    lead: float = 0.5,
    fps: float = 30.0,
    size: tuple[int, int] = (640, 480),
    camera: str | mujoco.MjvCamera | None = None,
    slow: float = 1.0,
) -> tuple[Path, ...]:
    """Show a failure, and the time before it.

    Entities that are hit turn yellow, except furniture. Arrows point at the contact in the direction of the force, and
    their length grows with the root of the force. Contacts between entities are not drawn.

    Args:
        execution: The healthy run.
        rollout: The failure, as a rollout or its job.
        output: A folder for numbered PNG frames, or a file with the suffix .gif, .webp, .apng or .mp4. None opens
            MuJoCo's viewer, which repeats the film until its window is closed.
        horizon: Shown time after the onset [s].
        lead: Shown time before the onset [s], clamped to the start of the motion.
        fps: Frames per second.
        size: Width and height of the frames [pixels].
        camera: Name of one of the scene's cameras, or a camera. None is "overview" or, without it, a view of
            the whole scene.
        slow: Slow-down factor.

    Returns:
        The written files.

    Raises:
        SettingError: If a number is out of range, or the rollout belongs to another execution.
        FormatError: If the suffix is not supported.
        UnknownNameError: If the scene has no such camera.
        NoPicture: If there is no OpenGL, no display to open a window on, or no encoder for MP4.
    """
    job = _job(execution, rollout)
    _check(execution, horizon, lead, fps, size, slow)
    seen_from = find_camera(execution.world.model, camera)
    if output is None:
        _play(execution, job, seen_from, horizon=horizon, lead=lead, rate=fps * slow, slow=slow)
        return ()
    output = Path(output)
    check_output(output)
    with Offscreen(execution.world.model, *size) as offscreen, warnings_counted_only():
        moments = film(execution, job, horizon=horizon, lead=lead)
        return write_film(_frames(execution, job, moments, fps * slow, offscreen, seen_from), output, fps)


def film(execution: Execution, job: RolloutRequest, *, horizon: float, lead: float) -> Iterator[Moment]:
    """Yield each step of a rollout, from `lead` [s] before the onset to `horizon` [s] after it."""
    onset = execution.checkpoint(job.onset)
    first = max(0, onset - math.ceil(lead / (CHECKPOINT * execution.dt) - 1e-9))
    before = (onset - first) * CHECKPOINT
    for step, (model, data) in enumerate(healthy(execution, first, before)):
        yield Moment(time=(step - before) * execution.dt, model=model, data=data)
    last = None
    for step, (model, data) in enumerate(single.rollout_steps(execution, job, horizon=horizon)):
        diverged = bool(data.warning.number.any())
        if diverged and last is not None:
            # MuJoCo has reset itself to its initial state; the last valid state is shown instead.
            data.qpos[:] = last
            mujoco.mj_kinematics(model, data)
            mujoco.mj_camlight(model, data)
            mujoco.mj_collision(model, data)
        yield Moment(time=step * execution.dt, model=model, data=data, diverged=diverged)
        if diverged:
            return
        last = data.qpos.copy()


def healthy(execution: Execution, checkpoint: int, count: int) -> Iterator[tuple[mujoco.MjModel, mujoco.MjData]]:
    """Yield model and data after each of `count` steps of the healthy robot from a checkpoint on."""
    model = execution.world.model
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, execution.states[checkpoint], STATE)
    for command in execution.commands(checkpoint * CHECKPOINT, count):
        data.ctrl[:] = command
        if model.nmocap:
            set_entity_poses(model, data, EntityPoses(model, execution.world.walkers).rows(np.array([data.time]))[0])
        mujoco.mj_step(model, data)
        yield model, data


def struck_parts(execution: Execution, job: RolloutRequest) -> str:
    """Describe the parts that a job's fault strikes."""
    robot = execution.world.robot
    rng = np.random.default_rng(job.seed)  # the same draw as the injection's
    joints, gripper = robot.struck(job.fault.targets or job.fault.TARGETS, rng, job.fault.rates)
    if len(joints) == len(robot.joints):
        return "whole robot" if gripper else "all joints"
    return ", ".join([robot.joints[j].rpartition("/")[2] for j in joints] + ["gripper"] * gripper)


def _job(execution: Execution, rollout: RolloutRequest | Rollout) -> RolloutRequest:
    if isinstance(rollout, RolloutRequest):
        job = rollout
    else:
        job = rollout.job
        start = execution.states[execution.checkpoint(job.onset)]
        if rollout.state is not None and not np.array_equal(rollout.state, start, equal_nan=True):
            raise SettingError("rollout", f"one of {job.fault.NAME!r}", "a rollout of this execution")
    execution.world.robot.check_targets(job.fault.targets or job.fault.TARGETS)
    return job


def _check(execution: Execution, horizon: float, lead: float, fps: float, size: tuple[int, int], slow: float) -> None:
    dt = execution.dt
    for name, value, least in (("horizon", horizon, dt), ("lead", lead, 0.0), ("fps", fps, 0.1), ("slow", slow, 0.01)):
        if not (math.isfinite(value) and value >= least):
            raise SettingError(name, value, f"a finite number >= {least:g}")
    if fps * slow > 1.0 / dt:
        raise SettingError("fps * slow", fps * slow, f"at most one frame for each time step of {dt:g} s")
    if min(size) < 16 or max(size) > 8192:
        raise SettingError("size", size, "width and height between 16 and 8192 pixels")


def _sampled(touches: TouchPaint, moments: Iterator[Moment], rate: float) -> Iterator[Moment]:
    """Observe all moments; yield `rate` of them per simulated second, and the moment of a divergence."""
    shown, start = 0, None
    for moment in moments:
        touches.observe(moment.model, moment.data, moment.time)
        start = moment.time if start is None else start
        if (moment.time - start) * rate >= shown - 1e-6 or moment.diverged:
            shown += 1
            yield moment


def _frames(
    execution: Execution,
    job: RolloutRequest,
    moments: Iterator[Moment],
    rate: float,
    offscreen: Offscreen,
    camera: mujoco.MjvCamera,
) -> Iterator[Image]:
    touches = TouchPaint(execution.world, execution.baseline)
    heading = f"{job.fault.NAME}, {job.fault.degree}: {struck_parts(execution, job)}"
    for moment in _sampled(touches, moments, rate):
        touches.paint(offscreen.model)
        pixels = offscreen.picture(moment.data, camera, touches.draw)
        late = moment.time >= 0.0
        text = f"{abs(moment.time):.3f} s {'after' if late else 'before'} the onset"
        if touches.struck:
            text += f", hit: {_listed(sorted(touches.struck))}"
        if moment.diverged:
            text += "; the simulation blew up"
        yield captioned(pixels, heading, text, _AFTER if late else _BEFORE)


def _listed(names: list[str]) -> str:
    more = len(names) - _NAMES
    return ", ".join(names[:_NAMES]) + (f" and {more} more" if more > 0 else "")


def _play(
    execution: Execution,
    job: RolloutRequest,
    camera: mujoco.MjvCamera,
    *,
    horizon: float,
    lead: float,
    rate: float,
    slow: float,
) -> None:
    """Open MuJoCo's viewer and play the failure in it until the window is closed."""
    if not has_display():
        raise NoPicture("there is no display to open MuJoCo's viewer on", "give an output, e.g. output='replay.gif'")
    viewers = importlib.import_module("mujoco.viewer")
    shown = mujoco.MjData(copy.copy(execution.world.model))
    with warnings_counted_only(), viewers.launch_passive(shown.model, shown) as viewer:
        with viewer.lock():
            for name in ("type", "fixedcamid", "distance", "azimuth", "elevation"):
                setattr(viewer.cam, name, getattr(camera, name))
            viewer.cam.lookat[:] = camera.lookat
        while viewer.is_running():
            touches = TouchPaint(execution.world, execution.baseline)
            moments = film(execution, job, horizon=horizon, lead=lead)
            _play_once(touches, _sampled(touches, moments, rate), shown, slow, viewer)


def _play_once(touches: TouchPaint, moments: Iterator[Moment], shown: mujoco.MjData, slow: float, viewer: Any) -> None:
    began = None
    for moment in moments:
        if not viewer.is_running():
            return
        with viewer.lock():
            shown.qpos[:], shown.qvel[:], shown.time = moment.data.qpos, moment.data.qvel, moment.time
            shown.mocap_pos[:], shown.mocap_quat[:] = moment.data.mocap_pos, moment.data.mocap_quat
            mujoco.mj_forward(shown.model, shown)
            touches.paint(shown.model)
            viewer.user_scn.ngeom = 0
            touches.draw(viewer.user_scn)
        viewer.sync()
        began = time.monotonic() - moment.time * slow if began is None else began
        time.sleep(max(0.0, began + moment.time * slow - time.monotonic()))
