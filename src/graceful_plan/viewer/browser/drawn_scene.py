"""A copy of the scene on the page: one node per part, moved with each frame."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any, final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.scene.scene import Scene
from graceful_plan.viewer.shapes import parts

STRUCK = (255, 200, 0)
"""Colour of entities hit by a failure."""
_WIDE = 1.2
"""Width above which entities keep their colour, such as floors and tables [m]."""
_MOVED = 1e-6
"""Smallest change of a pose that is sent [m, or in a quaternion]."""


@final
class DrawnScene:
    """Parts of a scene under one node of the page.

    Args:
        server: viser's server.
        root: Name of the node.
        scene: Scene to draw.
        opacity: Opacity of all parts.
        shift: Position of its origin in W [m].
        only_moving: Whether to draw only parts moved by the robot, for a second robot in the same scene.
    """

    def __init__(
        self,
        server: Any,
        root: str,
        scene: Scene,
        *,
        opacity: float = 1.0,
        shift: Float[Array, " 3"] | None = None,
        only_moving: bool = False,
    ) -> None:
        self._root = server.scene.add_frame(root, show_axes=False, position=np.zeros(3) if shift is None else shift)
        self._drawn = parts(scene)
        mobile = _mobile(scene)
        self._frames: list[Any] = []
        self._meshes: list[list[Any]] = []
        for k, part in enumerate(self._drawn):
            if only_moving and part.name not in mobile:
                self._frames.append(None)
                self._meshes.append([])
                continue
            name = f"{root}/{k}"
            self._frames.append(server.scene.add_frame(name, show_axes=False))
            self._meshes.append(
                [
                    server.scene.add_mesh_simple(
                        f"{name}/{i}",
                        mesh.vertices,
                        mesh.faces,
                        color=mesh.colour,
                        opacity=None if opacity * mesh.opacity >= 1.0 else opacity * mesh.opacity,
                        material="toon3",  # several times faster than the default without a graphics card
                        cast_shadow=False,
                        receive_shadow=False,
                        side="double" if opacity * mesh.opacity < 1.0 else "front",
                    )
                    for i, mesh in enumerate(part.meshes)
                ]
            )
        self._position = np.full((len(self._drawn), 3), np.nan)
        self._turned = np.full((len(self._drawn), 4), np.nan)
        self._struck: frozenset[str] = frozenset()

    def put(self, position: Float[Array, "part 3"], turned: Float[Array, "part 4"]) -> None:
        """Move the parts whose poses changed."""
        for k, frame in enumerate(self._frames):
            if frame is None:
                continue
            if not np.abs(position[k] - self._position[k]).max() <= _MOVED:  # NaN before the first pose: also moves
                frame.position = position[k]
                self._position[k] = position[k]
            if not np.abs(turned[k] - self._turned[k]).max() <= _MOVED:
                frame.wxyz = turned[k]
                self._turned[k] = turned[k]

    def strike(self, names: Collection[str]) -> None:
        """Colour the entities that were hit, and restore the colour of all others."""
        if self._struck == frozenset(names):
            return
        for part, handles in zip(self._drawn, self._meshes, strict=True):
            was, is_now = part.entity in self._struck, part.entity in names
            if was != is_now and max(np.ptp(mesh.vertices, axis=0).max() for mesh in part.meshes) < _WIDE:
                for handle, mesh in zip(handles, part.meshes, strict=True):
                    handle.color = STRUCK if is_now else mesh.colour
        self._struck = frozenset(names)

    def remove(self) -> None:
        """Remove all parts from the page."""
        self._root.remove()


def _mobile(scene: Scene) -> frozenset[str]:
    """Return the names of the parts that the robot moves."""
    bodies = set(scene.robot_bodies)
    if scene.carried is not None:
        carried = scene.model.body(scene.carried.body).id
        bodies |= {
            b for b in range(scene.model.nbody) if scene.model.body_rootid[b] == scene.model.body_rootid[carried]
        }
    return frozenset(scene.model.body(body).name for body in bodies)
