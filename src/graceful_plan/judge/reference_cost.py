"""The published objective once more, slowly: Algorithm 1 of the paper and joint-space length, in plain NumPy on MuJoCo.

The judge recomputes a planner's cost of that kind with this, and tests compare the kernels with it. It shares no code
with either.

References:
    T. Nguyen et al., "Failing Gracefully", Algorithm 1. P is clipped at 1 here: stacked geoms count their area more
    than once, which would make it more than certain.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.path import Path
from graceful_plan.result import CostBreakdown
from graceful_plan.scene.placement import Placement
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import Trajectory

Array = np.ndarray
Exposure = Literal["length", "time", "waypoints"]


def reference_probability(
    scene: Scene, q: Float[Array, "n nq"], components: Sequence[str] | None = None
) -> Float[Array, "n component entity"]:
    """Compute Algorithm 1: how likely each entity is hit by each component when it fails in each configuration.

    Every geom is replaced by its axis-aligned box. A robot geom counts against an entity's geom if it is above all of
    it; the overlap of their ground areas, summed over all pairs of geoms, is divided by the area of the entity and by
    that of the component, and the larger ratio is P.

    Args:
        scene: Where.
        q: Configurations.
        components: Names of components; all of the scene's by default.
    """
    names = list(scene.components) if components is None else list(components)
    P = np.zeros((len(q), len(names), len(scene.entities)))
    # Entities stand still while the robot moves, so one configuration shows them as well as any.
    lower, upper = _boxes(scene, q[:1], range(scene.model.ngeom))
    still = [(lower[:, list(e.geoms)], upper[:, list(e.geoms)]) for e in scene.entities.values()]
    parts = [geom for name in names for geom in scene.components[name].geoms]
    part_component = np.repeat(np.arange(len(names)), [len(scene.components[name].geoms) for name in names])
    lower_parts, upper_parts = _boxes(scene, q, parts)
    for j in range(len(names)):
        lower_r, upper_r = lower_parts[:, part_component == j], upper_parts[:, part_component == j]
        for i, (lower_e, upper_e) in enumerate(still):
            high = np.minimum(upper_r[:, :, None, :2], upper_e[:, None, :, :2])
            low = np.maximum(lower_r[:, :, None, :2], lower_e[:, None, :, :2])
            overlap = np.prod(np.maximum(0.0, high - low), axis=-1)
            above = lower_r[:, :, None, 2] > upper_e[:, None, :, 2]
            total = np.where(above, overlap, 0.0).sum(axis=(1, 2))
            P[:, j, i] = np.maximum(_ratio(total, _area(lower_e, upper_e)), _ratio(total, _area(lower_r, upper_r)))
    return np.minimum(P, 1.0)


def reference_cost(
    motion: Path | Trajectory,
    scene: Scene,
    *,
    w: float = 1.0,
    components: Sequence[str] = ("carried", "contents"),
    exposure: Exposure = "length",
    step: float = 0.0025,
) -> CostBreakdown:
    """Compute joint-space length plus weighted impact of a motion.

    Args:
        motion: A path, or a trajectory (along its curve, not along straight lines between samples).
        scene: Where.
        w: Safety weight.
        components: Components whose failure counts; those that the scene does not have are left out.
        exposure: Integrate over "length" or "time", or sum over "waypoints". A path is timed at the joints' velocity
            limits.
        step: Longest piece of the trapezoid rule [rad].
    """
    names = [name for name in components if name in scene.components]
    q, t = _points(motion, step, exposure, scene.limits.velocity)
    lengths = np.linalg.norm(np.diff(q, axis=0), axis=1)
    severity = np.array([[entity.severity[name] for entity in scene.entities.values()] for name in names])
    harm = reference_probability(scene, q, names) * severity.reshape(1, len(names), len(scene.entities))
    if exposure == "waypoints":
        exposed = harm.sum(axis=0)
    else:
        weight = lengths if exposure == "length" else np.diff(t)
        exposed = np.einsum("n,nji->ji", weight, 0.5 * (harm[:-1] + harm[1:]))
    return CostBreakdown(
        motion=float(lengths.sum()),
        impact=float(exposed.sum()),
        w=w,
        impact_by_entity=dict(zip(scene.entities, exposed.sum(axis=0).tolist(), strict=True)),
        impact_by_component=dict(zip(names, exposed.sum(axis=1).tolist(), strict=True)),
    )


def _points(
    motion: Path | Trajectory, step: float, exposure: Exposure, velocity: Float[Array, " nq"]
) -> tuple[Float[Array, "n nq"], Float[Array, " n"]]:
    """Sample the motion: configurations and times [s]."""
    if isinstance(motion, Path):
        q = motion.q if exposure == "waypoints" else motion.resampled(step).q
        pace = (np.abs(np.diff(q, axis=0)) / velocity).max(axis=1, initial=0.0)
        return q, np.concatenate([[0.0], np.cumsum(pace)])
    if exposure == "waypoints" or len(motion) == 1:
        return motion.q, motion.t
    parts = np.maximum(1, np.ceil(motion.path.segment_lengths / step)).astype(int)
    ends = zip(motion.t[:-1], motion.t[1:], parts, strict=True)
    t = np.append(np.concatenate([a + (b - a) * np.arange(k) / k for a, b, k in ends]), motion.t[-1])
    return motion.at(t).q, t


def _boxes(
    scene: Scene, q: Float[Array, "n nq"], geoms: Sequence[int]
) -> tuple[Float[Array, "n geom 3"], Float[Array, "n geom 3"]]:
    """Axis-aligned boxes of some geoms in W: lower and upper corners [m]."""
    placement, model, chosen = Placement(scene), scene.model, np.array(geoms, dtype=int)
    xpos, xmat = np.empty((len(q), len(chosen), 3)), np.empty((len(q), len(chosen), 3, 3))
    for n, configuration in enumerate(q):
        data = placement.place(configuration)
        xpos[n], xmat[n] = data.geom_xpos[chosen], data.geom_xmat[chosen].reshape(-1, 3, 3)
    centre = xpos + np.einsum("ngij,gj->ngi", xmat, model.geom_aabb[chosen, :3])
    half = np.einsum("ngij,gj->ngi", np.abs(xmat), model.geom_aabb[chosen, 3:])
    return centre - half, centre + half


def _area(lower: Float[Array, "n geom 3"], upper: Float[Array, "n geom 3"]) -> Float[Array, " n"]:
    """Total ground area of some boxes [m^2]."""
    return np.prod((upper - lower)[..., :2], axis=-1).sum(axis=1)


def _ratio(total: Float[Array, " n"], area: Float[Array, " m"]) -> Float[Array, " n"]:
    area = np.broadcast_to(area, total.shape)
    return np.divide(total, area, out=np.zeros_like(total), where=area > 0.0)
