"""A scene: robot, surroundings and what is known about both; the library's door to MuJoCo.

A `Scene` never changes: `attach`, `detach`, `with_severity` and `add_*` return new ones. Frames: W world, T tool,
O carried object. Batches of configurations are the business of `core.kernels`.
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
from graceful_plan.exceptions import SceneError, SettingError
from graceful_plan.path import finite_array
from graceful_plan.scene import roles
from graceful_plan.scene.contacts import declared_contacts
from graceful_plan.scene.edit import Solid, moved, removed
from graceful_plan.scene.elements import AllowedContact, Contents, EntityNote, Notes
from graceful_plan.scene.facts import SceneFacts
from graceful_plan.scene.harm.severity import SeverityTable, given_severity
from graceful_plan.scene.loading.self_contacts import OFTEN, link_contacts, touching, warn_of_untested_links
from graceful_plan.scene.mobile.diff_drive import DiffDrive
from graceful_plan.scene.mobile.wheels import described_drive
from graceful_plan.scene.model_parts import (
    add_tool,
    check_base,
    checked_model,
    finger_positions,
    joint_limits,
    names,
    planned_joints,
    robot_bodies,
    set_limits,
    tool_body,
)
from graceful_plan.scene.moving import MovingEntity
from graceful_plan.scene.screening import load_spec
from graceful_plan.scene.sensed.cloud import PointCloud
from graceful_plan.scene.sensed.height_map import HeightMap
from graceful_plan.scene.summary import summary
from graceful_plan.scene.tasks import check_keyframes, find_keyframes, model_keyframes, task_ends
from graceful_plan.scene.urdf.composing import TOOL, composed, held_still, velocities
from graceful_plan.scene.urdf.reading import Packages, read_urdf
from graceful_plan.scene.urdf.srdf import read_srdf

Array = np.ndarray

_OBJ = mujoco.mjtObj
_GEOM = mujoco.mjtGeom


@final
class Scene(SceneFacts):
    """A robot among things that can be harmed. Made by `load_scene` or `Scene.from_mjcf`; equal only to itself."""

    def __deepcopy__(self, memo: object) -> Scene:
        """Return the scene itself: it is never changed in place."""
        return self

    def __reduce__(self) -> Any:
        """Say why it cannot be pickled.

        Raises:
            TypeError: In any case.
        """
        raise TypeError(f"the Scene {self.name!r} holds a MuJoCo model and cannot be pickled; load it in each process")

    # --- making one ---------------------------------------------------------------------------------------------------

    @classmethod
    def from_mjcf(
        cls,
        source: str | Path | mujoco.MjSpec,
        *,
        robot: str,
        tool: str,
        carried: str | None = None,
        X_TO: ArrayLike | None = None,
        contents: Contents | None = None,
        entities: Mapping[str, str | EntityNote] | None = None,
        severity: SeverityTable | Mapping[str, Any] | str | Path | None = None,
        fingers: float | Mapping[str, float] | None = None,
        limits: Mapping[str, tuple[float, float]] | None = None,
        velocity: Sequence[float] | None = None,
        acceleration: Sequence[float] | None = None,
        torque: Sequence[float] | None = None,
        keyframes: Mapping[str, ArrayLike] | None = None,
        allowed_contacts: Sequence[AllowedContact] = (),
        self_collision: str = "model",
        folder: str | Path | None = None,
        body_class: str = "arm_collapse",
        base: DiffDrive | None = None,
        name: str | None = None,
    ) -> Scene:
        """Make a scene from any MJCF model with an arm in it.

        Args:
            source: MJCF file, MJCF text or a MjSpec. Files and text are screened for hostile content first, and may
                name other files only in the same folder and below, or in `folder`; a MjSpec is trusted.
            robot: Prefix of the robot's body names, e.g. "panda/", or the name of its root body.
            tool: Name of the site that stands for the tool, or of a body, whose frame it then is. The hinges and slides
                between the world and it are planned.
            carried: Body in the gripper, if any; `X_TO` and `contents` as in `attach`.
            X_TO: Pose of the carried body in the tool frame.
            contents: What is inside of it.
            entities: Class of each body that can be harmed, by body name; each stands for its whole subtree. The model
                may say the same in custom text: `<text name="entity/BODY" data="CLASS"/>`. Bodies without a class are
                obstacles only.
            severity: A table, a file with one, or replacements as for `with_severity`.
            fingers: Position of the joints behind the tool's body, or positions by joint name.
            limits: Lower and upper limit by joint, where they are not to be the model's [rad or m].
            velocity: Limit of each planned joint [rad/s or m/s]. Default: the model's custom numeric
                "<robot>velocity_limit".
            acceleration: The same for accelerations [rad/s2 or m/s2], custom numeric "<robot>acceleration_limit".
            torque: The same [N m or N]. Default: the model's actuators; infinite if they have no limits.
            keyframes: Configurations by name, besides the model's own keyframes.
            allowed_contacts: What may touch, besides gripper and carried object.
            self_collision: "model": links of the robot may touch where the model's filters say so, with a warning if
                they say it of all. "links": none may but those that a joint lies between, those that overlap nearly
                wherever the joints are, and excluded pairs. `describe` lists them.
            folder: That all files which the model names are in, for models whose `meshdir` leads out of their own.
            body_class: How the arm fails: "arm_collapse", "arm_braked" or "base_coast".
            base: How the robot drives. Default: the model's custom numerics and texts "<robot>drive/FIELD". Without it
                planar joints move in all directions.
            name: What to call the scene; the model's name by default.

        Raises:
            SceneError: If the model is broken or hostile.
            SettingError: If `folder` does not have the source in it, or there is no such kind of `self_collision`.
            UnsupportedError: If it has features that cannot be represented.
            UnknownNameError: If a body, site, joint or class does not exist.
        """
        spec = load_spec(source, folder)
        add_tool(spec, tool)
        overlaps = link_contacts(spec, robot, tool, self_collision, allowed_contacts)
        base = base or described_drive(spec, robot)
        table, overrides = given_severity(severity)
        notes = Notes(
            name=name or spec.modelname,
            robot=robot,
            tool=tool,
            body_class=body_class,
            fingers=fingers,
            limits=dict(limits or {}),
            velocity=None if velocity is None else tuple(velocity),
            acceleration=None if acceleration is None else tuple(acceleration),
            torque=None if torque is None else tuple(torque),
            base=base,
            entities={
                k: v if isinstance(v, EntityNote) else EntityNote(category=v) for k, v in (entities or {}).items()
            },
            severity=table,
            overrides=overrides,
            keyframes={k: tuple(finite_array(f"keyframe {k}", q, ndim=1)) for k, q in (keyframes or {}).items()},
            allowed=(*overlaps, *allowed_contacts),
        )
        scene = cls.build(spec, notes)
        check_keyframes(notes, scene.limits)
        warn_of_untested_links(scene.model, scene.robot_bodies, robot)
        return scene if carried is None else scene.attach(carried, X_TO=X_TO, contents=contents)

    @classmethod
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
        velocity: Sequence[float] | None = None,
        fingers: float | Mapping[str, float] | None = None,
        decompose: bool | None = None,
        limits: Mapping[str, tuple[float, float]] | None = None,
        allowed_contacts: Sequence[AllowedContact] = (),
        keyframes: Mapping[str, ArrayLike] | None = None,
        entities: Mapping[str, str | EntityNote] | None = None,
        severity: SeverityTable | Mapping[str, Any] | str | Path | None = None,
    ) -> Scene:
        """Make a scene of a robot from URDF, in a world or alone. Names get the robot's name and "/" before them.

        Links that a joint lies between may touch, and those that overlap nearly wherever the joints are: hulls of
        meshes overlap where the meshes do not. Only collision geometry counts. Where hulls touch each other in many
        configurations, meshes that they do not fit are divided into convex parts: ten seconds each, the first time.

        Args:
            source: URDF file, or its text.
            tool: Link whose frame is that of the tool. The joints between the base and it are planned.
            acceleration: Limit of each planned joint, or of all [rad/s2 or m/s2]: URDF has none.
            packages: Folders that `package://` stands for: packages, or folders that have these in them, or folders by
                the name of the package; those above the file are tried, too.
            srdf: SRDF file or text: pairs that may touch, and group states as keyframes.
            world: MJCF with the surroundings, as in `from_mjcf`.
            pose: Of the robot's root link in W, 4 x 4.
            velocity: Limit of each planned joint [rad/s or m/s]; those of the URDF by default.
            fingers: Position of the joints that hang on the last planned joint; those that mimic one follow it. Or
                positions by joint name.
            decompose: Whether meshes are divided; if None, where links touch in many configurations and the library
                `coacd` is there, with a warning if it is not.
            limits: As in `from_mjcf`.
            allowed_contacts: What may touch besides.
            keyframes: Configurations by name.
            entities: As in `from_mjcf`.
            severity: As in `from_mjcf`.

        Raises:
            SceneError: If a file is broken, hostile or not there.
            UnsupportedError: If it has features that cannot be represented, or meshes are to be divided without that.
            UnknownNameError: If there is no such link.
        """
        robot = read_urdf(source, packages, decompose=decompose or False)
        chain, prefix = robot.chain(tool), f"{robot.name}/"
        told = None if srdf is None else read_srdf(srdf)
        states = {} if told is None else told.keyframes([joint.name for joint in chain])
        disabled = () if told is None else told.contacts(robot)
        spec = composed(robot, tool, world, pose)
        touches = touching(spec, prefix, prefix + TOOL, (*disabled, *allowed_contacts))
        if decompose is None and touches.often > OFTEN:
            spec = composed(read_urdf(source, packages, decompose=None), tool, world, pose)
            touches = touching(spec, prefix, prefix + TOOL, (*disabled, *allowed_contacts))
        return cls.from_mjcf(
            spec,
            robot=prefix,
            tool=prefix + TOOL,
            entities=entities,
            severity=severity,
            fingers=held_still(robot, chain, fingers) if isinstance(fingers, int | float) else fingers,
            limits=limits,
            velocity=velocities(chain) if velocity is None else velocity,
            acceleration=[acceleration] * len(chain) if isinstance(acceleration, int | float) else acceleration,
            keyframes={**states, **(keyframes or {})},
            allowed_contacts=(*touches.contacts, *disabled, *allowed_contacts),
            name=robot.name,
        )

    @classmethod
    def build(cls, spec: mujoco.MjSpec, notes: Notes, compiled: mujoco.MjModel | None = None) -> Scene:
        """Make a scene of a MjSpec, which must not change any more, and notes. For loaders; users call `from_mjcf`."""
        with notes.about("world"):
            model = checked_model(spec) if compiled is None else compiled
        with notes.about("robot"):
            robot = robot_bodies(model, notes.robot)
            if compiled is None:
                set_limits(model, robot, notes.limits)
        with notes.about("tool"):
            hand = tool_body(model, notes.tool, robot)
            joints = planned_joints(model, hand, robot)
        with notes.about("robot"):
            if notes.base is not None:
                check_base(model, joints, notes.base)
            limits = joint_limits(model, joints, notes)
            components = roles.find_components(model, notes, robot)
        with notes.about("fingers"):
            held_still = finger_positions(model, robot, joints, hand, notes)
        qpos_adr = model.jnt_qposadr[list(joints)].astype(int)
        home = model.qpos0.copy()
        home[list(held_still)] = list(held_still.values())
        home.flags.writeable = qpos_adr.flags.writeable = False
        notes = replace(
            notes,
            entities=roles.custom_entities(model) | dict(notes.entities),
            # Kept here, since adding a joint to a MjSpec spoils its keyframes.
            keyframes=model_keyframes(model, qpos_adr) | dict(notes.keyframes),
        )
        return cls(
            model=model,
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
            allowed_contacts=declared_contacts(model, notes, hand),
            notes=notes,
            robot_bodies=robot,
            spec=spec,
        )

    # --- what is built on these facts ---------------------------------------------------------------------------------

    @cached_property
    def tasks(self) -> Mapping[str, Task]:
        """What to plan in this scene, by name."""
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
        """Return a readable summary: robot, components, entities with severities, what may touch and why."""
        return summary(self, {name: task.description for name, task in self.tasks.items()})

    # --- new scenes ---------------------------------------------------------------------------------------------------

    def attach(
        self,
        name: str,
        *,
        X_TO: ArrayLike | None = None,
        contents: Contents | None = None,
        object_class: str | None = None,
        fingers: float | Mapping[str, float] | None = None,
        support: Sequence[str] = (),
    ) -> Scene:
        """Return this scene with an object in the gripper, no entity or obstacle any more; the gripper may touch it.

        Args:
            name: An object of the scene, or any body that stands by itself.
            X_TO: Pose of the object's body in the tool frame. Default: as declared for the object, else the body's
                origin at the tool, upright while the tool points down.
            contents: What is inside of it. Default: as declared.
            object_class: "light" (below 0.2 kg), "medium" (up to 1 kg), "heavy", "sharp" or "glass". Default: as
                declared, else by mass.
            fingers: Position of the joints behind the tool's body while carrying, or by joint name. Default: as
                declared.
            support: Bodies or geoms that it may touch at the ends of a path, since it stands on them there.

        Raises:
            SceneError: If something is in the gripper already.
            UnknownNameError: If there is no such object, support or contents geom.
            UnsupportedError: If it cannot be held.
        """
        if self.notes.held is not None:
            raise SceneError(f"{self.notes.held.body!r} is in the gripper already; detach() it first")
        held = roles.held_note(
            self.model,
            self.notes,
            self.robot_bodies,
            name,
            X_TO=X_TO,
            contents=contents,
            object_class=object_class,
            fingers=fingers,
        )
        notes = replace(self.notes, held=held, support=tuple(support))
        if roles.free_joint(self.model, self.model.body(held.body).id) >= 0:
            return Scene.build(self.spec, notes, self.model)
        spec = self.spec.copy()
        spec.body(held.body).add_freejoint(name=f"{held.body}_free")
        return Scene.build(spec, notes)

    def detach(self) -> Scene:
        """Return this scene with nothing in the gripper; the object is back at its initial pose.

        Raises:
            SceneError: If nothing is in the gripper.
        """
        if self.notes.held is None:
            raise SceneError("nothing is in the gripper")
        return Scene.build(self.spec, replace(self.notes, held=None, support=()), self.model)

    def with_severity(self, severity: SeverityTable | Mapping[str, float | Mapping[str, float]]) -> Scene:
        """Return this scene with other severities.

        Args:
            severity: A whole table, or replacements: by entity, a number or numbers by component ("body", "carried",
                "contents") or by component class ("arm_collapse", "glass", "hot"); by entity class, a number or numbers
                by component class. A name that is both is the entity.
                The class "carried" is the carried object itself.

        Raises:
            UnknownNameError: If a name is neither an entity nor a class.
            SettingError: If a severity is not a finite number of at least 0.
        """
        table, overrides = given_severity(severity)
        table = table if isinstance(severity, SeverityTable) else self.notes.severity
        notes = replace(self.notes, severity=table, overrides=dict(self.notes.overrides) | overrides)
        return Scene.build(self.spec, notes, self.model)

    def with_moving(self, *entities: MovingEntity) -> Scene:
        """Return this scene with more entities that move; a prediction replaces an earlier one of the same name.

        They are hazards, not obstacles: collision checks and `verify` do not look at them.

        Raises:
            SceneError: If a name is given twice or is that of a body of the scene.
            UnknownNameError: If the severity table does not have a class.
        """
        for entity in entities:
            if not isinstance(entity, MovingEntity):
                raise SettingError("entities", entity, "MovingEntity objects")
        given = {entity.name: entity for entity in entities}
        if len(given) < len(entities):
            raise SceneError(f"two of these moving entities have one name: {', '.join(e.name for e in entities)}")
        return self._among({**self.notes.moving, **given})

    def without_moving(self) -> Scene:
        """Return this scene without entities that move."""
        return self._among({})

    def _among(self, moving: Mapping[str, MovingEntity]) -> Scene:
        scene = Scene.build(self.spec, replace(self.notes, moving=MappingProxyType(moving)), self.model)
        # Nothing collides with them: predictions come anew with every call, and these stay.
        vars(scene).update(_collision_pairs=self._collision_pairs, layout=self.layout)
        return scene

    def with_constraints(self, *constraints: object) -> Scene:
        """Return this scene with constraints that hold along motions in it unless a call says otherwise.

        They stay with what is made of it: its tasks, the scene with another object in the gripper. Contents that are
        carried are kept besides, without being asked for.

        Raises:
            SettingError: If one of them is no `graceful_plan.Constraint`.
        """
        for constraint in constraints:
            if not callable(getattr(constraint, "rule", None)):
                raise SettingError("constraints", constraint, "graceful_plan.Constraint objects, such as Upright()")
        return Scene.build(self.spec, replace(self.notes, constraints=constraints), self.model)

    def with_allowed_contacts(self, *contacts: AllowedContact) -> Scene:
        """Return this scene with more that may touch, such as two links of the robot; `describe` lists them.

        Raises:
            UnknownNameError: If a name is neither a body nor a geom.
        """
        for contact in contacts:
            if not isinstance(contact, AllowedContact):
                raise SettingError("contacts", contact, "AllowedContact objects")
        notes = replace(self.notes, allowed=(*self.notes.allowed, *contacts))
        return Scene.build(self.spec, notes, self.model)

    def add_box(self, name: str, half_size: ArrayLike, pose: ArrayLike, entity: str | None = None) -> Scene:
        """Return this scene with a box that does not move.

        Args:
            name: Name of the new body.
            half_size: Half of its length along each axis [m].
            pose: Pose in W as a 4 x 4 matrix, or the position of its centre [m].
            entity: Its class, if it can be harmed; otherwise it is an obstacle only.
        """
        return self.edit(add=[Solid(name=name, kind="box", size=half_size, pose=pose, entity=entity)])

    def add_sphere(self, name: str, radius: float, pose: ArrayLike, entity: str | None = None) -> Scene:
        """Return this scene with a sphere of some radius [m] that does not move; the rest as in `add_box`."""
        return self.edit(add=[Solid(name=name, kind="sphere", size=radius, pose=pose, entity=entity)])

    def add_cylinder(
        self, name: str, radius: float, half_length: float, pose: ArrayLike, entity: str | None = None
    ) -> Scene:
        """Return this scene with a cylinder along z of its pose [m] that does not move; the rest as in `add_box`."""
        size = radius, half_length
        return self.edit(add=[Solid(name=name, kind="cylinder", size=size, pose=pose, entity=entity)])

    def add_capsule(
        self, name: str, radius: float, half_length: float, pose: ArrayLike, entity: str | None = None
    ) -> Scene:
        """Return this scene with a capsule along z of its pose that does not move.

        `half_length` [m] is that of the straight part, without the caps; the rest as in `add_box`.
        """
        size = radius, half_length
        return self.edit(add=[Solid(name=name, kind="capsule", size=size, pose=pose, entity=entity)])

    def add_mesh(self, name: str, vertices: ArrayLike, pose: ArrayLike, entity: str | None = None) -> Scene:
        """Return this scene with the convex hull of points [m] in the frame of `pose`; the rest as in `add_box`."""
        return self.edit(add=[Solid(name=name, kind="mesh", size=vertices, pose=pose, entity=entity)])

    def edit(
        self,
        *,
        add: Iterable[Solid | PointCloud | HeightMap] = (),
        move: Mapping[str, ArrayLike] | None = None,
        remove: Iterable[str] = (),
    ) -> Scene:
        """Return this scene with other surroundings, all changes in one go.

        What only moves is not compiled again, and what belongs to the robot is not computed again in any case.

        Args:
            add: What comes in, and stays where it is.
            move: New poses in W by body, as 4 x 4 matrices, or positions of the bodies' frames [m]: obstacles and
                entities that stand on the world by themselves.
            remove: Bodies that go, with everything on them; a body that is added may have the name of one that goes.

        Raises:
            UnknownNameError: If there is no such body.
            SceneError: If a name is taken, or a body belongs to the robot or is in the gripper.
            UnsupportedError: If a body that is to move does not stand on the world by itself.
        """
        kept = self.robot_bodies | roles.held_bodies(self.model, self.notes)
        spec, model = moved(self.spec, self.model, move or {}, kept)
        gone, solids = list(remove), list(add)
        if not gone and not solids:
            return self._with_model(spec, model)
        for name in gone:
            removed(spec, self.model, name, kept)
        for solid in solids:
            if not callable(getattr(solid, "add_to", None)):
                raise SettingError("add", solid, "Solids, PointClouds and HeightMaps")
            solid.add_to(spec)
        left = set(gone) - {solid.name for solid in solids}
        entities = {name: note for name, note in self.notes.entities.items() if name not in gone}
        entities |= {solid.name: EntityNote(category=solid.entity) for solid in solids if solid.entity is not None}
        overrides = {name: value for name, value in self.notes.overrides.items() if name not in left}
        return Scene.build(spec, replace(self.notes, entities=entities, overrides=overrides))

    def _with_model(self, spec: mujoco.MjSpec, model: mujoco.MjModel) -> Scene:
        """Return this scene with bodies elsewhere: who is who stays, and what stands freely begins there."""
        home = self.home_qpos.copy()
        free = np.flatnonzero(model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE))
        for adr in model.jnt_qposadr[free].tolist():
            home[adr : adr + 7] = model.qpos0[adr : adr + 7]
        home.flags.writeable = False
        scene = replace(self, spec=spec, model=model, home_qpos=home)
        # These do not depend on where anything stands.
        vars(scene).update(_collision_pairs=self._collision_pairs, layout=self.layout)
        return scene


@dataclass(frozen=True, kw_only=True, eq=False)
class Task:
    """Something to plan in a scene: a start, goals to choose from, and the object to carry.

    `goal` has one row if there is one goal. `scene` is made at the first use: it has the object in the gripper.
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
        """The scene with the task's object attached and its supports allowed at the ends."""
        if self.object_name is None:
            return self.world
        return self.world.attach(self.object_name, support=self.support)
