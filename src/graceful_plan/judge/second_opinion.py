"""A second opinion on collisions, from python-fcl: other narrow-phase algorithms on the same geometry."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Float, Int
from graceful_plan.exceptions import UnsupportedError
from graceful_plan.judge.exact import Judge, Touch
from graceful_plan.judge.motion_samples import MotionSamples
from graceful_plan.result import Check
from graceful_plan.scene.placement import Placement
from graceful_plan.scene.scene import Scene

_SHALLOWEST = 1e-4
"""Penetration up to which two iterative algorithms may disagree [m]."""
_GEOM = mujoco.mjtGeom


def opinion_of_fcl(samples: MotionSamples, scene: Scene) -> Check:
    """Check configurations for collision with python-fcl, under the same rules about allowed contacts."""
    judge = Judge(scene)
    touches = fcl_touches(samples.q, scene)
    violations = [t for t in judge.violations(touches, len(samples.q)) if -t.distance > _SHALLOWEST]
    if not violations:
        return Check(
            passed=True, worst=np.inf, detail=f"python-fcl, {len(samples.q)} configurations, signed distance [m]"
        )
    first, worst = min(violations), min(violations, key=lambda t: t.distance)
    contact = judge.named(first)
    detail = f"python-fcl: {contact.first} is {1e3 * contact.depth:.3g} mm in {contact.obstacle}"
    return Check(worst=worst.distance, first=float(samples.at[first.sample]), detail=detail)


def fcl_touches(q: Float[Array, "n nq"], scene: Scene) -> list[Touch]:
    """Return all overlaps of the scene's collision pairs in each configuration."""
    import fcl

    placement, model = Placement(scene), scene.model
    pairs = np.sort(scene.collision_pairs(), axis=1)
    shapes = {int(g): _shape(model, int(g)) for g in np.unique(pairs)}
    objects = {g: fcl.CollisionObject(shape, fcl.Transform()) for g, shape in shapes.items()}
    request = fcl.CollisionRequest(num_max_contacts=4, enable_contact=True)
    found = []
    for sample, configuration in enumerate(q):
        data = placement.place(configuration)
        for g, item in objects.items():
            item.setTransform(fcl.Transform(data.geom_xmat[g].reshape(3, 3), data.geom_xpos[g]))
        for a, b in _near(model, data, pairs):
            result = fcl.CollisionResult()
            if fcl.collide(objects[a], objects[b], request, result):
                depth = max((contact.penetration_depth for contact in result.contacts), default=0.0)
                found.append(Touch(sample, a, b, -abs(depth)))
    return found


def _near(model: mujoco.MjModel, data: mujoco.MjData, pairs: Int[Array, "pair 2"]) -> list[list[int]]:
    """Return the pairs whose bounding spheres overlap; a plane has none and is always included."""
    a, b = pairs.T
    radius = np.where(model.geom_type == _GEOM.mjGEOM_PLANE, np.inf, model.geom_rbound)
    distance = np.linalg.norm(data.geom_xpos[a] - data.geom_xpos[b], axis=1)
    return pairs[distance <= radius[a] + radius[b]].tolist()


def _shape(model: mujoco.MjModel, geom: int) -> Any:
    """Build the fcl shape of a geom, in the geom's frame."""
    import fcl

    size = model.geom_size[geom]
    kind = _GEOM(model.geom_type[geom])
    if kind == _GEOM.mjGEOM_MESH:
        return _hull(model, int(model.geom_dataid[geom]))
    makers = {
        _GEOM.mjGEOM_PLANE: lambda: fcl.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0),
        _GEOM.mjGEOM_SPHERE: lambda: fcl.Sphere(size[0]),
        _GEOM.mjGEOM_CAPSULE: lambda: fcl.Capsule(size[0], 2.0 * size[1]),
        _GEOM.mjGEOM_ELLIPSOID: lambda: fcl.Ellipsoid(*size),
        _GEOM.mjGEOM_CYLINDER: lambda: fcl.Cylinder(size[0], 2.0 * size[1]),
        _GEOM.mjGEOM_BOX: lambda: fcl.Box(*(2.0 * size)),
    }
    if kind not in makers:
        raise UnsupportedError(f"python-fcl has no shape for geom type {kind.name.removeprefix('mjGEOM_').lower()}")
    return makers[kind]()


def _hull(model: mujoco.MjModel, mesh: int) -> Any:
    import fcl
    from scipy.spatial import ConvexHull

    begin = int(model.mesh_vertadr[mesh])
    vertices = model.mesh_vert[begin : begin + int(model.mesh_vertnum[mesh])].astype(float)
    hull = ConvexHull(vertices)
    triangles = hull.simplices.copy()
    # Qhull does not orient its triangles; fcl requires them counter-clockwise from outside.
    corners = vertices[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flipped = np.einsum("ij,ij->i", normal, hull.equations[:, :3]) < 0.0
    triangles[flipped] = triangles[flipped][:, ::-1]
    faces = np.column_stack([np.full(len(triangles), 3), triangles]).ravel()
    return fcl.Convex(vertices, len(triangles), faces)
