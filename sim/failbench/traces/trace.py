"""One rollout, step by step: state, contact points with their forces, energies, and pictures.

The rollout is simulated again from its job, bit-identical to its batch simulation. All values of a row belong to one
state: its forces are those that act in it.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from failbench.pictures.offscreen import Offscreen, find_camera
from failbench.recording.contact_query import CARRIED, ROBOT, ContactQuery
from failbench.recording.records import RolloutRequest
from failbench.rollouts.execution import Execution
from failbench.rollouts.sampling import check_whole
from failbench.rollouts.single import rollout_steps
from failbench.simulated.states import warnings_counted_only
from graceful_plan.array_types import Array
from graceful_plan.exceptions import SettingError
from graceful_plan.path import plain_numbers

Rows = dict[str, list[dict[str, Any]]]
"""Rows by table: "steps", "points" and "images"."""


@dataclass(frozen=True, kw_only=True)
class Sampling:
    """Sampled steps and pictures of a rollout.

    Args:
        every: Steps per row.
        images: Steps per picture, a multiple of `every`; 0 for no pictures.
        size: Width and height of pictures [pixels].
        camera: Name of a camera of the scene; None is "overview" or, without it, a view of the whole scene.
    """

    every: int = 5
    images: int = 0
    size: tuple[int, int] = (320, 240)
    camera: str | None = None

    def __post_init__(self) -> None:
        plain_numbers(self)
        check_whole("every", self.every, 1)
        check_whole("images", self.images, 0)
        if self.images % self.every:
            raise SettingError("images", self.images, f"0, or a multiple of every = {self.every}")
        size = self.size if isinstance(self.size, tuple | list) and len(self.size) == 2 else (0, 0)
        for length in size:
            check_whole("size", length, 1, 4096)
        if self.camera is not None and not isinstance(self.camera, str):
            raise SettingError("camera", self.camera, "the name of a camera")


def trace(
    execution: Execution, job: RolloutRequest, *, horizon: float = 1.0, sampling: Sampling | None = None
) -> Iterator[Rows]:
    """Simulate a rollout and yield the rows of each sampled step, without the column `rollout`.

    Args:
        execution: The healthy run.
        job: The fault and its onset.
        horizon: Simulated time after the onset [s].
        sampling: Sampled steps and pictures.

    Raises:
        NoPicture: If pictures are requested and no OpenGL works.
    """
    kept = Sampling() if sampling is None else sampling
    look, names = _Look(execution), _owner_names(execution)
    with ExitStack() as stack:
        stack.enter_context(warnings_counted_only())
        camera = offscreen = None
        if kept.images:
            camera = find_camera(execution.world.model, kept.camera)
            offscreen = stack.enter_context(Offscreen(execution.world.model, *kept.size))
        going = rollout_steps(execution, job, horizon=horizon)
        before = going.state()
        for step, (model, data) in enumerate(going):
            if step % kept.every == 0:
                at = {"step": step, "time": step * execution.dt}
                rows: Rows = {"steps": [at | look.state(model, before, data.ctrl)], "images": []}
                rows["points"] = [at | point for point in _points(model, data, names)]
                if offscreen is not None and camera is not None and step % kept.images == 0:
                    png = _png(offscreen.picture(look.data, camera))
                    rows["images"] = [at | {"image": {"bytes": png, "path": None}}]
                yield rows
            if (step + 1) % kept.every == 0:
                before = going.state()


class _Look:
    """Computes energies of states; its MjData holds the last evaluated state."""

    def __init__(self, execution: Execution) -> None:
        self._robot = execution.world.robot
        self.data = mujoco.MjData(execution.world.model)

    def state(self, model: mujoco.MjModel, before: mujoco.MjData, command: Array) -> dict[str, Any]:
        data, robot = self.data, self._robot
        for name in ("qpos", "qvel", "mocap_pos", "mocap_quat"):
            getattr(data, name)[:] = getattr(before, name)
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_energyPos(model, data)
        mujoco.mj_energyVel(model, data)
        return {
            "q": data.qpos[robot.qpos].tolist(),
            "qd": data.qvel[robot.dofs].tolist(),
            "command": command.tolist(),
            "qpos": data.qpos.tolist(),
            "qvel": data.qvel.tolist(),
            "potential": float(data.energy[0]),
            "kinetic": float(data.energy[1]),
        }


def _points(model: mujoco.MjModel, data: mujoco.MjData, names: list[str]) -> Iterator[dict[str, Any]]:
    """Yield the contacts with a force in the state before a step."""
    wrench = np.zeros(6)
    for i, contact in enumerate(data.contact):
        if contact.efc_address < 0:
            continue  # within the margin, without a force
        mujoco.mj_contactForce(model, data, i, wrench)
        force = wrench[:3] @ contact.frame.reshape(3, 3)
        first, second = (names[geom] for geom in contact.geom)
        yield {
            "first": first,
            "second": second,
            **dict(zip(("x", "y", "z"), contact.pos.tolist(), strict=True)),
            **dict(zip(("fx", "fy", "fz"), force.tolist(), strict=True)),
            "depth": -float(contact.dist),
        }


def _owner_names(execution: Execution) -> list[str]:
    """Return the owner's name of each geom: "body", "carried", an entity, or the name of another body."""
    closeup, model = ContactQuery(execution.world), execution.world.model
    known = {ROBOT: "body", CARRIED: "carried", **dict(enumerate(closeup.entities))}
    bodies = [model.body(int(body)).name or "" for body in model.geom_bodyid]
    return [known.get(int(owner), body) for owner, body in zip(closeup.owner, bodies, strict=True)]


def _png(pixels: Array) -> bytes:
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format="png")
    return buffer.getvalue()
