"""The data of a scene: its model, the roles of bodies in it, and queries about both.

Frames: W world, T tool, O carried object. Batches of configurations are evaluated by `core.kernels`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import final

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Bool, Float, Int
from graceful_plan.path import finite_array
from graceful_plan.scene import roles
from graceful_plan.scene.contacts import allowed_pairs, geoms_named, tested_pairs, without
from graceful_plan.scene.edit import PosedModel
from graceful_plan.scene.elements import AllowedContact, Carried, Component, Contents, Entity, Limits, Notes
from graceful_plan.scene.kinematics import Chain
from graceful_plan.scene.mobile.diff_drive import DiffDrive
from graceful_plan.scene.model_parts import gripper_bodies
from graceful_plan.scene.moving import MovingEntity
from graceful_plan.scene.rest_state import differences


@final
class Layout:
    """Identity of a family of scenes that differ only in the poses of obstacles; equal only to itself."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SceneFacts:
    """The data of a scene. `Scene` adds constructors and methods that return changed scenes.

    | field            | meaning                                                                         |
    |------------------|---------------------------------------------------------------------------------|
    | joints           | names of the planned joints, from the base to the tool                          |
    | qpos_adr         | address of each planned joint in the model's qpos                               |
    | limits           | limits of the planned joints                                                    |
    | home_qpos        | qpos of the whole model: fingers, doors and free bodies in their state         |
    | components       | by name: "body" (the moving links), "carried", "contents"                       |
    | entities         | static entities by name                                                         |
    | moving_severity  | severities by moving entity, then by component                                  |
    | own_severity     | severity of losing the carried object itself; 0 if nothing is carried           |
    | unlabelled       | bodies without an entity class: obstacles only                                  |
    | keyframes        | configurations by name                                                          |
    | allowed_contacts | contacts that are allowed                                                       |
    | robot_bodies     | ids of the robot's bodies                                                       |
    | notes            | everything that was declared                                                    |
    | posed            | model, MjSpec, and the poses of bodies that were moved since it was compiled    |
    """

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
    posed: PosedModel

    @property
    def model(self) -> mujoco.MjModel:
        """The full dynamics model; read only."""
        return self.posed.model

    @property
    def shapes(self) -> mujoco.MjModel:
        """The model, except that moved bodies have earlier poses. If obstacles move often, it is cheaper to read."""
        return self.posed.shapes

    @property
    def spec(self) -> mujoco.MjSpec:
        """The MjSpec from which the model was compiled; copy it before any change."""
        return self.posed.spec

    # --- declarations -------------------------------------------------------------------------------------------------

    @property
    def name(self) -> str:
        """Name of the scene."""
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
        """The contents of the object in the gripper, if any."""
        return None if self.notes.held is None else self.notes.held.contents

    @property
    def base(self) -> DiffDrive | None:
        """The differential-drive base; None if the robot is fixed or its base is holonomic."""
        return self.notes.base

    @property
    def moving(self) -> Mapping[str, MovingEntity]:
        """Moving entities by name. Planners weigh harm to them; they are not obstacles in collision checks."""
        return self.notes.moving

    @property
    def entity_names(self) -> tuple[str, ...]:
        """Names of everything that can be harmed: static entities, then moving ones."""
        return (*self.entities, *self.moving)

    @cached_property
    def layout(self) -> Layout:
        """Identity shared by this scene and all scenes made from it by moving obstacles; see `per_layout`."""
        return Layout()

    @cached_property
    def joint_ids(self) -> tuple[int, ...]:
        """Ids of the planned joints in the model."""
        return tuple(int(np.flatnonzero(self.shapes.jnt_qposadr == adr)[0]) for adr in self.qpos_adr)

    @cached_property
    def held_bodies(self) -> frozenset[int]:
        """Ids of the bodies in the gripper."""
        return roles.held_bodies(self.shapes, self.notes)

    @cached_property
    def gripper_bodies(self) -> frozenset[int]:
        """Ids of the gripper's bodies: those that hang on the last planned joint before the tool."""
        tool = int(self.shapes.site_bodyid[self.shapes.site(self.tool).id])
        return gripper_bodies(self.shapes, tool, self.joint_ids)

    @cached_property
    def endless(self) -> Bool[Array, " nq"]:
        """Which planned joints are hinges without limits: a full turn returns to the same configuration."""
        return np.asarray(self.hinges & (self.shapes.jnt_limited[list(self.joint_ids)] == 0), dtype=bool)

    @cached_property
    def hinges(self) -> Bool[Array, " nq"]:
        """Which planned joints are hinges rather than slides."""
        hinge = self.shapes.jnt_type[list(self.joint_ids)] == int(mujoco.mjtJoint.mjJNT_HINGE)
        return np.asarray(hinge, dtype=bool)

    # --- queries ------------------------------------------------------------------------------------------------------

    def data_at(self, q: ArrayLike) -> mujoco.MjData:
        """Return new MjData at a configuration, with the carried object at the tool. Contacts are not computed.

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

    def pose(self, q: ArrayLike, frame: str | None = None) -> Float[Array, "*batch 4 4"]:
        """Return the pose of a frame in W, as 4 x 4 matrices.

        Frames on the carried object move with the tool. Everything that is not planned is in the state of the scene.

        Args:
            q: Configurations of the planned joints [rad or m].
            frame: Name of a site, body or geom, in this order where a name is used twice; the tool by default.

        Raises:
            UnknownNameError: If there is no such frame.
            ShapeError: If the last axis of `q` does not have one number per planned joint.
            NonFiniteError: If `q` contains a NaN or an infinity.
        """
        return self._chain(frame).pose(finite_array("q", q, last=len(self.joints)))

    def jacobian(self, q: ArrayLike, frame: str | None = None) -> Float[Array, "*batch 6 nq"]:
        """Return the Jacobian of a frame: rows 0 to 2 give its velocity, rows 3 to 5 its angular velocity, both in W.

        Columns are per rad/s for hinges and per m/s for slides. Arguments and errors as in `pose`.
        """
        return self._chain(frame).jacobian(finite_array("q", q, last=len(self.joints)))

    def _chain(self, frame: str | None) -> Chain:
        name = self.tool if frame is None else frame
        if name not in self._chains:
            zero = self.data_at(np.zeros(len(self.joints)))
            self._chains[name] = Chain(zero, self.joint_ids, self.tool, self.carried, name)
        return self._chains[name]

    @cached_property
    def _chains(self) -> dict[str, Chain]:
        """Chains from the world to frames, by the name of the frame."""
        return {}

    def collision_pairs(self) -> Int[Array, "pair 2"]:
        """Return every geom pair to keep apart: pairs that MuJoCo would test and that may not always touch.

        The first geom of a pair belongs to the robot or the carried object; pairs among the surroundings are excluded.
        """
        return self._collision_pairs

    @cached_property
    def _collision_pairs(self) -> Int[Array, "pair 2"]:
        moving = self.robot_bodies | self.held_bodies
        return without(tested_pairs(self.model, moving), self.allowed_pairs("always"))

    def state_differences(self, keyframe: str) -> tuple[str, ...]:
        """Return where a keyframe of the model has fingers, doors and free bodies elsewhere than this scene.

        The object in the gripper is left out, and so is the gripper if its `fingers` are given.
        """
        if keyframe not in self.notes.states:
            return ()
        ignored = self.held_bodies
        if self.notes.fingers is not None or (self.notes.held is not None and self.notes.held.fingers is not None):
            ignored |= self.gripper_bodies
        spared = [j for j in range(self.model.njnt) if int(self.model.jnt_bodyid[j]) in ignored]
        told = differences(self.model, self.home_qpos, self.notes.states[keyframe], [*spared, *self.joint_ids])
        return tuple(told)

    def allowed_pairs(self, when: str) -> frozenset[tuple[int, int]]:
        """Return the geom pairs, lower id first, that may touch "always" or at the "ends" of a path."""
        return allowed_pairs(self.model, self.allowed_contacts, when)

    def geoms_named(self, name: str) -> tuple[int, ...]:
        """Return the geoms that a name in an allowed contact stands for.

        A body name stands for the colliding geoms of the body and of all bodies rigidly attached to it; other names are
        geoms.

        Raises:
            UnknownNameError: If there is neither a body nor a geom of this name.
        """
        return geoms_named(self.model, name)
