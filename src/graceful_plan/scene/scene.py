"""The scene: robot, surroundings and their declarations. Constructors and edits of scenes, from MJCF or URDF.

A `Scene` is immutable: `attach`, `detach`, `with_severity`, `add_*` and others return new scenes. Frames: W world,
T tool, O carried object. Batches of configurations are evaluated by `core.kernels`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, final

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Float
from graceful_plan.exceptions import SceneError, SettingError, names_file
from graceful_plan.path import finite_array
from graceful_plan.scene import roles
from graceful_plan.scene.contacts import declared_contacts
from graceful_plan.scene.couplings import check_couplings, warn_of_couplings
from graceful_plan.scene.edit import PosedModel, StaticBody, moved, removed
from graceful_plan.scene.elements import Adhesion, AllowedContact, Contents, EntityAnnotation, Fingers, Notes, Opening
from graceful_plan.scene.facts import SceneFacts
from graceful_plan.scene.harm.severity import SeverityTable, given_severity
from graceful_plan.scene.joint_limits import joint_limits, set_limits
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
from graceful_plan.scene.model_checks import checked_model
from graceful_plan.scene.model_parts import (
    add_tool,
    check_base,
    find,
    gripper_bodies,
    names,
    planned_joints,
    robot_bodies,
    subtree,
    tool_body,
)
from graceful_plan.scene.moving import MovingEntity
from graceful_plan.scene.rest_state import (
    given_state,
    keyframe_state,
    model_states,
    rest_state,
    with_openings,
    without_bodies,
)
from graceful_plan.scene.sensed.cloud import PointCloud
from graceful_plan.scene.sensed.height_map import HeightMap
from graceful_plan.scene.specs import load_spec
from graceful_plan.scene.summary import summary
from graceful_plan.scene.tasks import check_keyframes, find_keyframes, model_keyframes, named_configuration, task_ends
from graceful_plan.scene.urdf.composing import TOOL, chosen_joints, composed, velocities
from graceful_plan.scene.urdf.reading import Packages, read_urdf
from graceful_plan.scene.urdf.srdf import no_srdf, read_srdf

Array = np.ndarray

_OBJ = mujoco.mjtObj
_GEOM = mujoco.mjtGeom


@final
class Scene(SceneFacts):
    """A robot among entities that can be harmed. Created by `load_scene` or `Scene.from_mjcf`; equal only to itself."""

    def __deepcopy__(self, memo: object) -> Scene:
        """Return the scene itself, which is immutable."""
        return self

    def __reduce__(self) -> Any:
        """Refuse pickling.

        Raises:
            TypeError: Always; the message says why.
        """
        raise TypeError(f"the Scene {self.name!r} holds a MuJoCo model and cannot be pickled; load it in each process")

    # --- constructors -------------------------------------------------------------------------------------------------

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
        decompose: bool | None = None,
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
                configurations and the library `coacd` is installed; if it is not installed, a warning is logged.
            convex: As in `from_mjcf`, for the meshes of the world.
            limits: As in `from_mjcf`.
            allowed_contacts: Contacts to allow in addition.
            keyframes: Configurations by name.
            entities: As in `from_mjcf`.
            severity: As in `from_mjcf`.

        Raises:
            SceneError: If a file is broken, hostile or missing.
            UnsupportedError: If the robot has unsupported features, or `decompose` is True without `coacd`.
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

    @classmethod
    def build(cls, spec: mujoco.MjSpec, notes: Notes) -> Scene:
        """Build a scene from notes and a MjSpec that must not change any more. For loaders; users call `from_mjcf`."""
        with notes.about("world"):
            model = checked_model(spec)
        with notes.about("robot"):
            set_limits(model, robot_bodies(model, notes.robot), notes.limits)
        return cls.assemble(PosedModel(spec, model), notes)

    @classmethod
    def assemble(cls, posed: PosedModel, notes: Notes) -> Scene:
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

    # --- tasks and summary --------------------------------------------------------------------------------------------

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

    # --- new scenes ---------------------------------------------------------------------------------------------------

    def attach(
        self,
        name: str,
        *,
        at: ArrayLike | str | None = None,
        X_TO: ArrayLike | None = None,
        contents: Contents | None = None,
        object_class: str | None = None,
        fingers: Fingers | None = None,
        grip: Adhesion | None = None,
        support: Sequence[str] = (),
    ) -> Scene:
        """Return this scene with an object in the gripper, which may touch it; it is no longer an entity or obstacle.

        Args:
            name: Name of an object of the scene, or of any body whose parent is the world.
            at: Configuration or keyframe in which the gripper holds the object where it is in this scene.
            X_TO: Pose of the object's body in the tool frame, instead of `at`, such as `FROM_ABOVE`: the body's origin
                at the tool, upright while the tool points down. Default: as declared for the object.
            contents: Contents of the object, a `Liquid` or `Granular`, in the shape of its geom "<body>_contents".
                Default: as declared.
            object_class: "light" (below 0.2 kg), "medium" (up to 1 kg), "heavy", "sharp" or "glass". Default: as
                declared, else by mass.
            fingers: Position of the gripper's joints while carrying, positions by joint name, or an `Opening`;
                `Opening()` closes the fingers on the object. Default: as declared.
            grip: Vacuum cup or magnet that holds the object, instead of fingers. Default: as declared.
            support: Bodies or geoms that the object may touch at the ends of a path, because it stands on them there.

        Raises:
            SceneError: If an object is in the gripper already.
            SettingError: If both `at` and `X_TO` are given, or neither and no grasp is declared.
            UnknownNameError: If there is no such object, keyframe, support or contents geom.
            UnsupportedError: If the object cannot be held.
        """
        if self.notes.held is not None:
            raise SceneError(f"{self.notes.held.body!r} is in the gripper already; detach() it first")
        if at is not None:
            if X_TO is not None:
                raise SettingError("X_TO", X_TO, "one of at and X_TO")
            X_TO = self._grasp_at(name, at)
        held = roles.held_note(
            self.model,
            self.notes,
            self.robot_bodies,
            name,
            X_TO=X_TO,
            contents=contents,
            object_class=object_class,
            fingers=fingers,
            grip=grip,
        )
        notes = replace(self.notes, held=held, support=tuple(support))
        if roles.free_joint(self.model, self.model.body(held.body).id) >= 0:
            return Scene.assemble(self.posed, notes)
        spec = self.spec.copy()
        spec.body(held.body).add_freejoint(name=f"{held.body}_free")
        return Scene.build(spec, notes)

    def _grasp_at(self, name: str, at: ArrayLike | str) -> Float[Array, "4 4"]:
        """Return the pose in the tool frame, at a configuration, of an object where it is."""
        note = self.notes.objects.get(name)
        body = find(self.model, _OBJ.mjOBJ_BODY, "object or body that can be held", name if note is None else note.body)
        data = self.data_at(named_configuration(at, self) if isinstance(at, str) else at)
        tool = data.site(self.tool)
        R_WT, R_WO = tool.xmat.reshape(3, 3), data.xmat[body].reshape(3, 3)
        X_TO = np.eye(4)
        X_TO[:3, :3], X_TO[:3, 3] = R_WT.T @ R_WO, R_WT.T @ (data.xpos[body] - tool.xpos)
        return X_TO

    def detach(self) -> Scene:
        """Return this scene with an empty gripper; the object is back at its initial pose.

        `with_state({body: X_WO})` moves it to where it was put down.

        Raises:
            SceneError: If the gripper is empty.
        """
        if self.notes.held is None:
            raise SceneError("nothing is in the gripper")
        return Scene.assemble(self.posed, replace(self.notes, held=None, support=()))

    def with_severity(self, severity: SeverityTable | Mapping[str, float | Mapping[str, float]]) -> Scene:
        """Return this scene with changed severities.

        Args:
            severity: A whole table, or replacements. By entity: a number, or numbers by component ("body", "carried",
                "contents") or component class ("arm_collapse", "glass", "hot"). By entity class: a number, or numbers
                by component class. A name that is both an entity and a class means the entity. The class "carried" is
                the carried object itself.

        Raises:
            UnknownNameError: If a name is neither an entity nor a class.
            SettingError: If a severity is not a finite number of at least 0.
        """
        table, overrides = given_severity(severity)
        table = table if isinstance(severity, SeverityTable) else self.notes.severity
        notes = replace(self.notes, severity=table, overrides=dict(self.notes.overrides) | overrides)
        return Scene.assemble(self.posed, notes)

    def with_state(self, state: Mapping[str, float | ArrayLike] | None = None, *, keyframe: str | None = None) -> Scene:
        """Return this scene with joints that are not planned elsewhere: fingers, doors, drawers, free bodies.

        Joints that follow others by equalities, such as mimic joints, follow; passive joints close their chains. Other
        joints stay as they are.

        Args:
            state: Position of each hinge or slide [rad or m], wxyz quaternion of a ball joint, position and quaternion
                or 4 x 4 pose in W of a free body; by joint, or by body for free bodies.
            keyframe: Keyframe of the model from which to take everything else: all joints that are neither planned nor
                in the gripper.

        Raises:
            UnknownNameError: If there is no such joint, or the model has no such keyframe.
            SettingError: If a joint is planned or its position is impossible, or nothing is given.
            UnsupportedError: If the keyframe moves a joint without a name.
        """
        if state is None and keyframe is None:
            raise SettingError("state", None, "positions by joint, or keyframe=")
        held = self.held_bodies
        given = given_state(self.model, self.joint_ids, held, state or {})
        whole = {} if keyframe is None else keyframe_state(self.model, self.joint_ids, held, self.notes, keyframe)
        notes = replace(self.notes, state={**self.notes.state, **whole, **given})
        return Scene.assemble(self.posed, notes)

    def in_state(self, state: Mapping[str, float | ArrayLike] | str) -> Scene:
        """Return this scene in a state or in that of a keyframe; given `fingers` stay. For loaders."""
        if not isinstance(state, str):
            return self.with_state(state)
        scene = self.with_state(keyframe=state)
        if self.notes.fingers is None:
            return scene
        notes = replace(scene.notes, state=without_bodies(self.model, scene.notes.state, self.gripper_bodies))
        return Scene.assemble(self.posed, notes)

    def with_moving(self, *entities: MovingEntity) -> Scene:
        """Return this scene with additional moving entities; a prediction replaces an earlier one of the same name.

        Planners weigh harm to them, but collision checks and `verify` ignore them.

        Raises:
            SceneError: If a name is given twice, or is that of a body of the scene.
            UnknownNameError: If the severity table lacks a class.
        """
        for entity in entities:
            if not isinstance(entity, MovingEntity):
                raise SettingError("entities", entity, "MovingEntity objects")
        given = {entity.name: entity for entity in entities}
        if len(given) < len(entities):
            raise SceneError(f"moving entities must have distinct names: {', '.join(e.name for e in entities)}")
        return self._among({**self.notes.moving, **given})

    def without_moving(self) -> Scene:
        """Return this scene without moving entities."""
        return self._among({})

    def _among(self, moving: Mapping[str, MovingEntity]) -> Scene:
        notes = replace(self.notes, moving=MappingProxyType(moving))
        severity = roles.moving_severities(self.shapes, notes, self.components)
        scene = replace(self, notes=notes, moving_severity=severity)
        # Moving entities are not in collision checks, so these caches survive the frequent updates of predictions.
        vars(scene).update(_collision_pairs=self._collision_pairs, layout=self.layout)
        return scene

    def with_constraints(self, *constraints: object) -> Scene:
        """Return this scene with constraints that apply to motions in it by default.

        Scenes and tasks made from this scene keep them, even with another object in the gripper. The constraint that
        keeps carried contents in applies in any case.

        Raises:
            SettingError: If an argument is not a `graceful_plan.Constraint`.
        """
        for constraint in constraints:
            if not callable(getattr(constraint, "rule", None)):
                raise SettingError("constraints", constraint, "graceful_plan.Constraint objects, such as Upright()")
        return Scene.assemble(self.posed, replace(self.notes, constraints=constraints))

    def with_allowed_contacts(self, *contacts: AllowedContact) -> Scene:
        """Return this scene with additional allowed contacts, such as two links of the robot; `describe` lists them.

        Raises:
            UnknownNameError: If a name is neither a body nor a geom.
        """
        for contact in contacts:
            if not isinstance(contact, AllowedContact):
                raise SettingError("contacts", contact, "AllowedContact objects")
        notes = replace(self.notes, allowed=(*self.notes.allowed, *contacts))
        return Scene.assemble(self.posed, notes)

    def add_box(self, name: str, half_size: ArrayLike, pose: ArrayLike, entity: str | None = None) -> Scene:
        """Return this scene with a static box.

        Args:
            name: Name of the new body.
            half_size: Half of its length along each axis [m].
            pose: Pose in W as a 4 x 4 matrix, or the position of its centre [m].
            entity: Entity class, if the box can be harmed; otherwise it is an obstacle only.
        """
        return self.edit(add=[StaticBody(name=name, kind="box", size=half_size, pose=pose, entity=entity)])

    def add_sphere(self, name: str, radius: float, pose: ArrayLike, entity: str | None = None) -> Scene:
        """Return this scene with a static sphere of some radius [m]; other arguments as in `add_box`."""
        return self.edit(add=[StaticBody(name=name, kind="sphere", size=radius, pose=pose, entity=entity)])

    def add_cylinder(
        self, name: str, radius: float, half_length: float, pose: ArrayLike, entity: str | None = None
    ) -> Scene:
        """Return this scene with a static cylinder along z of its pose [m]; other arguments as in `add_box`."""
        size = radius, half_length
        return self.edit(add=[StaticBody(name=name, kind="cylinder", size=size, pose=pose, entity=entity)])

    def add_capsule(
        self, name: str, radius: float, half_length: float, pose: ArrayLike, entity: str | None = None
    ) -> Scene:
        """Return this scene with a static capsule along z of its pose.

        `half_length` [m] is that of the straight part, without the caps; other arguments as in `add_box`.
        """
        size = radius, half_length
        return self.edit(add=[StaticBody(name=name, kind="capsule", size=size, pose=pose, entity=entity)])

    def add_mesh(self, name: str, vertices: ArrayLike, pose: ArrayLike, entity: str | None = None) -> Scene:
        """Return this scene with the convex hull of points [m] in the frame of `pose`; else as in `add_box`."""
        return self.edit(add=[StaticBody(name=name, kind="mesh", size=vertices, pose=pose, entity=entity)])

    def edit(
        self,
        *,
        add: Iterable[StaticBody | PointCloud | HeightMap] = (),
        move: Mapping[str, ArrayLike] | None = None,
        remove: Iterable[str] = (),
    ) -> Scene:
        """Return this scene with changed surroundings, all changes at once.

        Moving bodies needs no recompilation, and data of the robot are never recomputed.

        Args:
            add: Static obstacles to add.
            move: New poses in W by body, as 4 x 4 matrices or as positions of body frames [m], for obstacles and
                entities whose parent is the world.
            remove: Bodies to remove, with their subtrees; an added body may have the name of a removed one.

        Raises:
            UnknownNameError: If there is no such body.
            SceneError: If a name is taken, or a body belongs to the robot or is in the gripper.
            UnsupportedError: If the parent of a body to move is not the world.
        """
        kept = self.robot_bodies | self.held_bodies
        posed, model = moved(self.posed, move or {}, kept), self.shapes
        gone, solids = list(remove), list(add)
        elsewhere = frozenset(model.body(name).id for name in move or {})
        if not gone and not solids:
            return self._moved(posed, elsewhere)
        spec = posed.spec.copy()
        for name in gone:
            removed(spec, model, name, kept)
            elsewhere |= subtree(model, model.body(name).id)
        for solid in solids:
            if not callable(getattr(solid, "add_to", None)):
                raise SettingError("add", solid, "each a StaticBody, PointCloud or HeightMap")
            solid.add_to(spec)
        left = set(gone) - {solid.name for solid in solids}
        entities = {name: note for name, note in self.notes.entities.items() if name not in gone}
        entities |= {
            solid.name: EntityAnnotation(category=solid.entity) for solid in solids if solid.entity is not None
        }
        overrides = {name: value for name, value in self.notes.overrides.items() if name not in left}
        state = without_bodies(self.model, self.notes.state, elsewhere)
        return Scene.build(spec, replace(self.notes, entities=entities, overrides=overrides, state=state))

    def _moved(self, posed: PosedModel, elsewhere: frozenset[int]) -> Scene:
        """Return this scene with bodies moved: roles are unchanged, and free bodies start at their new poses."""
        model, home = posed.shapes, self.home_qpos.copy()
        for body in elsewhere:
            if (adr := roles.free_joint(model, body)) >= 0:
                home[adr : adr + 7] = np.concatenate(posed.pose(body))
        home.flags.writeable = False
        notes = replace(self.notes, state=without_bodies(model, self.notes.state, elsewhere))
        scene = replace(self, posed=posed, home_qpos=home, notes=notes)
        # These caches do not depend on the poses of obstacles.
        vars(scene).update(_collision_pairs=self._collision_pairs, layout=self.layout)
        return scene


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
