"""Constraints in a scene: kernels that check what the core can, questions to the others, limits on timing."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import final

import numpy as np

from graceful_plan.array_types import Bool, Float
from graceful_plan.constraints.constraint import (
    Constraint,
    NativeConstraint,
    StateBounds,
    checked_residual,
    residual_gradient,
)
from graceful_plan.constraints.contents import KeepContents
from graceful_plan.constraints.felt import FeltCone, felt_limits
from graceful_plan.constraints.tool import ToolSpeed
from graceful_plan.constraints.vessel import find_vessel
from graceful_plan.core.arrays import BoundArrays
from graceful_plan.core.compile import CompiledScene, compile_scene
from graceful_plan.core.kernels import Kernels
from graceful_plan.costs.cost import StateBatch
from graceful_plan.exceptions import SettingError
from graceful_plan.scene.per_scene import per_scene
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.blend import CurveGrid
from graceful_plan.timing.retiming import slowed
from graceful_plan.timing.trajectory import Trajectory

Array = np.ndarray

_SLOWDOWN = 1.08
"""By how much a motion is slowed down at a time."""
_MOST_SLOWDOWNS = 12

AnyConstraint = Constraint | ToolSpeed


@final
class SceneConstraints:
    """What has to hold along a motion in a scene.

    Args:
        scene: The scene.
        constraints: What was asked for.

    Raises:
        SettingError: If one of them is no constraint.
        GracefulPlanError: If one cannot be asked for in this scene.
    """

    def __init__(self, scene: Scene, constraints: Iterable[AnyConstraint]) -> None:
        self.scene, self.constraints = scene, tuple(constraints)
        for constraint in self.constraints:
            if not isinstance(constraint, Constraint | ToolSpeed):
                raise SettingError("constraints", constraint, "graceful_plan.Constraint objects, such as Upright()")
            if isinstance(constraint, Constraint):
                constraint.check(scene)
        self.geometric = tuple(c for c in self.constraints if isinstance(c, Constraint))
        self.custom = tuple(c for c in self.geometric if not isinstance(c, NativeConstraint))
        """Those that only Python can check."""
        self.keepers = tuple(c for c in self.constraints if isinstance(c, KeepContents))
        self.cones: tuple[FeltCone, ...] = tuple(keeper.felt(scene) for keeper in self.keepers)
        compiled = compile_scene(scene)
        native = tuple(c.bounds(scene) for c in self.geometric if isinstance(c, NativeConstraint))
        kernels = bounded_kernels(scene, native) if native else compiled.kernels
        self.compiled: CompiledScene = replace(compiled, kernels=kernels)

    @property
    def kernels(self) -> Kernels:
        """The scene's kernels, which also check what the core can."""
        return self.compiled.kernels

    def objections(self, q: Float[Array, " nq"], slack: float = 0.0) -> list[str]:
        """Say what does not hold in a configuration by more than a slack in terms of clearance [m]."""
        batch = StateBatch(self.scene, q[None])
        found = ((c, float(checked_residual(c, batch)[0])) for c in self.geometric)
        return [c.told(residual) for c, residual in found if c.lever * residual > slack]

    def clearance(self, q: Float[Array, "n nq"]) -> Float[Array, " n"]:
        """Return how far configurations are from touching or breaking anything, in terms of clearance [m]."""
        clearance = self.kernels.clearance(q)
        return np.minimum(clearance, self.custom_clearance(q)[0]) if self.custom else clearance

    def on(self, scene: Scene) -> SceneConstraints:
        """Return the same constraints in another scene."""
        return SceneConstraints(scene, self.constraints)

    def custom_clearance(self, q: Float[Array, "n nq"]) -> tuple[Float[Array, " n"], Float[Array, "n nq"]]:
        """Return how far inside of all custom constraints configurations are, as clearance [m], and its gradient."""
        batch = StateBatch(self.scene, q)
        least, gradient = np.full(len(q), np.inf), np.zeros_like(q)
        for constraint in self.custom:
            clearance = -constraint.lever * checked_residual(constraint, batch)
            nearer = clearance < least
            if np.any(nearer):
                of = StateBatch(self.scene, q[nearer])
                least[nearer] = clearance[nearer]
                gradient[nearer] = -constraint.lever * residual_gradient(constraint, of)
        return least, gradient

    def custom_holds(self, q: Float[Array, "n nq"], margin: float) -> Bool[Array, " n"]:
        """Tell in which configurations all custom constraints hold with a margin in terms of clearance [m]."""
        batch, holds = StateBatch(self.scene, q), np.ones(len(q), dtype=bool)
        for constraint in self.custom:
            holds &= -constraint.lever * checked_residual(constraint, batch) >= margin
        return holds

    def calmed(self, trajectory: Trajectory) -> Trajectory:
        """Slow a motion down until what sloshes in what is carried stays in."""
        for _ in range(_MOST_SLOWDOWNS):
            if all(keeper.holds(trajectory, self.scene, self.kernels) for keeper in self.keepers):
                break
            trajectory = slowed(trajectory, _SLOWDOWN)
        return trajectory

    def limits(self, grid: CurveGrid) -> Float[Array, "interval limit 3"]:
        """Return limits on how fast a curve is travelled: a u + b x <= c, see `felt_limits`.

        Raises:
            RetimingError: If something does not even hold at rest somewhere along the curve.
        """
        if not self.cones:
            return np.zeros((len(grid.s) - 1, 0, 3))
        return felt_limits(self.cones, self.kernels, grid)


def default_constraints(scene: Scene) -> tuple[AnyConstraint, ...]:
    """Return what holds in a scene unless somebody says otherwise: contents stay in the vessel that is carried."""
    return () if find_vessel(scene) is None else (KeepContents(),)


@per_scene(most=8)
def bounded_kernels(scene: Scene, native: Sequence[StateBounds]) -> Kernels:
    """Return the scene's kernels with bounds that the core checks."""
    compiled = compile_scene(scene)
    axes = [axis for bounds in native for axis in bounds.axes]
    points = [point for bounds in native for point in bounds.points]
    keep = np.zeros(len(compiled.world.geom))
    for geom, metres in (pair for bounds in native for pair in bounds.keep):
        mine = compiled.world.geom == geom
        keep[mine] = np.maximum(keep[mine], metres)
    arrays = BoundArrays(
        cone_link=np.array([axis.link for axis in axes], dtype=int),
        cone=np.array([(*axis.axis, *axis.direction, axis.angle) for axis in axes]).reshape(-1, 7),
        room_link=np.array([point.link for point in points], dtype=int),
        room=np.array([(*p.point, *p.rotation, *p.position, *p.lower, *p.upper) for p in points]).reshape(-1, 21),
        keep=keep,
    )
    return Kernels(compiled.robot, compiled.world, compiled.hazards, bounds=arrays)
