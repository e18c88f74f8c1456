"""An open container modelled as a cylinder: capacity by tilt. The geoms of bundled containers are solid to MuJoCo."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.scene.elements import Granular
from graceful_plan.scene.per_scene import per_layout
from graceful_plan.scene.scene import Scene

_ROUNDING = 1e-9
REPOSE = np.deg2rad(33.0)
"""Slope at which dry contents begin to slide [rad]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Vessel:
    """A cylinder open at one end, in the frame of the carried body B.

    | field   | meaning                                                                   | unit  |
    |---------|---------------------------------------------------------------------------|-------|
    | radius  | inner radius                                                              | m     |
    | height  | of the rim above the bottom                                               | m     |
    | volume  | of the contents, at most the capacity of the cylinder                     | m^3   |
    | axis    | from the bottom to the rim                                                |       |
    | p_BR    | centre of the rim                                                         | m     |
    | repose  | angle of repose of the contents; 0 for liquids                            | rad   |
    """

    radius: float
    height: float
    volume: float
    axis: Float[Array, " xyz"]
    p_BR: Float[Array, " xyz"]
    repose: float

    @property
    def p_BS(self) -> Float[Array, " xyz"]:
        """Centre of the contents' surface when the vessel is upright [m]."""
        return self.p_BR - (self.height - self.volume / (np.pi * self.radius**2)) * self.axis

    def capacity(self, tilt: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """Return the volume that stays in the vessel at a tilt of its axis from the apparent vertical [rad, m^3].

        The surface is a plane through the lowest point of the rim. As long as it does not reach the bottom, its centre
        is below the rim by the radius times the tangent of the tilt; beyond that, the remaining contents form a wedge.
        """
        R, H = self.radius, self.height
        slope = np.tan(np.clip(tilt - self.repose, 1e-9, np.pi / 2 - 1e-9))
        x0 = np.clip(R - H / slope, -R, R)  # where the surface meets the bottom
        root = np.sqrt(R**2 - x0**2)
        wedge = slope * (2.0 / 3.0 * root**3 - x0 * (R**2 * np.arccos(x0 / R) - x0 * root))
        full = np.pi * R**2 * (H - R * slope)
        kept = np.where(2.0 * R * slope <= H, full, wedge)
        return np.where(tilt - self.repose < np.pi / 2, np.maximum(kept, 0.0), 0.0)

    @cached_property
    def brim_tilt(self) -> float:
        """Largest tilt at which all contents stay in, for a quasi-static surface [rad]."""
        low, high = 0.0, float(np.pi)
        for _ in range(60):
            middle = 0.5 * (low + high)
            enough = float(self.capacity(np.array(middle))) >= self.volume * (1.0 - _ROUNDING)
            low, high = (middle, high) if enough else (low, middle)
        return low


@per_layout
def find_vessel(scene: Scene) -> Vessel | None:
    """Return the carried container, in the frame of the carried body; None if the carried object has no contents.

    The geom of the contents gives bottom and radius, about its z axis. The rim is the top of the highest geom of the
    carried object that is centred on the same axis: a bottle's neck, but not a teapot's handle. Lids count as open.
    """
    model = scene.model
    if scene.contents is None or scene.carried is None:
        return None
    geoms = list(scene.components["contents"].geoms)
    geom = max(geoms, key=lambda g: float(np.prod(model.geom_aabb[g, 3:])))
    R_BG = _rotation(model.geom_quat[geom])
    centre = model.geom_pos[geom] + R_BG @ model.geom_aabb[geom, :3]
    half = model.geom_aabb[geom, 3:]
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    up = data.xmat[model.body(scene.carried.body).id].reshape(3, 3)[2] @ R_BG[:, 2]
    axis = R_BG[:, 2] * (1.0 if up >= 0.0 else -1.0)
    bottom = centre - half[2] * axis
    radius = float(2.0 * np.sqrt(half[0] * half[1] / np.pi)) if _is_box(model, geom) else float(half[:2].max())
    height = max(
        2.0 * float(half[2]), *(_top(model, g, bottom, axis, radius) for g in scene.components["carried"].geoms)
    )
    return Vessel(
        radius=radius,
        height=height,
        volume=min(1e-3 * scene.contents.volume, float(np.pi * radius**2 * height)),
        axis=axis,
        p_BR=bottom + height * axis,
        repose=float(REPOSE) if isinstance(scene.contents, Granular) else 0.0,
    )


def _top(
    model: mujoco.MjModel, geom: int, bottom: Float[Array, " xyz"], axis: Float[Array, " xyz"], radius: float
) -> float:
    """Return the height of a geom's top above the bottom; 0 if the geom is not centred on the axis."""
    R_BG = _rotation(model.geom_quat[geom])
    offset = model.geom_pos[geom] + R_BG @ model.geom_aabb[geom, :3] - bottom
    along = float(offset @ axis)
    aside = float(np.linalg.norm(offset - along * axis))
    reach = np.abs(R_BG) @ model.geom_aabb[geom, 3:]
    across = np.abs(R_BG.T @ axis)
    half = model.geom_aabb[geom, 3:]
    wide = half[across < 0.5]
    if aside > 0.25 * radius or across.max() < 0.9 or wide.min() < 0.5 * wide.max():
        return 0.0
    return along + float(reach @ np.abs(axis))


def _is_box(model: mujoco.MjModel, geom: int) -> bool:
    return int(model.geom_type[geom]) == int(mujoco.mjtGeom.mjGEOM_BOX)


def _rotation(quat: Float[Array, " wxyz"]) -> Float[Array, "3 3"]:
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quat)
    return matrix.reshape(3, 3)
