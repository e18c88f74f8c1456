"""Constraints in a scene: kernels that check what the core can, questions to the others, limits on timing."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property
from typing import final

import numpy as np

from graceful_plan.array_types import Bool, Float
from graceful_plan.constraints.base_limits import base_limits
from graceful_plan.constraints.bounds import bounded_kernels, bounds_of
from graceful_plan.constraints.constraint import Constraint, checked_residual, residual_gradient
from graceful_plan.constraints.contents import KeepContents
from graceful_plan.constraints.felt import FeltCone, FeltConstraint, felt_in, resting_in
from graceful_plan.constraints.grasp import GraspHolds
from graceful_plan.constraints.speed import speed_limits
from graceful_plan.core.kernels import Kernels
from graceful_plan.costs.cost import StateBatch
from graceful_plan.exceptions import SettingError, UnsupportedError
from graceful_plan.path import Path
from graceful_plan.scene.per_scene import per_layout
from graceful_plan.scene.rules.grip import find_grip
from graceful_plan.scene.rules.rules import CustomRule, SpeedRule
from graceful_plan.scene.rules.vessel import find_vessel
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.blend import Curve
from graceful_plan.timing.retiming import retime, timed
from graceful_plan.timing.topp import FeltLevels, Restraint
from graceful_plan.timing.trajectory import Trajectory

Array = np.ndarray

_CAREFUL = 0.6
"""Of the angle that keeps contents in, what searches and the first descents leave to what is felt, not to sloshing."""
_SHARES = (0.65, 0.6, 0.55, 0.5, 0.45, 0.4, 0.3)
"""The same of timings, one after the other, after the share that was asked for."""


@final
class SceneConstraints:
    """What has to hold along a motion in a scene.

    Args:
        scene: The scene.
        constraints: What was asked for.
        share: Of the angle that keeps contents in, what searches and descents leave to what is felt at most.

    Raises:
        SettingError: If one of them is no constraint.
        GracefulPlanError: If one cannot be asked for in this scene.
    """

    def __init__(self, scene: Scene, constraints: Iterable[Constraint], share: float = _CAREFUL) -> None:
        self.scene, self.constraints, self._share = scene, tuple(constraints), share
        for constraint in self.constraints:
            if not isinstance(constraint, Constraint):
                raise SettingError("constraints", constraint, "graceful_plan.Constraint objects, such as Upright()")
        rules = [(constraint, constraint.rule(scene)) for constraint in self.constraints]
        self.custom = tuple(constraint for constraint, rule in rules if isinstance(rule, CustomRule))
        """Those that only Python can check."""
        self.keepers = tuple(c for c in self.constraints if isinstance(c, KeepContents))
        carrying = self._carrying(share)
        self.felt = tuple(felt_in(scene, c) for c in carrying)
        """What has to hold for what is felt where something is carried."""
        self.charged = tuple(limit for felt in self.felt if (limit := felt.native) is not None)
        """The part of it that descents of motions charge for; timing keeps all of it."""
        self.level = any(isinstance(felt, FeltCone) for felt in self.felt)
        """Whether something that is carried has to stay level."""
        self._speeds = tuple(rule for _, rule in rules if isinstance(rule, SpeedRule))
        resting = [rule for c in carrying for rule in resting_in(scene, c)]
        self._bounds = bounds_of(scene, [*(rule for _, rule in rules), *resting])
        self.kernels: Kernels = bounded_kernels(scene, self._bounds)
        """The scene's kernels, which also check what the core can."""

    def objections(self, q: Float[Array, " nq"]) -> list[str]:
        """Say what does not hold in a configuration."""
        batch = StateBatch(self.scene, q[None])
        found = ((c, float(checked_residual(c, batch)[0])) for c in self.constraints)
        return [c.told(residual) for c, residual in found if residual > 0.0]

    def holds(self, q: Float[Array, "n nq"]) -> Bool[Array, " n"]:
        """Tell in which configurations nothing is to be objected."""
        batch = StateBatch(self.scene, q)
        met = [checked_residual(constraint, batch) <= 0.0 for constraint in self.constraints]
        return np.all(met, axis=0) if met else np.ones(len(q), dtype=bool)

    def clearance(self, q: Float[Array, "n nq"]) -> Float[Array, " n"]:
        """Return how far configurations are from touching or breaking anything, in terms of clearance [m]."""
        clearance = self.kernels.clearance(q)
        return np.minimum(clearance, self.custom_clearance(q)[0]) if self.custom else clearance

    def with_room(self, room: float) -> Kernels:
        """Return `kernels` that keep a distance from all obstacles besides [m]; the rules are as they are."""
        return bounded_kernels(self.scene, self._bounds, room)

    def on(self, scene: Scene) -> SceneConstraints:
        """Return the same constraints in another scene."""
        return SceneConstraints(scene, self.constraints, self._share)

    def around(self, q: Float[Array, "n nq"]) -> SceneConstraints:
        """Return constraints with room for some configurations in which they hold."""
        fitted = tuple(c.around(q, self.scene) if isinstance(c, FeltConstraint) else c for c in self.constraints)
        share = max([self._share, *(keeper.needed(q, self.scene) for keeper in self.keepers)])
        same = fitted == self.constraints and share == self._share
        return self if same else SceneConstraints(self.scene, fitted, share)

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

    def timed(self, curve: Curve, *, speed: float = 1.0, slower: Restraint | None = None) -> Trajectory:
        """Time a curve so that all limits hold along it and what sloshes in what is carried stays in.

        A surface swings beyond what is felt, how far depends on the curve: less and less of the angle is left to what
        is felt until the surface stays below the rim. Where that does not help the motion is slowed down as a whole.

        Args:
            curve: The curve.
            speed: Of the limits; see `retime`.
            slower: Further limits on path acceleration and speed.

        Raises:
            RetimingError: If something does not even hold at rest somewhere along the curve.
        """
        restraint, limits = self._restraint(slower), self.scene.limits
        return timed(curve, limits, self.scene.joints, speed=speed, restraint=restraint, felt=self.felt_levels)

    def retimed(self, path: Path, *, deviation: float | Float[Array, " corner"], speed: float = 1.0) -> Trajectory:
        """Time a polyline in the same way, its corners cut by so much; see `retime`."""
        return retime(
            path,
            self.scene.limits,
            self.scene.joints,
            deviation=deviation,
            speed=speed,
            restraint=self._restraint(None),
            felt=self.felt_levels,
        )

    @cached_property
    def felt_levels(self) -> FeltLevels | None:
        """Limits that leave less and less of the angle to what is felt in vessels; None where nothing is felt."""
        if not self.felt:
            return None
        levels = [self.felt]
        if self.keepers:
            most = max(keeper.share for keeper in self.keepers)
            shares = [most, *(share for share in _SHARES if share < most)]
            levels = [[felt_in(self.scene, c) for c in self._carrying(share)] for share in shares]
        names = tuple(felt.name for felt in self.felt)
        return FeltLevels(self.kernels.core, names, tuple(tuple(felt.timed for felt in level) for level in levels))

    def _restraint(self, slower: Restraint | None) -> Restraint | None:
        """Return what else restrains path acceleration and speed."""
        own: list[Restraint] = [] if slower is None else [slower]
        if self._speeds:
            own.append(lambda grid: speed_limits(self._speeds, self.scene, grid))
        if (limits_of_base := base_limits(self.scene)) is not None:
            own.append(limits_of_base)
        return (lambda grid: np.concatenate([limits(grid) for limits in own], axis=1)) if own else None

    def _carrying(self, share: float) -> list[FeltConstraint]:
        """Return constraints on what is felt, with some share of the angle at most for contents."""
        fitted = [c.at_most(share) if isinstance(c, KeepContents) else c for c in self.constraints]
        return [c for c in fitted if isinstance(c, FeltConstraint)]


