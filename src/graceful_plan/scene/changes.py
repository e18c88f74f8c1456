"""Methods that return changed scenes: `attach`, `detach`, `with_severity`, `add_*` and others.

Frames: W world, T tool, O carried object.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SceneError, SettingError
from graceful_plan.scene import roles
from graceful_plan.scene.assembly import SceneAssembly
from graceful_plan.scene.edit import PosedModel, StaticBody, moved, removed
from graceful_plan.scene.elements import Adhesion, AllowedContact, Contents, EntityAnnotation, Fingers
from graceful_plan.scene.harm.severity import SeverityTable, given_severity
from graceful_plan.scene.model_parts import (
    find,
    subtree,
)
from graceful_plan.scene.moving import MovingEntity
from graceful_plan.scene.rest_state import (
    given_state,
    keyframe_state,
    without_bodies,
)
from graceful_plan.scene.sensed.cloud import PointCloud
from graceful_plan.scene.sensed.height_map import HeightMap
from graceful_plan.scene.tasks import named_configuration

if TYPE_CHECKING:  # checks of shapes do not take Self outside of a checked class
    from typing import Self


_OBJ = mujoco.mjtObj


@dataclass(frozen=True, kw_only=True, eq=False)
class SceneChanges(SceneAssembly):
    """A scene that can be changed. `Scene` adds constructors from files."""

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
    ) -> Self:
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
            return self.assemble(self.posed, notes)
        spec = self.spec.copy()
        spec.body(held.body).add_freejoint(name=f"{held.body}_free")
        return self.build(spec, notes)

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

    def detach(self) -> Self:
        """Return this scene with an empty gripper; the object is back at its initial pose.

        `with_state({body: X_WO})` moves it to where it was put down.

        Raises:
            SceneError: If the gripper is empty.
        """
        if self.notes.held is None:
            raise SceneError("nothing is in the gripper")
        return self.assemble(self.posed, replace(self.notes, held=None, support=()))

    def with_severity(self, severity: SeverityTable | Mapping[str, float | Mapping[str, float]]) -> Self:
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
        return self.assemble(self.posed, notes)

    def with_state(self, state: Mapping[str, float | ArrayLike] | None = None, *, keyframe: str | None = None) -> Self:
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
        return self.assemble(self.posed, notes)

    def in_state(self, state: Mapping[str, float | ArrayLike] | str) -> Self:
        """Return this scene in a state or in that of a keyframe; given `fingers` stay. For loaders."""
        if not isinstance(state, str):
            return self.with_state(state)
        scene = self.with_state(keyframe=state)
        if self.notes.fingers is None:
            return scene
        notes = replace(scene.notes, state=without_bodies(self.model, scene.notes.state, self.gripper_bodies))
        return self.assemble(self.posed, notes)

    def with_moving(self, *entities: MovingEntity) -> Self:
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

    def without_moving(self) -> Self:
        """Return this scene without moving entities and the severities that were set for them."""
        moving = self.notes.moving
        kept = {name: value for name, value in self.notes.overrides.items() if name not in moving}
        return self._among({}, overrides=MappingProxyType(kept))

    def _among(self, moving: Mapping[str, MovingEntity], **changes: object) -> Self:
        notes = replace(self.notes, moving=MappingProxyType(moving), **changes)
        severity = roles.moving_severities(self.shapes, notes, self.components)
        scene = replace(self, notes=notes, moving_severity=severity)
        # Moving entities are not in collision checks, so these caches survive the frequent updates of predictions.
        vars(scene).update(_collision_pairs=self._collision_pairs, layout=self.layout)
        return scene

    def with_constraints(self, *constraints: object) -> Self:
        """Return this scene with constraints that apply to motions in it by default.

        Scenes and tasks made from this scene keep them, even with another object in the gripper. The constraint that
        keeps carried contents in applies in any case.

        Raises:
            SettingError: If an argument is not a `graceful_plan.Constraint`.
        """
        for constraint in constraints:
            if not callable(getattr(constraint, "rule", None)):
                raise SettingError("constraints", constraint, "graceful_plan.Constraint objects, such as Upright()")
        return self.assemble(self.posed, replace(self.notes, constraints=constraints))

    def with_allowed_contacts(self, *contacts: AllowedContact) -> Self:
        """Return this scene with additional allowed contacts, such as two links of the robot; `describe` lists them.

        Raises:
            UnknownNameError: If a name is neither a body nor a geom.
        """
        for contact in contacts:
            if not isinstance(contact, AllowedContact):
                raise SettingError("contacts", contact, "AllowedContact objects")
        notes = replace(self.notes, allowed=(*self.notes.allowed, *contacts))
        return self.assemble(self.posed, notes)

    def add_box(self, name: str, half_size: ArrayLike, pose: ArrayLike, entity: str | None = None) -> Self:
        """Return this scene with a static box.

        Args:
            name: Name of the new body.
            half_size: Half of its length along each axis [m].
            pose: Pose in W as a 4 x 4 matrix, or the position of its centre [m].
            entity: Entity class, if the box can be harmed; otherwise it is an obstacle only.
        """
        return self.edit(add=[StaticBody(name=name, kind="box", size=half_size, pose=pose, entity=entity)])

    def add_sphere(self, name: str, radius: float, pose: ArrayLike, entity: str | None = None) -> Self:
        """Return this scene with a static sphere of some radius [m]; other arguments as in `add_box`."""
        return self.edit(add=[StaticBody(name=name, kind="sphere", size=radius, pose=pose, entity=entity)])

    def add_cylinder(
        self, name: str, radius: float, half_length: float, pose: ArrayLike, entity: str | None = None
    ) -> Self:
        """Return this scene with a static cylinder along z of its pose [m]; other arguments as in `add_box`."""
        size = radius, half_length
        return self.edit(add=[StaticBody(name=name, kind="cylinder", size=size, pose=pose, entity=entity)])

    def add_capsule(
        self, name: str, radius: float, half_length: float, pose: ArrayLike, entity: str | None = None
    ) -> Self:
        """Return this scene with a static capsule along z of its pose.

        `half_length` [m] is that of the straight part, without the caps; other arguments as in `add_box`.
        """
        size = radius, half_length
        return self.edit(add=[StaticBody(name=name, kind="capsule", size=size, pose=pose, entity=entity)])

    def add_mesh(self, name: str, vertices: ArrayLike, pose: ArrayLike, entity: str | None = None) -> Self:
        """Return this scene with the convex hull of points [m] in the frame of `pose`; else as in `add_box`."""
        return self.edit(add=[StaticBody(name=name, kind="mesh", size=vertices, pose=pose, entity=entity)])

    def edit(
        self,
        *,
        add: Iterable[StaticBody | PointCloud | HeightMap] = (),
        move: Mapping[str, ArrayLike] | None = None,
        remove: Iterable[str] = (),
    ) -> Self:
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
        return self.build(spec, replace(self.notes, entities=entities, overrides=overrides, state=state))

    def _moved(self, posed: PosedModel, elsewhere: frozenset[int]) -> Self:
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
