"""A planning problem for the bundled Panda among primitive obstacles: what problem files hold.

The robot's base is at the origin of W and nothing is carried. Poses of the hand are those of the manufacturer's frames:
`panda_hand` is the bundled model's body "hand", 0.1034 m behind its tool along z.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from types import MappingProxyType

import mujoco
import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.exceptions import GracefulPlanError, SceneError, UnknownNameError
from graceful_plan.scene.edit import add_primitive
from graceful_plan.scene.elements import Notes
from graceful_plan.scene.harm.severity import SeverityTable
from graceful_plan.scene.loading.robot_models import robot_file
from graceful_plan.scene.pose_goal import PoseGoal
from graceful_plan.scene.scene import Scene

Array = np.ndarray

ROBOT = "panda/"
"""Prefix of the robot's names in the scene of a problem."""

_GEOM = mujoco.mjtGeom
_KINDS = MappingProxyType({"box": _GEOM.mjGEOM_BOX, "sphere": _GEOM.mjGEOM_SPHERE, "cylinder": _GEOM.mjGEOM_CYLINDER})


@dataclass(frozen=True, kw_only=True, eq=False)
class Obstacle:
    """A primitive that stands still.

    | field | meaning                                                          |
    |-------|------------------------------------------------------------------|
    | name  | what it is called in messages                                    |
    | kind  | "box", "sphere" or "cylinder"                                    |
    | size  | three half lengths; radius; radius and half length along z [m]   |
    | X_WO  | its pose in W                                                    |
    """

    name: str
    kind: str
    size: tuple[float, ...]
    X_WO: Float[Array, "4 4"]

    def __post_init__(self) -> None:
        if self.kind not in _KINDS:
            raise UnknownNameError("kind of obstacle", self.kind, _KINDS)


@dataclass(frozen=True, kw_only=True, eq=False)
class ProblemFile:
    """One problem from a file. Nothing says that it can be solved: `plan` finds out.

    | field     | meaning                                                    | unit | shape   |
    |-----------|------------------------------------------------------------|------|---------|
    | name      | "group/number", unique in its file                         |      |         |
    | group     | the kind of problem, e.g. "bookshelf_small_panda"          |      |         |
    | start     | where the motion begins                                    | rad  | nq      |
    | goals     | configurations to choose from; no row if only a pose is given | rad | goal nq |
    | pose      | pose for the tool, if the file has one                     |      |         |
    | obstacles | what stands around                                         |      |         |
    | fingers   | position of each finger joint                              | m    |         |
    """

    name: str
    group: str
    start: Float[Array, " nq"]
    goals: Float[Array, "goal nq"]
    pose: PoseGoal | None
    obstacles: tuple[Obstacle, ...]
    fingers: float

    @property
    def goal(self) -> Float[Array, "goal nq"] | PoseGoal:
        """What to give to `plan`: the goal configurations if there are some, else the pose."""
        return self.goals if len(self.goals) or self.pose is None else self.pose

    @cached_property
    def scene(self) -> Scene:
        """The robot among the obstacles. Made at the first use, since a file has hundreds of them.

        Raises:
            SceneError: If obstacles have no size or one name.
        """
        spec = _robot(self.fingers).spec.copy()
        for obstacle in self.obstacles:
            try:
                add_primitive(spec, obstacle.name, _KINDS[obstacle.kind], np.asarray(obstacle.size), obstacle.X_WO)
            except GracefulPlanError as error:
                raise SceneError(f"problem {self.name}: {error}") from error
        return Scene.build(spec, _notes(self.name, self.fingers))


def _notes(name: str, fingers: float) -> Notes:
    return Notes(name=name, robot=ROBOT, tool=f"{ROBOT}tool", fingers=fingers, severity=SeverityTable.shipped())


@cache
def _robot(fingers: float) -> Scene:
    """Return the robot alone; reading its file costs more than adding a bookshelf to it."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.attach(mujoco.MjSpec.from_file(str(robot_file("panda"))), prefix=ROBOT, frame=spec.worldbody.add_frame())
    return Scene.build(spec, _notes("panda", fingers))
