"""Algorithm 1 of the paper: overlap, seen from above, of axis-aligned boxes.

P(e, r) = max(sum I / sum A_e, sum I / sum A_r), at most 1. I is the overlap in xy of a box of component r with a box of
entity e, counted if the component's box is entirely above the entity's; A are the boxes' areas in xy; every sum runs
over all boxes of a body. One box per geom, aligned with the world's axes. Speed, height, bounce and what lies between
do not enter: see `docs/limitations.md`.

References:
    Nguyen et al., "Failing Gracefully", Algorithm 1. Differs from the paper in: P is clipped at 1, which sums over
    stacked geoms can exceed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import ImpactKernel
from graceful_plan.costs.cost import StateBatch
from graceful_plan.costs.native_model import NativeModel
from graceful_plan.scene.scene import Scene

Array = np.ndarray


@final
@dataclass(frozen=True)
class BoxOverlap(NativeModel):
    """Algorithm 1, on the native kernel."""

    def probability(self, batch: StateBatch) -> Float[Array, "n component entity"]:
        """Return P by Algorithm 1."""
        return batch.compiled.kernels.interaction(batch.q)

    def kernel(
        self, scene: Scene, severity: Float[Array, "component entity"], paces: tuple[float, float]
    ) -> ImpactKernel:
        """Return the native kernel, to which velocities are all the same."""
        del paces
        return compile_scene(scene).kernels.overlap(severity)
