"""How a scene is assembled from a compiled model and notes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import mujoco

from graceful_plan.scene import roles
from graceful_plan.scene.contacts import declared_contacts
from graceful_plan.scene.couplings import check_couplings
from graceful_plan.scene.edit import PosedModel
from graceful_plan.scene.elements import Notes
from graceful_plan.scene.facts import SceneFacts
from graceful_plan.scene.joint_limits import joint_limits, set_limits
from graceful_plan.scene.model_checks import checked_model
from graceful_plan.scene.model_parts import (
    check_base,
    gripper_bodies,
    names,
    planned_joints,
    robot_bodies,
    tool_body,
)
from graceful_plan.scene.rest_state import (
    model_states,
    rest_state,
    with_openings,
)
from graceful_plan.scene.tasks import find_keyframes, model_keyframes

if TYPE_CHECKING:  # checks of shapes do not take Self outside of a checked class
    from typing import Self

_OBJ = mujoco.mjtObj


@dataclass(frozen=True, kw_only=True, eq=False)
class SceneAssembly(SceneFacts):
    """A scene with constructors for loaders, from MjSpec or compiled models."""

    @classmethod
    def build(cls, spec: mujoco.MjSpec, notes: Notes) -> Self:
        """Build a scene from notes and a MjSpec that must not change any more. For loaders; users call `from_mjcf`."""
        with notes.about("world"):
            model = checked_model(spec)
        with notes.about("robot"):
            set_limits(model, robot_bodies(model, notes.robot), notes.limits)
        return cls.assemble(PosedModel(spec, model), notes)

    @classmethod
    def assemble(cls, posed: PosedModel, notes: Notes) -> Self:
        """Build a scene from notes and a compiled model. For loaders, too."""
        model = posed.model
        with notes.about("robot"):
            robot = robot_bodies(model, notes.robot)
        with notes.about("tool"):
            hand = tool_body(model, notes.tool, robot)
            joints = planned_joints(model, hand, robot, notes.joints)
        with notes.about("robot"):
            check_couplings(model, joints, robot)
            if notes.base is not None:
                check_base(model, joints, notes.base)
            limits = joint_limits(model, joints, notes)
            components = roles.find_components(model, notes, robot)
        gripper = gripper_bodies(model, hand, joints)
        with notes.about("fingers"):
            notes = with_openings(model, robot, joints, gripper, notes)
            home = rest_state(model, robot, joints, gripper, notes)
        qpos_adr = model.jnt_qposadr[list(joints)].astype(int)
        qpos_adr.flags.writeable = False
        notes = replace(
            notes,
            entities=roles.custom_entities(model) | dict(notes.entities),
            # Keyframes are stored here because adding a joint to a MjSpec invalidates them.
            keyframes=model_keyframes(model, qpos_adr) | dict(notes.keyframes),
            states=notes.states or model_states(model, joints),
        )
        return cls(
            joints=tuple(names(model, _OBJ.mjOBJ_JOINT, joints)),
            qpos_adr=qpos_adr,
            limits=limits,
            home_qpos=home,
            components=components,
            entities=roles.find_entities(model, notes, robot, components),
            moving_severity=roles.moving_severities(model, notes, components),
            own_severity=roles.own_severity(notes, components),
            unlabelled=roles.unlabelled_bodies(model, notes, robot),
            keyframes=find_keyframes(notes, len(joints)),
            allowed_contacts=declared_contacts(model, notes, gripper),
            notes=notes,
            robot_bodies=robot,
            posed=posed,
        )
