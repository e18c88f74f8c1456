"""Jobs: goals of objects, and the actions that are allowed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Float
from graceful_plan.exceptions import SettingError
from graceful_plan.job.actions import Action, Clear, CloseLid, Load
from graceful_plan.job.grasping import Grasp
from graceful_plan.job.job_state import JobState
from graceful_plan.path import finite_array
from graceful_plan.scene.roles import held_note, rigid_pose
from graceful_plan.scene.scene import Scene, checked_scene

Array = np.ndarray

PLACEMENTS = 4
"""Default number of placements of each object to choose from."""


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Where:
    """Where an object shall stand: at a pose, or on a body and in a region, with a number of samples."""

    on: str | None = None
    in_region: ArrayLike | None = None
    n: int = PLACEMENTS
    at: Float[Array, "4 4"] | None = None


@final
class Job:
    """A whole task: where objects shall be in the end, and further allowed actions.

    Args:
        scene: A scene of an arm with an empty gripper.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = checked_scene(scene)
        if scene.carried is not None:
            raise SettingError("scene", scene.carried.body, "an empty gripper: detach() it, or put it down first")
        if scene.base is not None and len(scene.joints) == len(scene.base.joints):
            raise SettingError("scene", scene.name, "a scene of a robot with an arm")
        self._goals: dict[str, Where] = {}
        self._grasps: dict[str, tuple[Grasp, ...]] = {}
        self._allowed: list[object] = []

    def place(
        self,
        name: str,
        *,
        on: str | None = None,
        at: ArrayLike | None = None,
        in_region: ArrayLike | None = None,
        n: int = PLACEMENTS,
    ) -> Job:
        """Require that an object stands somewhere in the end; return the job.

        Args:
            name: Object of the scene, or any body whose parent is the world.
            on: Body on whose horizontal top it shall stand.
            at: Its pose in W, 4 x 4, or its position [m] in the orientation that it has.
            in_region: Region as in `placements`.
            n: Number of placements to choose from.

        Raises:
            UnknownNameError: If there is no such object or body.
            SettingError: If not one of `at` and `on` or `in_region` is given, or the object has a goal already.
        """
        body = self._body(name)
        if body in self._goals:
            raise SettingError("place", name, "an object without a goal")
        if (at is None) == (on is None and in_region is None):
            raise SettingError("place", name, "either at=, or on= and in_region=")
        if on is not None:
            self.scene.geoms_named(on)
        pose = None if at is None else self._pose(body, at)
        self._goals[body] = Where(on=on, in_region=in_region, n=n, at=pose)
        return self

    def use(self, name: str, given: Sequence[Grasp]) -> Job:
        """Use own grasps of an object instead of sampled ones; return the job."""
        self._grasps[self._body(name)] = tuple(given)
        return self

    def allow(self, *actions: Clear | CloseLid | Load | Action) -> Job:
        """Allow actions other than carrying objects to their goals; return the job."""
        for action in actions:
            if not isinstance(action, Clear | CloseLid | Load | Action):
                raise SettingError("actions", action, "Clear, CloseLid, Load, Open, Close, Pour, Wait or own Actions")
            if isinstance(action, Clear | Load):
                self._body(action.name)
            elif isinstance(action, CloseLid):
                self._body(action.lid)
                self._body(action.vessel)
            else:
                action.check(self.scene)
            self._allowed.append(action)
        return self

    def _body(self, name: str) -> str:
        scene = self.scene
        return held_note(scene.model, scene.notes, scene.robot_bodies, name, X_TO=np.eye(4)).body

    def _pose(self, body: str, at: ArrayLike) -> Float[Array, "4 4"]:
        if np.ndim(at) == 2:
            return rigid_pose(f"place of {body}", at)
        X = JobState(world=self.scene, q=np.zeros(0)).pose(body).copy()
        X[:3, 3] = finite_array(f"place of {body}", at, ndim=1, last=3)
        return X

    @property
    def goals(self) -> Mapping[str, Where]:
        """The goals by body."""
        return self._goals

    @property
    def allowed(self) -> tuple[object, ...]:
        """The allowed actions."""
        return tuple(self._allowed)

    @property
    def own_grasps(self) -> Mapping[str, tuple[Grasp, ...]]:
        """Grasps that were given, by body."""
        return self._grasps
