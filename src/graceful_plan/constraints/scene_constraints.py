"""Constraints bound to a scene: kernels for those that the core checks, Python checks for others, timing limits."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property, partial
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Bool, Float
from graceful_plan.constraints.base_limits import base_limits
from graceful_plan.constraints.bounds import bounded_kernels, bounds_of
from graceful_plan.constraints.constraint import Constraint, checked_residual, residual_gradient
from graceful_plan.constraints.contents import KeepContents
from graceful_plan.constraints.grasp import GraspHolds
from graceful_plan.constraints.specific_force import (
    Felt,
    SpecificForceCone,
    SpecificForceConstraint,
    felt_in,
    resting_in,
)
from graceful_plan.constraints.speed import speed_limits
from graceful_plan.constraints.torque import torque_limits
from graceful_plan.core.kernels import Kernels
from graceful_plan.costs.cost import StateBatch
from graceful_plan.exceptions import SettingError, UnsupportedError
from graceful_plan.path import Path
from graceful_plan.scene.per_scene import per_layout
from graceful_plan.scene.rules.grip import find_hold
from graceful_plan.scene.rules.rules import CustomRule, SpeedRule, TorqueRule
from graceful_plan.scene.rules.vessel import find_vessel
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.blend import Curve
from graceful_plan.timing.retiming import retime, timed
from graceful_plan.timing.topp import AT_REST, EndSpeeds, Restraint, SpecificForceLevels
from graceful_plan.timing.trajectory import Trajectory

_CAREFUL = 0.6
"""Fraction of the brim tilt that the specific force may use in searches and first descents; sloshing gets the rest."""
_SHARES = (0.65, 0.6, 0.55, 0.5, 0.45, 0.4, 0.3)
"""Fractions of the brim tilt that timing tries in turn, after the constraint's own share."""