def default_constraints(scene: Scene) -> tuple[Constraint, ...]:
    """Return what holds unless a call says otherwise.

    That is what the scene asks for, that the contents of what is carried are kept, and that a grasp between two pads
    that the model describes, and that holds in the scene's home configuration, holds on the way.
    """
    declared = tuple(asked for asked in scene.notes.constraints if isinstance(asked, Constraint))
    asked = {type(constraint) for constraint in declared}
    return (*declared, *(own for own in _unasked(scene) if type(own) not in asked))


@per_layout
def _unasked(scene: Scene) -> tuple[Constraint, ...]:
    contents = (KeepContents(),) if find_vessel(scene) is not None else ()
    return (*contents, *_held(scene))


def _held(scene: Scene) -> tuple[GraspHolds, ...]:
    """Return that the grasp holds, if the model says with what force, and that it does at home."""
    load = _load_at_home(scene)
    return () if load is None or load > 0.0 else (GraspHolds(),)


@per_layout
def not_held(scene: Scene) -> tuple[str, ...]:
    """Say so where a grasp that the model describes does not even hold at home, so that nothing is asked of it."""
    load = _load_at_home(scene)
    if load is None or load <= 0.0 or scene.carried is None:
        return ()
    return (f"{scene.carried.body!r} is not expected to stay in the fingers: {GraspHolds().told(load)}",)


def _load_at_home(scene: Scene) -> float | None:
    """Return the residual of the grasp at home; None if the model does not describe one between two pads."""
    if scene.carried is None:
        return None
    try:
        if np.isnan(find_grip(scene).force):
            return None
    except UnsupportedError:
        return None
    home = scene.home_qpos[scene.qpos_adr]
    return float(GraspHolds().residual(StateBatch(scene, home[None]))[0])
