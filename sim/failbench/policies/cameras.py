"""Camera pictures for policies."""

from __future__ import annotations

from types import TracebackType

import mujoco

from failbench.pictures.offscreen import Offscreen, find_camera
from failbench.policies.episode import Camera
from failbench.policies.task import PolicyTask
from graceful_plan.array_types import Array, Float, UInt8


class PolicyCameras:
    """Takes pictures of a task with the cameras named in its settings. Use it in a `with` statement.

    The `with` statement returns a function from positions of the whole model to pictures by camera name, or None if no
    cameras are named.

    Raises:
        UnknownNameError: If the scene has no such camera.
        NoPicture: If no OpenGL works without a window.
    """

    def __init__(self, task: PolicyTask, names: tuple[str, ...] | None = None) -> None:
        self._model = task.world.model
        wanted = task.settings.cameras if names is None else names
        self._views = {name: find_camera(self._model, name or None) for name in wanted}
        self._size = task.settings.size
        self._offscreen: Offscreen | None = None

    def __enter__(self) -> Camera | None:
        if not self._views:
            return None
        height, width = self._size
        self._offscreen = Offscreen(self._model, width, height)
        self._data = mujoco.MjData(self._model)
        return self._pictures

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._offscreen is not None:
            self._offscreen.__exit__(kind, error, trace)
            self._offscreen = None

    def _pictures(self, qpos: Float[Array, " qpos"]) -> dict[str, UInt8[Array, "height width 3"]]:
        assert self._offscreen is not None
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        return {name: self._offscreen.picture(self._data, view).copy() for name, view in self._views.items()}