@final
class SceneConstraints:
    """The constraints on a motion in a scene, ready for planners and timing.

    Args:
        scene: The scene.
        constraints: The constraints to enforce.
        share: Largest fraction of the brim tilt that the specific force may use in searches and descents.

    Raises:
        SettingError: If an element of `constraints` is not a constraint.
        GracefulPlanError: If a constraint does not apply to the scene.
    """

    def __init__(self, scene: Scene, constraints: Iterable[Constraint], share: float = _CAREFUL) -> None:
        self.scene, self.constraints, self._share = scene, tuple(constraints), share
        for constraint in self.constraints:
            if not isinstance(constraint, Constraint):
                raise SettingError("constraints", constraint, "graceful_plan.Constraint objects, such as Upright()")
        rules = [(constraint, constraint.rule(scene)) for constraint in self.constraints]
        self.custom = tuple(constraint for constraint, rule in rules if isinstance(rule, CustomRule | TorqueRule))
        """Constraints that only Python can check."""
        self.keepers = tuple(c for c in self.constraints if isinstance(c, KeepContents))
        carrying = self._carrying(share)
        self.felt = tuple(felt_in(scene, c) for c in carrying)
        """Limits on the specific force of the carried object."""
        self.penalised = tuple(limit for felt in self.felt if (limit := felt.native) is not None)
        """The subset of these limits that descents penalise; timing enforces all of them."""
        self.level = any(isinstance(felt, SpecificForceCone) for felt in self.felt)
        """Whether a constraint keeps part of the carried object level."""
        self._speeds = tuple(rule for _, rule in rules if isinstance(rule, SpeedRule))
        self._torques = tuple(rule for _, rule in rules if isinstance(rule, TorqueRule))
        resting = [rule for c in carrying for rule in resting_in(scene, c)]
        self._bounds = bounds_of(scene, [*(rule for _, rule in rules), *resting])
        self.kernels: Kernels = bounded_kernels(scene, self._bounds)
        """The scene's kernels, extended by all constraints that the core can check."""

    def objections(self, q: Float[Array, " nq"]) -> list[str]:
        """Return a message for each constraint that a configuration violates."""
        batch = StateBatch(self.scene, q[None])
        found = ((c, float(checked_residual(c, batch)[0])) for c in self.constraints)
        return [c.told(residual) for c, residual in found if residual > 0.0]

    def holds(self, q: Float[Array, "n nq"]) -> Bool[Array, " n"]:
        """Return whether each configuration satisfies all constraints."""
        batch = StateBatch(self.scene, q)
        met = [checked_residual(constraint, batch) <= 0.0 for constraint in self.constraints]
        return np.all(met, axis=0) if met else np.ones(len(q), dtype=bool)

    def clearance(self, q: Float[Array, "n nq"]) -> Float[Array, " n"]:
        """Return the distance of each configuration from collision or violation, as clearance [m]."""
        clearance = self.kernels.clearance(q)
        return np.minimum(clearance, self.custom_clearance(q)[0]) if self.custom else clearance

    def with_room(self, room: float) -> Kernels:
        """Return `kernels` that keep an additional clearance from all obstacles [m]; rules are unchanged."""
        return bounded_kernels(self.scene, self._bounds, room)

    def on(self, scene: Scene) -> SceneConstraints:
        """Return the same constraints in another scene."""
        return SceneConstraints(scene, self.constraints, self._share)

    def around(self, q: Float[Array, "n nq"]) -> SceneConstraints:
        """Return constraints relaxed, where they allow it, to admit the given configurations."""
        fitted = tuple(
            c.around(q, self.scene) if isinstance(c, SpecificForceConstraint) else c for c in self.constraints
        )
        share = max([self._share, *(keeper.needed(q, self.scene) for keeper in self.keepers)])
        same = fitted == self.constraints and share == self._share
        return self if same else SceneConstraints(self.scene, fitted, share)

    def custom_clearance(self, q: Float[Array, "n nq"]) -> tuple[Float[Array, " n"], Float[Array, "n nq"]]:
        """Return the least clearance of each configuration from violating a custom constraint [m], and its gradient."""
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
        """Return whether each configuration satisfies all custom constraints with a margin, as clearance [m]."""
        batch, holds = StateBatch(self.scene, q), np.ones(len(q), dtype=bool)
        for constraint in self.custom:
            holds &= -constraint.lever * checked_residual(constraint, batch) >= margin
        return holds

    def timed(
        self,
        curve: Curve,
        *,
        speed: float = 1.0,
        slower: Restraint | None = None,
        ends: EndSpeeds = AT_REST,
    ) -> Trajectory:
        """Time a curve such that all limits hold along it and no contents spill.

        A liquid surface swings beyond the direction of the specific force, by an amount that depends on the curve.
        Timing therefore reduces the angle left to the specific force step by step until the surface stays below the
        rim. If the last step does not suffice, the whole motion is slowed down, unless it has a velocity at an end.

        Args:
            curve: The curve.
            speed: Fraction of the limits to use; see `retime`.
            slower: Further limits on path acceleration and speed.
            ends: Speeds at both ends.

        Raises:
            RetimingError: If a limit is violated even at rest somewhere along the curve, or no motion has these speeds.
        """
        return timed(
            curve,
            self.scene.limits,
            self.scene.joints,
            speed=speed,
            restraint=self.restraint(slower),
            felt=self.felt_levels,
            ends=ends,
        )

    def retimed(
        self,
        path: Path,
        *,
        deviation: float | Float[Array, " corner"],
        speed: float = 1.0,
        ends: EndSpeeds = AT_REST,
    ) -> Trajectory:
        """Time a polyline as `timed` does, with its corners cut by up to `deviation`; see `retime`."""
        return retime(
            path,
            self.scene.limits,
            self.scene.joints,
            deviation=deviation,
            speed=speed,
            restraint=self.restraint(None),
            felt=self.felt_levels,
            start_speed=ends.start,
            end_speed=ends.end,
        )

    @cached_property
    def felt_levels(self) -> SpecificForceLevels | None:
        """Limits on the specific force, with a smaller share of the brim tilt at each level; None if there are none."""
        if not self.felt:
            return None
        names = tuple(felt.name for felt in self.felt)
        levels = tuple(tuple(felt.timed for felt in level) for level in self._felt_by_level)
        return SpecificForceLevels(self.kernels.core, names, levels)

    @property
    def steady_levels(self) -> tuple[SpecificForceLevels | None, ...]:
        """The levels of `felt_levels` one by one, for motions that do not begin at rest; sloshing is left out."""
        if not self.felt:
            return (None,)
        names = tuple(felt.name for felt in self.felt)
        return tuple(
            SpecificForceLevels(self.kernels.core, names, (tuple(felt.steady for felt in level),))
            for level in self._felt_by_level
        )

    @cached_property
    def _felt_by_level(self) -> tuple[tuple[Felt, ...], ...]:
        """Limits on the specific force, with a smaller share of the brim tilt at each level."""
        if not self.keepers:
            return (self.felt,)
        most = max(keeper.share for keeper in self.keepers)
        shares = [most, *(share for share in _SHARES if share < most)]
        return tuple(tuple(felt_in(self.scene, c) for c in self._carrying(share)) for share in shares)

    def restraint(self, slower: Restraint | None = None) -> Restraint | None:
        """Return the other limits on path acceleration and speed: of the caller, tool, drives and base."""
        own: list[Restraint] = [] if slower is None else [slower]
        if self._speeds:
            own.append(lambda grid: speed_limits(self._speeds, self.scene, grid))
        own += [partial(torque_limits, rule, self.scene) for rule in self._torques]
        if (limits_of_base := base_limits(self.scene)) is not None:
            own.append(limits_of_base)
        return (lambda grid: np.concatenate([limits(grid) for limits in own], axis=1)) if own else None

    def _carrying(self, share: float) -> list[SpecificForceConstraint]:
        """Return the constraints on specific force, with the share of contents limited to `share`."""
        fitted = [c.at_most(share) if isinstance(c, KeepContents) else c for c in self.constraints]
        return [c for c in fitted if isinstance(c, SpecificForceConstraint)]


