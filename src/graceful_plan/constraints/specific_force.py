r"""Limits on the specific force that a carried object feels, as limits on path speed and path acceleration.

A point that moves by p' per unit of a curve's parameter s has the acceleration :math:`p'\ddot s + p''\dot s^2`. This
is linear in path acceleration and squared path speed, the form that TOPP-RA takes. The specific force at the point is
its acceleration minus gravity: the reading of an accelerometer there, called *felt* in this package. It is limited by
facets, half-spaces v f <= room. A pyramid of facets inscribed in a cone keeps it close to an axis, so that a level
object stays level in the accelerated frame. Facets with a bound above 0 keep it below the load that a grasp can carry.

References:
    J. Ichnowski et al., "GOMP-FIT: Grasp-Optimized Motion Planning for Fast Inertial Transport", ICRA 2022.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Bool, Float
from graceful_plan.constraints.constraint import Constraint
from graceful_plan.constraints.slosh import Slosh
from graceful_plan.core import _native
from graceful_plan.scene.per_scene import per_layout
from graceful_plan.scene.rules.rules import AxisRule
from graceful_plan.scene.scene import Scene

FACETS = 8
"""Sides of the pyramid inscribed in the cone: at worst it reduces the tangent by 1 - cos(pi / 8), 8 %."""
_HARDEST = 1.7
"""Largest specific force at the edge of the cone [g]. In FailBench, a change of velocity of 0.7 m/s within 0.03 s (2.4
g) throws contents out. Objects between fingers also swing: with a planned limit of 1.84, the glass of
bedside/bring_water exceeded it."""
_MILDEST = 1.2
"""Lower limit of the axial bound, for wide cones [g]: gravity at rest must satisfy it."""
_LIGHTEST, _OF_REST = 0.5, 0.7
"""Least axial specific force [g], and its upper limit as a fraction of the axial component at the edge of the cone.
Near free fall a small error of the robot can turn the direction anywhere: one in four fast motions with a wine glass
poured out half of it.
"""
_SELDOM_FELT = 40.0
"""Bound of a facet [m/s^2] above which only timing enforces it: specific forces are rarely that large, and each facet
costs descent time."""
_KEPT = 32
"""Constraints per scene whose limits are cached; each tilted start or goal adds a new one."""
_BELOW = 0.97
"""Fraction of the brim tilt that the sloshing surface may reach in timing: checkers sample it at other times."""
_AIMED = 0.92
"""The same fraction in descents, where a penalised limit is exceeded a little."""


@final
@dataclass(frozen=True, eq=False)
class SpecificForceCone:
    """Limits that keep the specific force at a point within an angle of an axis.

    | field   | meaning                                        | unit  | shape |
    |---------|------------------------------------------------|-------|-------|
    | name    | of the constraint                              |       |       |
    | link    | link to which the point is fixed               |       |       |
    | point   | in the link                                    | m     | 3     |
    | axis    | unit axis in the link                          |       | 3     |
    | angle   | largest angle, below pi / 2                    | rad   |       |
    | gravity |                                                | m/s^2 |       |
    | slosh   | first mode of a liquid there; None if none     |       |       |
    | brim    | angle between axis and surface normal at which |       |       |
    |         | contents spill; None if there are none         | rad   |       |
    | heave   | largest difference between the axial specific  |       |       |
    |         | force and gravity, as a fraction of gravity    |       |       |
    """

    name: str
    link: int
    point: Float[Array, " xyz"]
    axis: Float[Array, " xyz"]
    angle: float
    gravity: float
    slosh: Slosh | None
    brim: float | None
    heave: float = np.inf

    @cached_property
    def facets(self) -> Float[Array, "facet xyz"]:
        """Facet vectors v in the link, so that v f <= `room`: the pyramid's sides, then +axis and -axis."""
        first = np.cross(self.axis, np.eye(3)[np.argmin(np.abs(self.axis))])
        first /= np.linalg.norm(first)
        turn = 2.0 * np.pi * np.arange(FACETS) / FACETS
        around = np.outer(np.cos(turn), first) + np.outer(np.sin(turn), np.cross(self.axis, first))
        pyramid = around - np.tan(self.angle) * np.cos(np.pi / FACETS) * self.axis
        return np.vstack([pyramid, self.axis, -self.axis])

    @cached_property
    def room(self) -> Float[Array, " facet"]:
        """Bound of each facet [m/s^2]: 0 for the sides of the pyramid, a range along the axis."""
        upright = float(np.cos(self.angle))
        most = min(max(_HARDEST * upright, _MILDEST), 1.0 + self.heave)
        least = max(min(_LIGHTEST, _OF_REST * upright), upright - self.heave)
        return np.append(np.zeros(FACETS), [most * self.gravity, -least * self.gravity])

    @cached_property
    def native(self) -> _native.SpecificForceLimit:
        """The limit for descents of motions."""
        return self._limit(_AIMED if self.slosh is not None else None)

    @cached_property
    def timed(self) -> _native.SpecificForceLimit:
        """The limit for timing."""
        return self._limit(_BELOW)

    @cached_property
    def steady(self) -> _native.SpecificForceLimit:
        """The limit for timing a motion that does not begin at rest, where the swing of a surface is unknown."""
        return self._limit(None)

    def _limit(self, part: float | None) -> _native.SpecificForceLimit:
        """Return the limit for the core, with the surface limited to `part` of the brim tilt unless that is None."""
        facets = np.ascontiguousarray(self.facets)
        if part is None or self.brim is None:
            return _native.SpecificForceLimit(
                link=self.link, point=self.point, facets=facets, room=self.room, gravity=self.gravity
            )
        return _native.SpecificForceLimit(
            link=self.link,
            point=self.point,
            facets=facets,
            room=self.room,
            gravity=self.gravity,
            axis=self.axis,
            angle=part * self.brim,
            length=0.0 if self.slosh is None else self.slosh.length,
            drag=0.0 if self.slosh is None else self.slosh.drag,
        )


