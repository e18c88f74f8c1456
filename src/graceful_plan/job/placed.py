"""An object where it stands in a scene, with the poses of its geoms; geoms may be moved to test for collisions.

Frames: W world, O object, G geom.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.core.frames import pose_matrix
from graceful_plan.scene.model_parts import colliding_geoms, subtree
from graceful_plan.scene.scene import Scene

Array = np.ndarray


class Placed:
    """A body of a scene with everything that is fixed to it.

    Args:
        scene: The scene.
        body: Name of the body.
    """

    def __init__(self, scene: Scene, body: str) -> None:
        self.scene, self.model = scene, scene.model
        self.data = data = scene.data_at(scene.home_qpos[scene.qpos_adr])
        self.body = int(self.model.body(body).id)
        self.bodies = subtree(self.model, self.body)
        self.geoms = colliding_geoms(self.model, self.bodies)
        self.X_WO = pose_matrix(data.xmat[self.body], data.xpos[self.body])
        X_WG = np.stack([pose_matrix(data.geom_xmat[g], data.geom_xpos[g]) for g in self.geoms])
        self.X_OG = np.linalg.inv(self.X_WO) @ X_WG

    def move(self, geoms: Sequence[int], X_WG: Float[Array, "geom 4 4"]) -> None:
        """Put geoms elsewhere in `data`."""
        for g, X in zip(geoms, X_WG, strict=True):
            self.data.geom_xpos[g], self.data.geom_xmat[g] = X[:3, 3], X[:3, :3].ravel()
