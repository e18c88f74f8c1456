r"""What is felt where something is carried, as limits on how fast a curve is travelled.

A point that moves by p' per unit of a curve's parameter s is accelerated by :math:`p'\ddot s + p''\dot s^2`: linear in
path acceleration and squared path speed, the form that TOPP-RA takes. What is felt there is that acceleration less
gravity. Facets around an axis hold it inside a pyramid that stands for a cone about the axis: what is level at rest
stays level for what is carried. Facets with room hold it below what a grasp can carry.

References:
    J. Ichnowski et al., "GOMP-FIT: Grasp-Optimized Motion Planning for Fast Inertial Transport", ICRA 2022.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np

from graceful_plan.array_types import Bool, Float
from graceful_plan.constraints.constraint import Constraint
from graceful_plan.constraints.slosh import Slosh
from graceful_plan.core import _native
from graceful_plan.scene.per_scene import per_layout
from graceful_plan.scene.rules.rules import AxisRule
from graceful_plan.scene.scene import Scene

Array = np.ndarray

FACETS = 8
"""Sides of the pyramid, inscribed in the cone: it takes at most 1 - cos(pi / 8), 8 %, of the tangent."""
_HARDEST = 1.7
"""Of gravity, what may be felt. A change of velocity of 0.7 m/s within 0.03 s, 2.4 times gravity, throws contents out
in FailBench, and what fingers hold swings: planned with up to 1.84, the glass of bedside/bring_water felt more."""
_MILDEST = 1.2
"""The same along the axis of a wide cone: at rest gravity has to be within it."""
_LIGHTEST, _OF_REST = 0.5, 0.7
"""Of gravity, what is felt along the axis at least; no more than a share of what the cone leaves at rest. Near free
fall the direction is up to any small error of the robot: one in four fast motions with a wine glass poured half of it.
"""
_SELDOM_FELT = 40.0
"""More than this is hardly felt where something is carried [m/s^2]: to hold such facets is left to timing, for descents
take time for each."""
_KEPT = 32
"""Constraints of a scene whose limits are kept; ends that are tilted further make new ones."""
_BELOW = 0.97
"""Of the tilt that brings the surface to the rim, what the sloshing surface may have: others sample it elsewhere."""
_AIMED = 0.92
"""The same in descents: what is charged ends a little beyond its limit."""


@final
@dataclass(frozen=True, eq=False)
class FeltCone:
    """What is felt at a point stays within an angle of an axis.

    | field   | meaning                                        | unit  | shape |
    |---------|------------------------------------------------|-------|-------|
    | name    | of the constraint that asks for it             |       |       |
    | link    | link that the point rides on                   |       |       |
    | point   | in the link                                    | m     | 3     |
    | axis    | unit axis in the link                          |       | 3     |
    | angle   | largest angle, below a right one               | rad   |       |
    | gravity |                                                | m/s^2 |       |
    | slosh   | of a liquid there; None if it is none          |       |       |
    | brim    | angle between axis and surface normal at which |       |       |
    |         | contents spill; None if there are none         | rad   |       |
    | heave   | share of gravity by which what is felt along   |       |       |
    |         | the axis may differ from it                    |       |       |
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
        """Vectors v in the link, around the pyramid and along its axis: v times what is felt is at most `room`."""
        first = np.cross(self.axis, np.eye(3)[np.argmin(np.abs(self.axis))])
        first /= np.linalg.norm(first)
        turn = 2.0 * np.pi * np.arange(FACETS) / FACETS
        around = np.outer(np.cos(turn), first) + np.outer(np.sin(turn), np.cross(self.axis, first))
        pyramid = around - np.tan(self.angle) * np.cos(np.pi / FACETS) * self.axis
        return np.vstack([pyramid, self.axis, -self.axis])

    @cached_property
    def room(self) -> Float[Array, " facet"]:
        """What v times what is felt may be at most [m/s^2]: nothing across the pyramid, a range along its axis."""
        upright = float(np.cos(self.angle))
        most = min(max(_HARDEST * upright, _MILDEST), 1.0 + self.heave)
        least = max(min(_LIGHTEST, _OF_REST * upright), upright - self.heave)
        return np.append(np.zeros(FACETS), [most * self.gravity, -least * self.gravity])

    @cached_property
    def native(self) -> _native.FeltLimit:
        """The same for descents of motions."""
        return self._limit(_AIMED if self.slosh is not None else None)

    @cached_property
    def timed(self) -> _native.FeltLimit:
        """The same for timing."""
        return self._limit(_BELOW)

    def _limit(self, part: float | None) -> _native.FeltLimit:
        """Return the limit for the core; the surface stays within some part of the brim's angle, if any is given."""
        facets = np.ascontiguousarray(self.facets)
        if part is None or self.brim is None:
            return _native.FeltLimit(
                link=self.link, point=self.point, facets=facets, room=self.room, gravity=self.gravity
            )
        return _native.FeltLimit(
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
class FeltLoad:
    """What is felt at a point stays small enough: facets times it at most `room`.

    | field   | meaning                            | unit  | shape     |
    |---------|------------------------------------|-------|-----------|
    | name    | of the constraint that asks for it |       |           |
    | link    | link that the point rides on       |       |           |
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
    def native(self) -> _native.FeltLimit | None:
        """The same for descents of motions; None where they have no reason to look."""
        often = self.room < _SELDOM_FELT
        return self._limit(often) if often.any() else None

    @cached_property
    def timed(self) -> _native.FeltLimit:
        """The same for timing."""
        return self._limit(np.ones(len(self.room), dtype=bool))

    def _limit(self, kept: Bool[Array, " facet"]) -> _native.FeltLimit:
        facets, room = np.ascontiguousarray(self.facets[kept]), self.room[kept]
        return _native.FeltLimit(link=self.link, point=self.point, facets=facets, room=room, gravity=self.gravity)


Felt = FeltCone | FeltLoad


class FeltConstraint(Constraint):
    """Base of constraints on what is felt where something is carried, at rest and in motion."""

    @abstractmethod
    def felt(self, scene: Scene) -> Felt:
        """Return what has to hold in motion."""

    def around(self, q: Float[Array, "n nq"], scene: Scene) -> FeltConstraint:
        """Return one with room for some configurations, as far as they are allowed."""
        return self

    @abstractmethod
    def resting(self, scene: Scene) -> tuple[AxisRule, ...]:
        """Return what has to hold in every configuration, at rest: all that the core has to check."""


@per_layout(most=_KEPT)
def felt_in(scene: Scene, constraint: FeltConstraint) -> Felt:
    """Return what has to hold in motion in a scene; computed once."""
    return constraint.felt(scene)


@per_layout(most=_KEPT)
def resting_in(scene: Scene, constraint: FeltConstraint) -> tuple[AxisRule, ...]:
    """Return what has to hold in every configuration of a scene; computed once."""
    return constraint.resting(scene)
