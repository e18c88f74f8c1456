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
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.constraints.constraint import Constraint
from graceful_plan.constraints.slosh import Slosh
from graceful_plan.core import _native
from graceful_plan.core.arrays import RobotArrays
from graceful_plan.core.kernels import Kernels
from graceful_plan.exceptions import RetimingError
from graceful_plan.scene.per_scene import per_layout
from graceful_plan.scene.rules.rules import AxisRule
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.blend import CurveGrid

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
_LEAST_ROOM = 1e-3
"""Share of gravity by which a facet has to hold at rest."""


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
    | brim    | largest angle between axis and surface normal  | rad   |       |
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
    brim: float
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
        facets = np.ascontiguousarray(self.facets)
        if self.slosh is None:
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
            angle=self.brim,
            length=self.slosh.length,
            drag=self.slosh.drag,
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
        if not often.any():
            return None
        facets, room = np.ascontiguousarray(self.facets[often]), self.room[often]
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


def felt_limits(cones: Sequence[Felt], kernels: Kernels, grid: CurveGrid) -> Float[Array, "interval limit 3"]:
    """Return limits a u + b x <= c on path acceleration u and squared path speed x, at both ends of each interval.

    Raises:
        RetimingError: If the curve passes where a cone does not even hold at rest.
    """
    steps = np.diff(grid.s)[:, None]
    rows = [np.zeros((len(grid.s) - 1, 0, 3))]
    for cone in cones:
        for end in (0, 1):
            q = grid.q[end : len(grid.q) - 1 + end]
            X_WL = kernels.link_poses(q)
            slope, bend = curve_of_point(
                kernels.robot, X_WL, (cone.link, cone.point), (grid.slope[:, end], grid.bend[:, end])
            )
            v = np.einsum("nij,fj->nfi", X_WL[:, cone.link, :3, :3], cone.facets)
            a, b = np.einsum("nfi,ni->nf", v, slope), np.einsum("nfi,ni->nf", v, bend)
            c = cone.room - cone.gravity * v[..., 2]
            if np.any(c < _LEAST_ROOM * cone.gravity):
                at = grid.s[int(np.argmin(c.min(axis=1))) + end] / grid.s[-1]
                raise RetimingError(f"{cone.name} does not hold at rest after {at:.0%} of the path")
            # At the end of an interval the squared speed is x + 2 step u.
            rows.append(np.stack([a + (2.0 * steps * b if end else 0.0), b, c], axis=-1))
    return np.ascontiguousarray(np.concatenate(rows, axis=1))


def curve_of_point(
    robot: RobotArrays,
    X_WL: Float[Array, "n link 4 4"],
    rider: tuple[int, Float[Array, " xyz"]],
    derivatives: tuple[Float[Array, "n nq"], Float[Array, "n nq"]],
) -> tuple[Float[Array, "n xyz"], Float[Array, "n xyz"]]:
    """Return the first and second derivative of a point's position along a curve in joint space.

    Args:
        robot: Whose links.
        X_WL: Poses of all links.
        rider: The link that the point rides on, and where it is in it [m].
        derivatives: dq/ds and d2q/ds2.
    """
    link, point = rider
    slope, bend = derivatives
    at = X_WL[:, link, :3, 3] + X_WL[:, link, :3, :3] @ point
    chain, k = [], link
    while k >= 0:
        if robot.joint[k] >= 0:
            chain.append(k)
        k = int(robot.parent[k])
    first, second, omega = np.zeros_like(at), np.zeros_like(at), np.zeros_like(at)
    for k in reversed(chain):  # from the base on
        j, z = int(robot.joint[k]), X_WL[:, k, :3, 2]
        s, b = slope[:, j : j + 1], bend[:, j : j + 1]
        turned = omega if robot.slide[k] else omega + s * z
        J = z if robot.slide[k] else _cross(z, at - X_WL[:, k, :3, 3])
        first += s * J
        # dJ/ds: joints before it turn it, and it turns itself.
        second += b * J + s * _cross(omega + turned, J)
        omega = turned
    return first, second


def _cross(a: Float[Array, "n xyz"], b: Float[Array, "n xyz"]) -> Float[Array, "n xyz"]:
    """Return cross products; `np.cross` takes four times as long for a few hundred."""
    return a[:, [1, 2, 0]] * b[:, [2, 0, 1]] - a[:, [2, 0, 1]] * b[:, [1, 2, 0]]