def default_constraints(scene: Scene) -> tuple[Constraint, ...]:
    """Return the constraints that apply by default.

    These are the constraints that the scene declares; that contents stay in the carried vessel; and that the grasp
    holds, provided that the model describes a grasp between two pads that holds in the scene's home configuration.
    """
    declared = tuple(asked for asked in scene.notes.constraints if isinstance(asked, Constraint))
    asked = {type(constraint) for constraint in declared}
    return (*declared, *(own for own in _unasked(scene) if type(own) not in asked))


@per_layout
def _unasked(scene: Scene) -> tuple[Constraint, ...]:
    contents = (KeepContents(),) if find_vessel(scene) is not None else ()
    return (*contents, *_held(scene))


def _held(scene: Scene) -> tuple[GraspHolds, ...]:
    """Return the grasp constraint if the model defines the grip force and the grasp holds at home."""
    load = _load_at_home(scene)
    return () if load is None or load > 0.0 else (GraspHolds(),)


@per_layout
def grasp_warnings(scene: Scene) -> tuple[str, ...]:
    """Return a warning if the model's grasp does not hold even at home, in which case it is not constrained."""
    load = _load_at_home(scene)
    if load is None or load <= 0.0 or scene.carried is None:
        return ()
    return (f"{scene.carried.body!r} is not expected to stay in the gripper: {GraspHolds().told(load)}",)


def _load_at_home(scene: Scene) -> float | None:
    """Return the residual of the grasp at home; None if the model does not describe the grip."""
    if scene.carried is None:
        return None
    try:
        if np.isnan(find_hold(scene).force):
            return None
    except UnsupportedError:
        return None
    home = scene.home_qpos[scene.qpos_adr]
    return float(GraspHolds().residual(StateBatch(scene, home[None]))[0])
