"""The scene: robot, surroundings and their declarations. Constructors of scenes from MJCF or URDF, and tasks."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, final

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SettingError, names_file
from graceful_plan.path import finite_array
from graceful_plan.scene.changes import SceneChanges
from graceful_plan.scene.couplings import warn_of_couplings
from graceful_plan.scene.elements import AllowedContact, Contents, EntityAnnotation, Fingers, Notes, Opening
from graceful_plan.scene.harm.severity import SeverityTable, given_severity
from graceful_plan.scene.loading.concave import divide_surroundings
from graceful_plan.scene.loading.extents import warn_of_extents
from graceful_plan.scene.loading.self_contacts import (
    MAX_OVERLAP_FRACTION,
    link_contacts,
    touching,
    warn_of_overlapping_links,
    warn_of_untested_links,
)
from graceful_plan.scene.mobile.diff_drive import DiffDrive
from graceful_plan.scene.mobile.wheels import described_drive
from graceful_plan.scene.model_parts import add_tool
from graceful_plan.scene.specs import load_spec
from graceful_plan.scene.summary import summary
from graceful_plan.scene.tasks import check_keyframes, task_ends
from graceful_plan.scene.urdf.composing import TOOL, chosen_joints, composed, velocities
from graceful_plan.scene.urdf.reading import Packages, read_urdf
from graceful_plan.scene.urdf.srdf import no_srdf, read_srdf


@final
class Scene(SceneChanges):
    """A robot among entities that can be harmed. Created by `load_scene` or `Scene.from_mjcf`.

    Scenes are immutable and equal only to themselves: `attach`, `with_severity`, `add_box` and others return new ones.
    """

    def __deepcopy__(self, memo: object) -> Scene:
        """Return the scene itself, which is immutable."""
        return self

    def __reduce__(self) -> Any:
        """Refuse pickling.

        Raises:
            TypeError: Always; the message says why.
        """
        raise TypeError(f"the Scene {self.name!r} holds a MuJoCo model and cannot be pickled; load it in each process")

    @classmethod
    @names_file
    def from_mjcf(
        cls,
        source: str | Path | mujoco.MjSpec,
        *,
        robot: str,
        tool: str,
        carried: str | None = None,
        at: ArrayLike | str | None = None,
        X_TO: ArrayLike | None = None,
        contents: Contents | None = None,
        entities: Mapping[str, str | EntityAnnotation] | None = None,
        severity: SeverityTable | Mapping[str, Any] | str | Path | None = None,
        joints: Sequence[str] | None = None,
        state: Mapping[str, float | ArrayLike] | str | None = None,
        fingers: Fingers | None = None,
        limits: Mapping[str, tuple[float, float]] | None = None,
        velocity: Sequence[float] | None = None,
        acceleration: Sequence[float] | None = None,
        torque: Sequence[float] | None = None,
        keyframes: Mapping[str, ArrayLike] | None = None,
        allowed_contacts: Sequence[AllowedContact] = (),
        self_collision: str = "model",
        convex: str | None = None,
        folder: str | Path | None = None,
        visuals: bool = True,
        body_class: str = "arm_collapse",
        base: DiffDrive | None = None,
        name: str | None = None,
    ) -> Scene:
        """Create a scene from any MJCF model that contains an arm.

        Args:
            source: MJCF file, MJCF text or a MjSpec. Files and text are screened for hostile content first, and may
                refer only to files in their own folder and below, or in `folder`; a MjSpec is trusted.
            robot: Prefix of the robot's body names, e.g. "panda/", or the name of its root body. Bodies below these are
                parts of the robot, whatever their names.
            tool: Name of a site that serves as the tool, or of a body whose frame does.
            carried: Body in the gripper, if any: its parent is the world, and it is no entity while it is held. `at`,
                `X_TO` and `contents` as in `attach`, which also takes other objects later.
            at: Configuration in which the gripper holds the carried body where it is.
            X_TO: Pose of the carried body in the tool frame, instead of `at`, such as `FROM_ABOVE`.
            contents: Contents of the carried body, a `Liquid` or `Granular`; they can spill, and motions keep them in.
                A geom that does not collide, "<body>_contents", has their shape: an upright cylinder.
            entities: Class of each body that can be harmed, by body name, such as "glass", "laptop" or "adult"; it
                applies to the body's subtree. The class selects the row of the `SeverityTable`, which lists all in
                `SeverityTable.shipped().classes`. The model can declare the same in custom text:
                `<text name="entity/BODY" data="CLASS"/>`. Bodies without a class are obstacles only.
            severity: A table, a file with one, or replacements as in `with_severity`.
            joints: Joints to plan, in the order of the model, such as those of two arms. Default: the hinges and slides
                between the world and the tool. All other joints stay in their `state`.
            state: State of everything that is not planned, as in `with_state`; or the name of a keyframe of the model.
                Default: the model's initial state.
            fingers: Position of the joints of the gripper, which is everything that hangs on the last planned joint;
                positions by joint name; or an `Opening` in metres. With a carried body, `Opening()` closes the fingers
                on it. Joints that follow others by equalities follow.
            limits: Lower and upper limit by joint, to replace the model's [rad or m].
            velocity: Limit of each planned joint [rad/s or m/s]. Default: the model's custom numeric
                "<robot>velocity_limit".
            acceleration: Limit of each planned joint [rad/s2 or m/s2]. Default: custom numeric
                "<robot>acceleration_limit".
            torque: Limit of each planned joint [N m or N]. Default: the model's actuators; infinite if unlimited.
            keyframes: Configurations by name, in addition to the model's keyframes.
            allowed_contacts: Contacts to allow in addition to those of gripper and carried object.
            self_collision: "model": the model's filters decide which links may touch; a warning is logged if they let
                all links touch. "links": links may not touch, except pairs with a joint in between, pairs that overlap
                in nearly all configurations, and excluded pairs. `describe` lists them.
            convex: What meshes of the surroundings count as. "hull": their convex hulls. "parts": convex parts if the
                hull sticks out of the mesh by 2.5 cm, as of bins, mugs and racks. With None, parts if the library
                `coacd` is installed, else hulls, with a warning that names them.
            folder: Folder that contains all files of the model, for models whose `meshdir` leads out of their own
                folder.
            visuals: Whether to keep textures, materials and geoms that do not collide, also those that show contents.
                Without them, scenes load faster, bodies keep their mass, and the files of textures are neither checked
                nor read.
            body_class: How the arm fails: "arm_collapse", "arm_braked" or "base_coast".
            base: Drive of a mobile base. Default: the model's custom numerics and texts "<robot>drive/FIELD". Without
                it, planar joints move in all directions.
            name: Name of the scene; the model's name by default.

        Raises:
            SceneError: If the model is broken or hostile.
            SettingError: If the source is not in `folder`, or `self_collision` is unknown.
            UnsupportedError: If the model has unsupported features, such as equalities that restrict planned joints, or
                `convex` is "parts" and `coacd` is missing.
            UnknownNameError: If a body, site, joint or class does not exist.
        """
        spec = load_spec(source, folder, visuals=visuals)
        add_tool(spec, tool)
        divide_surroundings(spec, robot, convex)
        overlaps = link_contacts(spec, robot, tool, self_collision, allowed_contacts, joints)
        table, overrides = given_severity(severity)
        closes = carried is not None and isinstance(fingers, Opening)  # on the object, which is attached below
        notes = Notes(
            name=name or spec.modelname,
            robot=robot,
            tool=tool,
            joints=None if joints is None else tuple(joints),
            body_class=body_class,
            fingers=None if closes else fingers,
            limits=dict(limits or {}),
            velocity=None if velocity is None else tuple(velocity),
            acceleration=None if acceleration is None else tuple(acceleration),
            torque=None if torque is None else tuple(torque),
            base=base or described_drive(spec, robot, joints),
            entities={
                k: v if isinstance(v, EntityAnnotation) else EntityAnnotation(category=v)
                for k, v in (entities or {}).items()
            },
            severity=table,
            overrides=overrides,
            keyframes={k: tuple(finite_array(f"keyframe {k}", q, ndim=1)) for k, q in (keyframes or {}).items()},
            allowed=(*overlaps, *allowed_contacts),
        )
        scene = cls.build(spec, notes)
        check_keyframes(notes, scene.limits)
        scene = scene if state is None else scene.in_state(state)
        if carried is not None:
            scene = scene.attach(carried, at=at, X_TO=X_TO, contents=contents, fingers=fingers if closes else None)
        warn_of_mistakes(scene)
        return scene

    @classmethod
    @names_file
    def from_urdf(
        cls,
        source: str | Path,
        *,
        tool: str,
        acceleration: float | Sequence[float],
        packages: Packages = (),
        srdf: str | Path | None = None,
        world: str | Path | mujoco.MjSpec | None = None,
        pose: ArrayLike | None = None,
        joints: Sequence[str] | None = None,
        group: str | None = None,
        state: Mapping[str, float | ArrayLike] | str | None = None,
        velocity: Sequence[float] | None = None,
        fingers: Fingers | None = None,
        decompose: bool | Collection[str] | None = None,
        convex: str | None = None,
        limits: Mapping[str, tuple[float, float]] | None = None,
        allowed_contacts: Sequence[AllowedContact] = (),
        keyframes: Mapping[str, ArrayLike] | None = None,
        entities: Mapping[str, str | EntityAnnotation] | None = None,
        severity: SeverityTable | Mapping[str, Any] | str | Path | None = None,
    ) -> Scene:
        """Create a scene from a robot in URDF, with or without a world. Names get the prefix "<robot name>/".

        Links with a joint in between may touch, and so may links that overlap in nearly all configurations, because the
        convex hulls of meshes can overlap where the meshes do not. Only collision geometry is used. If hulls touch each
        other in many configurations, meshes far from convex are divided into convex parts; the first time, this takes
        ten seconds per mesh.

        Args:
            source: URDF file, or its text.
            tool: Link whose frame is that of the tool.
            acceleration: Limit of each planned joint, or one for all [rad/s2 or m/s2]; URDF has none.
            packages: Folders to resolve `package://`: packages, folders that contain packages, or folders by package
                name. The folders above the file are searched as well. Meshes by other paths are read from there, from
                the folder of the file, and from the ROS package that it is in; all others are refused.
            srdf: SRDF file or text, for groups, link pairs that may touch, and group states as keyframes. States that
                exceed limits by rounding are clamped, positions farther outside are left out; both log a warning.
            world: MJCF of the surroundings, as in `from_mjcf`.
            pose: Of the robot's root link in W, 4 x 4.
            joints: Joints to plan, in the order of the model. Default: those between the base and the tool.
            group: Group of the SRDF with the joints to plan, instead of `joints`.
            state: As in `from_mjcf`; a name is that of a group state.
            velocity: Limit of each planned joint [rad/s or m/s]; those of the URDF by default.
            fingers: As in `from_mjcf`; mimic joints follow.
            decompose: Whether to divide meshes into convex parts. With None they are divided if links touch in many
                configurations and the library `coacd` is installed; if it is not installed, a warning is logged. Names
                of links divide their meshes closely, such as jaws whose hulls overlap where an object would be.
            convex: As in `from_mjcf`, for the meshes of the world.
            limits: As in `from_mjcf`.
            allowed_contacts: Contacts to allow in addition.
            keyframes: Configurations by name.
            entities: As in `from_mjcf`.
            severity: As in `from_mjcf`.

        Raises:
            SceneError: If a file is broken, hostile or missing.
            UnsupportedError: If the robot has unsupported features, or `decompose` asks for parts without `coacd`.
            SettingError: If both `joints` and `group` are given.
            UnknownNameError: If there is no such link, joint, group or state.
        """
        robot = read_urdf(source, packages, decompose=decompose or False)
        prefix = f"{robot.name}/"
        told = no_srdf() if srdf is None else read_srdf(srdf).within(robot, limits or {})
        chain = chosen_joints(robot, told, tool, joints, group)
        planned = None if joints is None and group is None else [prefix + joint.name for joint in chain]
        disabled = told.contacts(robot)
        spec = composed(robot, tool, world, pose)
        touches = touching(spec, prefix, prefix + TOOL, (*disabled, *allowed_contacts), planned)
        if decompose is None and touches.often > MAX_OVERLAP_FRACTION:
            spec = composed(read_urdf(source, packages, decompose=None), tool, world, pose)
            touches = touching(spec, prefix, prefix + TOOL, (*disabled, *allowed_contacts), planned)
        touches.warn()
        scene = cls.from_mjcf(
            spec,
            robot=prefix,
            tool=prefix + TOOL,
            joints=planned,
            entities=entities,
            severity=severity,
            fingers=fingers,
            convex=convex,
            limits=limits,
            velocity=velocities(chain) if velocity is None else velocity,
            acceleration=[acceleration] * len(chain)
            if isinstance(acceleration, int | float | np.number)
            else acceleration,
            keyframes={**told.keyframes([joint.name for joint in chain]), **(keyframes or {})},
            allowed_contacts=(*touches.contacts, *disabled, *allowed_contacts),
            name=robot.name,
        )
        states = {**scene.notes.states, **told.others(robot, chain)}
        scene = replace(scene, notes=replace(scene.notes, states=states))
        return scene if state is None else scene.in_state(state)

    @cached_property
    def tasks(self) -> Mapping[str, Task]:
        """The declared tasks by name."""
        tasks = {}
        for name, note in self.notes.tasks.items():
            start, goal = task_ends(self, name)
            tasks[name] = Task(
                name=name,
                start=start,
                goal=goal,
                description=note.description,
                object_name=note.object_name,
                support=note.support,
                world=self,
            )
        return MappingProxyType(tasks)

    def describe(self) -> str:
        """Return a readable summary: robot, components, entities with severities, allowed contacts with reasons."""
        return summary(self, {name: task.description for name, task in self.tasks.items()})


@dataclass(frozen=True, kw_only=True, eq=False)
class Task:
    """A planning task in a scene: a start, alternative goals, and the object to carry.

    Without a declared grasp, the gripper holds the object where it is at the start. `goal` has one row per goal.
    `scene` is created on first use, with the object in the gripper.
    """

    name: str
    start: Float[Array, " nq"]
    goal: Float[Array, "goal nq"]
    description: str
    object_name: str | None
    support: tuple[str, ...]
    world: Scene

    @cached_property
    def scene(self) -> Scene:
        """The scene with the task's object attached and contacts with its supports allowed at the ends."""
        if self.object_name is None:
            return self.world
        declared = self.world.notes.objects[self.object_name].X_TO
        return self.world.attach(self.object_name, at=self.start if declared is None else None, support=self.support)


def warn_of_mistakes(scene: Scene) -> None:
    """Log warnings of probable mistakes in a loaded model: in links, their sizes, and couplings that are ignored."""
    warn_of_untested_links(scene.model, scene.robot_bodies, scene.robot)
    warn_of_overlapping_links(
        scene.model, scene.home_qpos, scene.robot_bodies, scene.joint_ids, scene.collision_pairs()
    )
    warn_of_extents(scene.model, scene.spec, scene.robot_bodies, scene.joint_ids)
    warn_of_couplings(scene.model, scene.joint_ids, scene.robot_bodies, scene.held_bodies)


def checked_scene(scene: object) -> Scene:
    """Return a scene; refuse other objects.

    Raises:
        SettingError: If it is none.
    """
    if not isinstance(scene, Scene):
        raise SettingError("scene", scene, "a Scene, such as load_scene() returns")
    return scene
