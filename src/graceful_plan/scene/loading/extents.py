"""Warn of links far larger than their robot: meshes in millimetres that were read as metres."""

from __future__ import annotations

import logging
from collections.abc import Collection
from pathlib import Path

import mujoco
import numpy as np

from graceful_plan.scene.model_parts import ancestors, colliding_geoms

_LOG = logging.getLogger(__name__)

_DWARFS = 10.0
"""Size of a link relative to the reach of its robot from which it is suspicious. A mesh in millimetres is
1000 times too large."""
_LARGE = 3.0
"""Size up to which no link is suspicious [m]: turntables and gantries have short chains."""
_STROKE = 2.0
"""Largest stroke of a slide that counts as reach [m]; those of mobile bases are far longer."""


def warn_of_extents(
    model: mujoco.MjModel, spec: mujoco.MjSpec, robot: Collection[int], joints: Collection[int]
) -> None:
    """Log a warning for each link of a robot that dwarfs the robot's reach, with the mesh file and the factor.

    Args:
        model: The model.
        spec: The MjSpec from which it was compiled.
        robot: Bodies of the robot.
        joints: Planned joints.
    """
    files = {mesh.name or Path(mesh.file).stem: mesh.file for mesh in spec.meshes}
    reach = _reach(model, joints)
    for body in sorted(robot):
        geoms = list(colliding_geoms(model, [body]))
        sizes = 2.0 * model.geom_aabb[geoms, 3:].max(axis=1)
        if not geoms or sizes.max() <= max(_LARGE, _DWARFS * reach):
            continue
        geom = geoms[int(sizes.argmax())]
        mesh = int(model.geom_dataid[geom]) if int(model.geom_type[geom]) == int(mujoco.mjtGeom.mjGEOM_MESH) else -1
        shape = f"mesh {files.get(model.mesh(mesh).name) or model.mesh(mesh).name!r}" if mesh >= 0 else "geom"
        advice = "; a mesh in millimetres needs the scale 0.001 0.001 0.001" if mesh >= 0 else ""
        _LOG.warning(
            "link %r is %.3g m large, %.0f times the %.2g m from the base of the robot to its tool: check its %s%s",
            model.body(body).name,
            sizes.max(),
            sizes.max() / max(reach, 1e-3),
            reach,
            shape,
            advice,
        )


def _reach(model: mujoco.MjModel, joints: Collection[int]) -> float:
    """Return the length of the chain of the planned joints [m]."""
    bodies = {int(model.jnt_bodyid[j]) for j in joints}
    chain = [body for body in ancestors(model, max(bodies)) if not bodies.isdisjoint(ancestors(model, body)[1:])]
    slides = [j for j in joints if int(model.jnt_type[j]) == int(mujoco.mjtJoint.mjJNT_SLIDE)]
    strokes = np.minimum(np.ptp(model.jnt_range[slides], axis=1), _STROKE)
    return float(np.linalg.norm(model.body_pos[chain], axis=1).sum() + strokes.sum())
