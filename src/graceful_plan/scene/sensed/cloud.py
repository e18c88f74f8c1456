"""Point clouds and depth images as obstacles: the grid cells that contain points."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import final

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SettingError, ShapeError
from graceful_plan.path import finite_array, is_real, plain_numbers, real_array
from graceful_plan.scene.facts import SceneFacts
from graceful_plan.scene.roles import rigid_pose
from graceful_plan.scene.sensed.boxes import FARTHEST, add_boxes, check_width, closed, joined
from graceful_plan.scene.sensed.own_points import on_robot

_NOISE = 0.01
"""Noise of depth sensors at the distance of an arm [m]."""
_MOST_CELLS = 1e8
"""Largest number of cells in the bounding box of all points, one byte each."""


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class PointCloud:
    """Points from a sensor, as an obstacle to add to a scene with `Scene.edit`.

    Grid cells that contain a point are occupied, as are gaps of up to two cells between them; without this closing,
    noise would turn a table into a thousand boxes. Grown by `inflation`, the cells are the obstacle, as boxes of one
    body. Space that the sensor did not see counts as free. `without_robot` leaves out points on the robot.

    | field      | meaning                                                                        | unit | shape   |
    |------------|--------------------------------------------------------------------------------|------|---------|
    | name       | of the new body                                                                |      |         |
    | points     | in the frame of `pose`; those with NaN or infinity are ignored                 | m    | point 3 |
    | resolution | width of a cell                                                                | m    |         |
    | inflation  | growth of the cells in all directions                                          | m    |         |
    | pose       | of the frame of the points in W; W itself if None                              |      | 4 4     |
    | entity     | entity class if it can be harmed; None for an obstacle only                    |      |         |

    Raises:
        ShapeError: If the points are not an array of shape (n, 3).
        SettingError: If a width is out of range, or a point is farther than 500 m from the origin of W.
    """

    name: str
    points: ArrayLike
    resolution: float = 0.02
    inflation: float = 0.0
    pose: ArrayLike | None = None
    entity: str | None = None

    def __post_init__(self) -> None:
        plain_numbers(self)
        points = real_array(f"points of {self.name}", self.points)
        if points.ndim != 2 or points.shape[1] != 3:
            raise ShapeError(f"points of {self.name}", points.shape, "(n, 3)")
        check_width(f"resolution of {self.name}", self.resolution)
        if not (is_real(self.inflation) and 0.0 <= self.inflation <= FARTHEST):
            valid = f"a finite distance of at least 0 m, at most {FARTHEST:g}"
            raise SettingError(f"inflation of {self.name}", self.inflation, valid)
        points = points[np.isfinite(points).all(axis=1)]
        if self.pose is not None:
            X_WS = rigid_pose(f"pose of {self.name}", self.pose)
            points = points @ X_WS[:3, :3].T + X_WS[:3, 3]
        if points.size and np.abs(points).max() > FARTHEST:
            raise SettingError(f"points of {self.name}", float(np.abs(points).max()), f"within {FARTHEST:g} m of W")
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "pose", None)

    @classmethod
    def from_depth(
        cls,
        name: str,
        depth: ArrayLike,
        intrinsics: ArrayLike,
        pose: ArrayLike,
        *,
        near: float = 0.1,
        far: float = 3.0,
        resolution: float = 0.02,
        inflation: float = 0.0,
        entity: str | None = None,
    ) -> PointCloud:
        """Create a point cloud from the depth image of a pinhole camera.

        Args:
            name: Name of the new body.
            depth: Distance along the optical axis of each pixel [m], rows from the top; 0 and NaN where nothing was
                measured.
            intrinsics: Camera matrix, 3 x 3 [pixels]; pixel centres are at integers.
            pose: Pose of the camera in W, 4 x 4: x to the right in the image, y down, z forward.
            near: Least depth to use [m].
            far: Largest depth to use [m].
            resolution: As in `PointCloud`.
            inflation: As in `PointCloud`.
            entity: As in `PointCloud`.

        Raises:
            ShapeError: If depth or camera matrix has a wrong shape.
            SettingError: If `near` or `far` is out of range, or the camera matrix is singular.
        """
        for word, value in (("near", near), ("far", far)):
            if not (is_real(value) and 0.0 <= value <= FARTHEST and near <= far):
                valid = f"near at most far, both from 0 to {FARTHEST:g} m"
                raise SettingError(f"{word} of {name}", value, valid)
        image = real_array(f"depth of {name}", depth)
        if image.ndim != 2:
            raise ShapeError(f"depth of {name}", image.shape, "(rows, columns)")
        K = finite_array(f"intrinsics of {name}", intrinsics, ndim=2, last=3)
        if K.shape != (3, 3) or not np.linalg.det(K):
            raise SettingError(f"intrinsics of {name}", K.tolist(), "a camera matrix, 3 x 3, that can be inverted")
        row, column = np.nonzero((image >= near) & (image <= far))
        rays = np.stack([column, row, np.ones_like(row)], axis=1) @ np.linalg.inv(K).T
        points = rays * image[row, column][:, None]
        return cls(name=name, points=points, resolution=resolution, inflation=inflation, pose=pose, entity=entity)

    def without_robot(self, scene: SceneFacts, q: ArrayLike, margin: float | None = None) -> PointCloud:
        """Return this cloud without points on the robot and the object in its gripper.

        Args:
            scene: Scene with the robot.
            q: Configuration of the robot when the points were measured.
            margin: Distance from the collision geometry up to which points are left out [m]. Default: as far as the
                boxes of the remaining points reach, plus 1 cm for noise.

        Raises:
            ShapeError: If q does not fit the joints of the scene.
            SettingError: If the margin is out of range.
        """
        if margin is None:
            margin = float(np.sqrt(3.0)) * self.resolution + self.inflation + _NOISE
        if not (is_real(margin) and 0.0 <= margin <= FARTHEST):
            raise SettingError("margin", margin, f"a finite distance of at least 0 m, at most {FARTHEST:g}")
        points = np.asarray(self.points)
        at = finite_array("q", q, ndim=1, last=len(scene.joints))
        return replace(self, points=points[~on_robot(scene, at, points, margin)])

    @property
    def boxes(self) -> tuple[Float[Array, "box 3"], Float[Array, "box 3"]]:
        """Lower and upper corners of the occupied boxes in W [m]."""
        points = np.asarray(self.points)
        if not len(points):
            return np.zeros((0, 3)), np.zeros((0, 3))
        cells = np.floor(points / self.resolution).astype(np.int64)
        origin = cells.min(axis=0)
        cells -= origin
        size = cells.max(axis=0) + 1
        if np.prod(size.astype(float)) > _MOST_CELLS:
            wanted = (
                f"so coarse that the box around all points, {(size * self.resolution).round(1).tolist()} m, has at most"
            )
            raise SettingError(f"resolution of {self.name}", self.resolution, f"{wanted} {_MOST_CELLS:g} cells")
        full = np.zeros(size, dtype=bool)
        full[tuple(cells.T)] = True
        first, last = joined(np.stack(np.nonzero(closed(full)), axis=1))
        return (first + origin) * self.resolution - self.inflation, (last + origin) * self.resolution + self.inflation

    def add_to(self, spec: mujoco.MjSpec) -> None:
        """Add a body with all boxes.

        Raises:
            SceneError: If the name is taken.
            SettingError: If the resolution gives too many boxes.
        """
        add_boxes(spec, self.name, *self.boxes, "resolution")