@final
@dataclass(frozen=True, eq=False)
class SpecificForceLoad:
    """Limits of the specific force f at a point along given directions: each facet times f is at most its `room`.

    | field   | meaning                            | unit  | shape     |
    |---------|------------------------------------|-------|-----------|
    | name    | of the constraint                  |       |           |
    | link    | link to which the point is fixed   |       |           |
    | point   | in the link                        | m     | 3         |
    | facets  | unit vectors in the link           |       | facet 3   |
    | room    | above 0                            | m/s^2 | facet     |
    | gravity |                                    | m/s^2 |           |
    """

    name: str
    link: int
    point: Float[Array, " xyz"]
    facets: Float[Array, "facet xyz"]
    room: Float[Array, " facet"]
    gravity: float

    @cached_property
    def native(self) -> _native.SpecificForceLimit | None:
        """The limit for descents of motions; None if no facet is likely to be active."""
        often = self.room < _SELDOM_FELT
        return self._limit(often) if often.any() else None

    @cached_property
    def timed(self) -> _native.SpecificForceLimit:
        """The limit for timing."""
        return self._limit(np.ones(len(self.room), dtype=bool))

    @property
    def steady(self) -> _native.SpecificForceLimit:
        """The limit for timing a motion that does not begin at rest: the same."""
        return self.timed

    def _limit(self, kept: Bool[Array, " facet"]) -> _native.SpecificForceLimit:
        facets, room = np.ascontiguousarray(self.facets[kept]), self.room[kept]
        return _native.SpecificForceLimit(
            link=self.link, point=self.point, facets=facets, room=room, gravity=self.gravity
        )


Felt = SpecificForceCone | SpecificForceLoad


class SpecificForceConstraint(Constraint):
    """Base class of constraints on the specific force of a carried object, at rest and in motion."""

    @abstractmethod
    def felt(self, scene: Scene) -> Felt:
        """Return the limits in motion."""

    def around(self, q: Float[Array, "n nq"], scene: Scene) -> SpecificForceConstraint:
        """Return a constraint relaxed, where it can be, to admit the given configurations."""
        return self

    @abstractmethod
    def resting(self, scene: Scene) -> tuple[AxisRule, ...]:
        """Return the axis rules that imply the constraint at rest, for the core to check in every configuration."""


@per_layout(most=_KEPT)
def felt_in(scene: Scene, constraint: SpecificForceConstraint) -> Felt:
    """Return the limits of a constraint in motion; cached per scene."""
    return constraint.felt(scene)


@per_layout(most=_KEPT)
def resting_in(scene: Scene, constraint: SpecificForceConstraint) -> tuple[AxisRule, ...]:
    """Return the axis rules of a constraint at rest; cached per scene."""
    return constraint.resting(scene)
