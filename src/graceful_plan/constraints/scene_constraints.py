"""Constraints in a scene: kernels that check what the core can, questions to the others, limits on timing."""

from __future__ import annotations

from collections.abc import Iterable
from typing import final

import numpy as np

from graceful_plan.array_types import Bool, Float
from graceful_plan.constraints.bounds import bounded_kernels
from graceful_plan.constraints.constraint import Constraint, checked_residual, residual_gradient
from graceful_plan.constraints.contents import KeepContents
from graceful_plan.constraints.felt import FeltCone, FeltConstraint, felt_limits
from graceful_plan.constraints.grasp import GraspHolds
from graceful_plan.constraints.speed import speed_limits
from graceful_plan.core.kernels import Kernels
from graceful_plan.costs.cost import StateBatch
from graceful_plan.exceptions import SettingError, UnsupportedError
from graceful_plan.scene.per_scene import per_scene
from graceful_plan.scene.rules.grip import find_grip
from graceful_plan.scene.rules.rules import CustomRule, SpeedRule
from graceful_plan.scene.rules.vessel import find_vessel
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.blend import CurveGrid
from graceful_plan.timing.retiming import slowed
from graceful_plan.timing.trajectory import Trajectory

Array = np.ndarray

_SLOWDOWN = 1.08
"""By how much a motion is slowed down at a time."""
_MOST_SLOWDOWNS = 40


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

    def __init__(self, scene: Scene, constraints: Iterable[Constraint]) -> None:
        self.scene, self.constraints = scene, tuple(constraints)
        for constraint in self.constraints:
            if not isinstance(constraint, Constraint):
                raise SettingError("constraints", constraint, "graceful_plan.Constraint objects, such as Upright()")
        rules = [(constraint, constraint.rule(scene)) for constraint in self.constraints]
        self.custom = tuple(constraint for constraint, rule in rules if isinstance(rule, CustomRule))
        """Those that only Python can check."""
        self.keepers = tuple(c for c in self.constraints if isinstance(c, KeepContents))
        carrying = [c for c in self.constraints if isinstance(c, FeltConstraint)]
        self.felt = tuple(c.felt(scene) for c in carrying)
        """What has to hold for what is felt where something is carried."""
        self.charged = tuple(limit for felt in self.felt if (limit := felt.native) is not None)
        """The part of it that descents of motions charge for; timing keeps all of it."""
        self.level = any(isinstance(felt, FeltCone) for felt in self.felt)
        """Whether something that is carried has to stay level."""
        self._speeds = tuple(rule for _, rule in rules if isinstance(rule, SpeedRule))
        resting = [rule for c in carrying for rule in c.resting(scene)]
        self.kernels: Kernels = bounded_kernels(scene, [*(rule for _, rule in rules), *resting])
        """The scene's kernels, which also check what the core can."""

    def objections(self, q: Float[Array, " nq"]) -> list[str]:
        """Say what does not hold in a configuration."""
        batch = StateBatch(self.scene, q[None])
        found = ((c, float(checked_residual(c, batch)[0])) for c in self.constraints)
        return [c.told(residual) for c, residual in found if residual > 0.0]

    def clearance(self, q: Float[Array, "n nq"]) -> Float[Array, " n"]:
        """Return how far configurations are from touching or breaking anything, in terms of clearance [m]."""
        clearance = self.kernels.clearance(q)
        return np.minimum(clearance, self.custom_clearance(q)[0]) if self.custom else clearance

    def on(self, scene: Scene) -> SceneConstraints:
        """Return the same constraints in another scene."""
        return SceneConstraints(scene, self.constraints)

    def around(self, q: Float[Array, "n nq"]) -> SceneConstraints:
        """Return constraints with room for some configurations in which they hold."""
        fitted = [c.around(q, self.scene) if isinstance(c, FeltConstraint) else c for c in self.constraints]
        return self if fitted == list(self.constraints) else SceneConstraints(self.scene, fitted)

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

    def limits(self, grid: CurveGrid) -> Float[Array, "interval limit 3"]:
        """Return limits on how fast a curve is travelled: a u + b x <= c, see `Restraint`.

        Raises:
            RetimingError: If something does not even hold at rest somewhere along the curve.
        """
        felt = felt_limits(self.felt, self.kernels, grid)
        return np.concatenate([felt, speed_limits(self._speeds, self.scene, grid)], axis=1)

    def calmed(self, trajectory: Trajectory) -> Trajectory:
        """Slow a motion down until what sloshes in what is carried stays in."""
        for _ in range(_MOST_SLOWDOWNS):
            if all(keeper.holds(trajectory, self.scene) for keeper in self.keepers):
                break
            trajectory = slowed(trajectory, _SLOWDOWN)
        return trajectory


def default_constraints(scene: Scene) -> tuple[Constraint, ...]:
    """Return what holds unless a call says otherwise.

    That is what the scene asks for, that the contents of what is carried are kept, and that a grasp between two pads
    that the model describes, and that holds in the scene's home configuration, holds on the way.
    """
    declared = tuple(asked for asked in scene.notes.constraints if isinstance(asked, Constraint))
    asked = {type(constraint) for constraint in declared}
    return (*declared, *(own for own in _unasked(scene) if type(own) not in asked))


@per_scene
def _unasked(scene: Scene) -> tuple[Constraint, ...]:
    contents = (KeepContents(),) if find_vessel(scene) is not None else ()
    return (*contents, *_held(scene))


def _held(scene: Scene) -> tuple[GraspHolds, ...]:
    """Return that the grasp holds, if the model says with what force, and that it does at home."""
    if scene.carried is None:
        return ()
    try:
        if np.isnan(find_grip(scene).force):
            return ()
    except UnsupportedError:
        return ()
    home, grasp = scene.home_qpos[scene.qpos_adr], GraspHolds()
    return (grasp,) if grasp.residual(StateBatch(scene, home[None]))[0] <= 0.0 else ()
