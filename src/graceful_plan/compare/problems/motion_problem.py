"""Planning problem for the bundled Panda among primitive obstacles, as read from problem files.

The robot's base is at the origin of W, and there is no carried object. Hand poses use the manufacturer's frames:
`panda_hand` is the bundled model's body "hand", 0.1034 m behind its tool along z.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from types import MappingProxyType

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import GracefulPlanError, SceneError, UnknownNameError
from graceful_plan.scene.edit import add_primitive
from graceful_plan.scene.elements import Notes
from graceful_plan.scene.harm.severity import SeverityTable
from graceful_plan.scene.loading.robot_models import robot_file
from graceful_plan.scene.pose_goal import PoseGoal
from graceful_plan.scene.scene import Scene

ROBOT = "panda/"
"""Prefix of the robot's names in the scene of a problem."""

_GEOM = mujoco.mjtGeom
_KINDS = MappingProxyType({"box": _GEOM.mjGEOM_BOX, "sphere": _GEOM.mjGEOM_SPHERE, "cylinder": _GEOM.mjGEOM_CYLINDER})


@dataclass(frozen=True, kw_only=True, eq=False)
class Obstacle:
    """A fixed primitive obstacle.

    | field | meaning                                                          |
    |-------|------------------------------------------------------------------|
    | name  | name in messages                                                 |
    | kind  | "box", "sphere" or "cylinder"                                    |
    | size  | three half lengths; radius; radius and half length along z [m]   |
    | X_WO  | pose in W                                                        |
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
    """One problem from a file; it may be infeasible.

    | field     | meaning                                                    | unit | shape   |
    |-----------|------------------------------------------------------------|------|---------|
    | name      | "group/number", unique in its file                         |      |         |
    | group     | the kind of problem, e.g. "bookshelf_small_panda"          |      |         |
    | start     | start of the motion                                        | rad  | nq      |
    | goals     | configurations to choose from; no row if only a pose is given | rad | goal nq |
    | pose      | pose for the tool, if the file has one                     |      |         |
    | obstacles | obstacles                                                  |      |         |
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
        """Return the goal for `plan`: the goal configurations if there are any, else the pose."""
        return self.goals if len(self.goals) or self.pose is None else self.pose

    @cached_property
    def scene(self) -> Scene:
        """Return the robot among the obstacles; built at first use, because a file has hundreds of problems.

        Raises:
            SceneError: If an obstacle has no size, or two have the same name.
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
    """Return the robot alone, cached because reading its file is slower than adding obstacles."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.attach(mujoco.MjSpec.from_file(str(robot_file("panda"))), prefix=ROBOT, frame=spec.worldbody.add_frame())
    return Scene.build(spec, _notes("panda", fingers))
