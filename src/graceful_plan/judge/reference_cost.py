"""An independent, slow implementation of the published objective: Algorithm 1 and joint-space length, in NumPy.

The judge recomputes a planner's cost with it, and tests compare the kernels with it. It shares no code with either.
Poses come from the judge's own kinematics.

References:
    T. Nguyen et al., "Failing Gracefully", Algorithm 1. Differs from it in: P is clipped at 1, which it could exceed,
    since the overlap of stacked geoms counts more than once; a body with a ground area of less than 1e-6 mm^2 has
    P = 0, which would be 0 / 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SettingError
from graceful_plan.judge.kinematics import kinematics
from graceful_plan.path import Path
from graceful_plan.result import CostBreakdown
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import Trajectory

EXPOSURES = ("time", "length", "waypoints")

_LEAST_AREA = 1e-12
"""Ground area of a body below which P is 0 [m^2]."""


def reference_probability(
    scene: Scene, q: Float[Array, "n nq"], components: Sequence[str] | None = None
) -> Float[Array, "n component entity"]:
    """Compute P of Algorithm 1: the probability that each component hits each entity, given a failure at each state.

    Every geom is replaced by its axis-aligned box in W. A_r is the total ground area of the boxes of a component, A_e
    that of an entity, and A_overlap the total overlap of all pairs in top view. If the lowest point of the component is
    above the highest of the entity, or if the heights from lowest to highest point of both overlap, P is the maximum of
    A_overlap / A_r and A_overlap / A_e; otherwise it is 0.

    Args:
        scene: The scene.
        q: Configurations.
        components: Names of components; all of the scene's by default.
    """
    names = list(scene.components) if components is None else list(components)
    P = np.zeros((len(q), len(names), len(scene.entities)))
    # Entities are static, so one configuration is enough.
    entities = [_boxes(scene, q[:1], entity.geoms) for entity in scene.entities.values()]
    for j, name in enumerate(names):
        component = _boxes(scene, q, scene.components[name].geoms)
        for i, entity in enumerate(entities):
            P[:, j, i] = _probability(component, entity)
    return np.minimum(P, 1.0)


@dataclass(frozen=True, eq=False)
class _Boxes:
    """Axis-aligned boxes in W of a body's geoms: lower and upper corners [m]."""

    lower: Float[Array, "n geom 3"]
    upper: Float[Array, "n geom 3"]

    @property
    def area(self) -> Float[Array, " n"]:
        """Total ground area of the boxes [m^2]."""
        return np.prod((self.upper - self.lower)[..., :2], axis=-1).sum(axis=1)


def _probability(r: _Boxes, e: _Boxes) -> Float[Array, " n"]:
    """Return P of component r and entity e, not clipped."""
    if not (r.lower.size and e.lower.size):
        return np.zeros(len(r.lower))
    highest = np.minimum(r.upper[:, :, None, :2], e.upper[:, None, :, :2])
    lowest = np.maximum(r.lower[:, :, None, :2], e.lower[:, None, :, :2])
    overlap = np.prod(np.maximum(highest - lowest, 0.0), axis=-1).sum(axis=(1, 2))
    P = np.maximum(_ratio(overlap, r.area), _ratio(overlap, e.area))
    min_r, max_r = r.lower[..., 2].min(axis=1), r.upper[..., 2].max(axis=1)
    min_e, max_e = e.lower[..., 2].min(axis=1), e.upper[..., 2].max(axis=1)
    beside = np.minimum(max_r, max_e) - np.maximum(min_r, min_e) > 0.0
    return np.where((min_r > max_e) | beside, P, 0.0)


def reference_cost(
    motion: Path | Trajectory,
    scene: Scene,
    *,
    w: float = 1.0,
    components: Sequence[str] = ("carried", "contents"),
    exposure: str = "time",
    step: float = 0.0025,
) -> CostBreakdown:
    """Compute joint-space length plus weighted impact of a motion.

    Args:
        motion: A path, or a trajectory (along its curve, not along straight lines between samples).
        scene: The scene.
        w: Safety weight.
        components: Components whose failure counts; those that the scene does not have are ignored.
        exposure: Integrate over "time" or "length", or sum over "waypoints". A path is timed at the joints' velocity
            limits.
        step: Longest piece of the trapezoid rule [rad].

    Raises:
        SettingError: If there is no such exposure.
    """
    if exposure not in EXPOSURES:
        raise SettingError("exposure", exposure, f"one of {', '.join(EXPOSURES)}")
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
    motion: Path | Trajectory, step: float, exposure: str, velocity: Float[Array, " nq"]
) -> tuple[Float[Array, "n nq"], Float[Array, " n"]]:
    """Sample the motion: configurations and times [s]."""
    if isinstance(motion, Path):
        q = motion.q if exposure == "waypoints" else motion.resampled(step).q
        seconds = (np.abs(np.diff(q, axis=0)) / velocity).max(axis=1, initial=0.0)
        return q, np.concatenate([[0.0], np.cumsum(seconds)])
    if exposure == "waypoints" or len(motion) == 1:
        return motion.q, motion.t
    parts = np.maximum(1, np.ceil(motion.path.segment_lengths / step)).astype(int)
    ends = zip(motion.t[:-1], motion.t[1:], parts, strict=True)
    t = np.append(np.concatenate([a + (b - a) * np.arange(k) / k for a, b, k in ends]), motion.t[-1])
    return motion.at(t).q, t


def _boxes(scene: Scene, q: Float[Array, "n nq"], geoms: Sequence[int]) -> _Boxes:
    """Return the boxes of some geoms in W."""
    chosen, known = np.array(geoms, dtype=int), kinematics(scene)
    box, X_WG = scene.model.geom_aabb[chosen], known.poses(q, known.geoms[chosen]).transpose(1, 0, 2, 3)
    R_WG = X_WG[..., :3, :3]
    centre = X_WG[..., :3, 3] + (R_WG @ box[:, :3, None])[..., 0]
    half = (np.abs(R_WG) @ box[:, 3:, None])[..., 0]
    return _Boxes(centre - half, centre + half)


def _ratio(total: Float[Array, " n"], area: Float[Array, " m"]) -> Float[Array, " n"]:
    area = np.broadcast_to(area, total.shape)
    return np.divide(total, area, out=np.zeros_like(total), where=area > _LEAST_AREA)
