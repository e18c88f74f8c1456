"""What is known of a scene: its model, roles of what is in it, and answers to questions about these.

Frames: W world, T tool, O carried object. Batches of configurations are the business of `core.kernels`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import final

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Bool, Float, Int
from graceful_plan.path import finite_array
from graceful_plan.scene import roles
from graceful_plan.scene.contacts import allowed_pairs, geoms_named, tested_pairs, without
from graceful_plan.scene.elements import AllowedContact, Carried, Component, Contents, Entity, Limits, Notes
from graceful_plan.scene.mobile.diff_drive import DiffDrive
from graceful_plan.scene.moving import MovingEntity

Array = np.ndarray


@final
class Layout:
    """What scenes share that differ only by where things around the robot stand; equal only to itself."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SceneFacts:
    """A robot among things that can be harmed, as it is; `Scene` makes it, and other scenes of it.

    | field            | meaning                                                                         |
    |------------------|---------------------------------------------------------------------------------|
    | model            | the full dynamics model; read only                                              |
    | joints           | names of the planned joints, from the base to the tool                          |
    | qpos_adr         | address of each planned joint in the model's qpos                               |
    | limits           | what the planned joints can do                                                  |
    | home_qpos        | qpos of everything: fingers as they are held, entities at their initial poses   |
    | components       | by name: "body" (the links that move), "carried", "contents"                    |
    | entities         | by name: what can be harmed and stays where it is                               |
    | moving_severity  | by name of a moving entity, then by component                                   |
    | own_severity     | of the loss of the carried object itself; 0 if nothing is carried               |
    | unlabelled       | bodies that are obstacles and nothing else, since nobody said what they are     |
    | keyframes        | configurations by name                                                          |
    | allowed_contacts | what may touch                                                                  |
    | robot_bodies     | ids of the robot's bodies                                                       |
    | notes            | everything that was declared                                                    |
    | spec             | what the model was compiled from; copy it before any change                     |
    """

    model: mujoco.MjModel
    joints: tuple[str, ...]
    qpos_adr: Int[Array, " nq"]
    limits: Limits
    home_qpos: Float[Array, " model_nq"]
    components: Mapping[str, Component]
    entities: Mapping[str, Entity]
    moving_severity: Mapping[str, Mapping[str, float]]
    own_severity: float
    unlabelled: tuple[str, ...]
    keyframes: Mapping[str, Float[Array, " nq"]]
    allowed_contacts: tuple[AllowedContact, ...]
    robot_bodies: frozenset[int]
    notes: Notes
    spec: mujoco.MjSpec

    # --- what was declared --------------------------------------------------------------------------------------------

    @property
    def name(self) -> str:
        """What the scene is called."""
        return self.notes.name

    @property
    def robot(self) -> str:
        """Prefix of the robot's body names, or the name of its root body."""
        return self.notes.robot

    @property
    def tool(self) -> str:
        """Name of the tool site."""
        return self.notes.tool

    @property
    def carried(self) -> Carried | None:
        """The object in the gripper, if any."""
        held = self.notes.held
        if held is None or held.X_TO is None or held.object_class is None:
            return None
        return Carried(body=held.body, X_TO=held.X_TO, object_class=held.object_class)

    @property
    def contents(self) -> Contents | None:
        """What is inside of the object in the gripper, if anything."""
        return None if self.notes.held is None else self.notes.held.contents

    @property
    def base(self) -> DiffDrive | None:
        """How the robot drives; None if it stands still, or if its base moves in all directions."""
        return self.notes.base

    @property
    def moving(self) -> Mapping[str, MovingEntity]:
        """Entities that move, by name: hazards that planners weigh, not obstacles that anything collides with."""
        return self.notes.moving

    @property
    def hazards(self) -> tuple[str, ...]:
        """Names of all that can be harmed: entities, then entities that move."""
        return (*self.entities, *self.moving)

    @cached_property
    def layout(self) -> Layout:
        """Stands for this scene and those that were made of it by moving obstacles; see `per_layout`."""
        return Layout()

    @cached_property
    def endless(self) -> Bool[Array, " nq"]:
        """Which planned joints are hinges without limits: a turn of them leads back to where they were."""
        model = self.model
        joints = [int(np.flatnonzero(model.jnt_qposadr == adr)[0]) for adr in self.qpos_adr]
        hinge = model.jnt_type[joints] == int(mujoco.mjtJoint.mjJNT_HINGE)
        return np.asarray(hinge & (model.jnt_limited[joints] == 0), dtype=bool)

    # --- questions ----------------------------------------------------------------------------------------------------

    def data_at(self, q: ArrayLike) -> mujoco.MjData:
        """Return fresh MjData at a configuration, the carried object at the tool. Contacts are not computed.

        Args:
            q: Configuration of the planned joints [rad or m].
        """
        data = mujoco.MjData(self.model)
        data.qpos[:] = self.home_qpos
        data.qpos[self.qpos_adr] = finite_array("q", q, ndim=1, last=len(self.joints))
        mujoco.mj_kinematics(self.model, data)
        if self.carried is not None:
            site = data.site(self.tool)
            R_WO = site.xmat.reshape(3, 3) @ self.carried.X_TO[:3, :3]
            body = self.model.body(self.carried.body).id
            adr = roles.free_joint(self.model, body)
            data.qpos[adr : adr + 3] = site.xpos + site.xmat.reshape(3, 3) @ self.carried.X_TO[:3, 3]
            mujoco.mju_mat2Quat(data.qpos[adr + 3 : adr + 7], R_WO.ravel())
            mujoco.mj_kinematics(self.model, data)
        mujoco.mj_comPos(self.model, data)
        return data

    def collision_pairs(self) -> Int[Array, "pair 2"]:
        """Return every pair of geoms to keep apart: those that MuJoCo would test, less what may always touch.

        The first geom of a pair is one of the robot or the carried object. Pairs among the surroundings are not in it.
        """
        return self._collision_pairs

    @cached_property
    def _collision_pairs(self) -> Int[Array, "pair 2"]:
        moving = self.robot_bodies | roles.held_bodies(self.model, self.notes)
        return without(tested_pairs(self.model, moving), self.allowed_pairs("always"))

    def allowed_pairs(self, when: str) -> frozenset[tuple[int, int]]:
        """Return the pairs of geoms, lower id first, that may touch "always" or at the "ends" of a path."""
        return allowed_pairs(self.model, self.allowed_contacts, when)

    def geoms_named(self, name: str) -> tuple[int, ...]:
        """Return the geoms that a name in an allowed contact stands for.

        A body stands for its own geoms that collide and those of what hangs rigidly on it; otherwise it is a geom.

        Raises:
            UnknownNameError: If there is neither.
        """
        return geoms_named(self.model, name)
