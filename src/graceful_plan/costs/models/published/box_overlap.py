"""Algorithm 1 of the paper: overlap of axis-aligned boxes in top view.

Every geom is replaced by one box, aligned with the world's axes. A_r is the ground area of all boxes of component r,
A_e that of all boxes of entity e, A_overlap the overlap in xy summed over all pairs of them:

    P(e, r) = max(A_overlap / A_r, A_overlap / A_e)

if r as a whole is above e as a whole (the lowest point of r above the highest of e) or beside it (the heights of both,
from lowest to highest point, overlap). A component that is wholly below an entity has P = 0. Speed, height, bounce and
obstacles in between are ignored: see `docs/limitations.md`.

References:
    Nguyen et al., "Failing Gracefully", Algorithm 1, as printed. Differs from the paper in: P is clipped at 1,
    which the sum over pairs of stacked geoms can exceed; a body with a ground area below 1e-6 mm^2 has P = 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from graceful_plan.array_types import Array, Float
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import ImpactKernel
from graceful_plan.costs.cost import StateBatch
from graceful_plan.costs.native_model import NativeModel, OwnLoss
from graceful_plan.scene.scene import Scene


@final
@dataclass(frozen=True)
class BoxOverlap(NativeModel):
    """Algorithm 1, on the native kernel."""

    def probability(self, batch: StateBatch) -> Float[Array, "n component entity"]:
        """Return P by Algorithm 1."""
        return batch.compiled.kernels.interaction(batch.q)

    def kernel(
        self,
        scene: Scene,
        severity: Float[Array, "component entity"],
        paces: tuple[float, float],
        own: OwnLoss | None = None,
    ) -> ImpactKernel:
        """Return the native kernel; velocities do not matter."""
        del paces, own
        return compile_scene(scene).kernels.overlap(severity)
