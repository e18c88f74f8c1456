r"""Constraint that a held object stays in the grasp: two pads carry its weight and inertia by friction and pressure.

The carried object has mass m and specific force f (acceleration minus gravity) at its centre of mass, at r from the
grasp. The pads carry the force m f and the moment r x m f; the object's own rotational inertia is neglected. On each
pad, the tangential force t and the torque T about the closing axis stay inside the ellipsoid of a soft finger,

.. math:: (t / \mu)^2 + (T / \mu_T)^2 \le N^2

where N is half the total grip force, plus or minus half the load along the closing axis. Moments about the two other
axes are carried either by friction in opposite directions on the two pads, or by pressure that shifts to the rim of
the contact area, whichever carries more. Everything but the ellipsoid is linear in f; flat facets inscribed in the
ellipsoid approximate it.

References:
    R. Howe and M. Cutkosky, "Practical Force-Motion Models for Sliding Manipulation", IJRR 1996: the ellipsoid.
    J. Ichnowski et al., "GOMP-FIT: Grasp-Optimized Motion Planning for Fast Inertial Transport", ICRA 2022.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import ClassVar, final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.constraints.bounds import frame_in_link
from graceful_plan.constraints.specific_force import SpecificForceConstraint, SpecificForceLoad
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import LEVER
from graceful_plan.costs.cost import StateBatch
from graceful_plan.exceptions import SettingError
from graceful_plan.path import plain_numbers
from graceful_plan.scene.per_scene import per_layout
from graceful_plan.scene.rules.grip import AdhesiveGrip, Grip, find_hold
from graceful_plan.scene.rules.rules import AxisRule, GripRule
from graceful_plan.scene.scene import Scene
from graceful_plan.setting_checks import positive_fraction, positive_or_none

_AT_REST = 0.95
"""Fraction of the pads' capacity that the load may use at rest; the rest is left for accelerations."""
_ROOM = 0.01
"""Capacity that a motion may use beyond the need of its start or goal, as a fraction of the pads' capacity."""
_FLAT = 1e-9
"""Singular values of the load below this fraction of the largest count as 0."""
_KEPT = 8
"""Grips per scene whose facets are cached."""
_SIDES = 12
"""Sides of the polygon inscribed in an ellipse: at worst it reduces the radius by 1 - cos(pi / 12), 3 %."""


@final
@dataclass(frozen=True)
class GraspHolds(SpecificForceConstraint):
    """Keep the load on a grasp within its capacity, for a healthy robot.

    Two pads carry it by friction and pressure, whatever the joints of the fingers; an `Adhesion` carries it up to its
    breaking force.

    Args:
        friction: Coefficient between pads and object; by default that of the model. Torsional friction scales with it.
        force: Total force with which both fingers press [N]; by default the limit of the model's drives.
        share: Fraction of the pads' capacity that the motion may use, above 0 and at most 1. It is raised where start
            or goal need more.
    """

    friction: float | None = None
    force: float | None = None
    share: float = 0.9
    lever: ClassVar[float] = LEVER

    def __post_init__(self) -> None:
        plain_numbers(self)
        for name, value in (("friction", self.friction), ("force", self.force)):
            positive_or_none(name, value)
        positive_fraction("share", self.share)

    def rule(self, scene: Scene) -> GripRule:
        """Return the rule for a scene; raise if nothing is held between two pads."""
        return GripRule(name=self.name, grip=self.grip(scene), share=1.0)

    def around(self, q: Float[Array, "n nq"], scene: Scene) -> GraspHolds:
        """Return a constraint whose share also admits the given configurations, up to a share of 1."""
        needed = float(self._resting_load(StateBatch(scene, q)).max()) / _AT_REST + _ROOM
        return self if needed <= self.share else replace(self, share=min(needed, 1.0))

    def grip(self, scene: Scene) -> Grip | AdhesiveGrip:
        """Return the geometry and capacity of the grasp.

        Raises:
            UnsupportedError: If the object is not held between two pads.
            SettingError: If the model does not define the grip force.
        """
        grip = find_hold(scene)
        if self.force is None and np.isnan(grip.force):
            raise SettingError("force", None, "what both fingers press with [N]: the model does not say")
        friction = grip.friction if self.friction is None else self.friction
        force = grip.force if self.force is None else self.force
        return replace(grip, friction=friction, torsion=grip.torsion * friction / grip.friction, force=force)

    def felt(self, scene: Scene) -> SpecificForceLoad:
        """Return the limits of the specific force at the carried object's centre of mass."""
        robot = compile_scene(scene).robot
        X_LO = frame_in_link(scene, robot, "object")
        grip = self.grip(scene)
        facets, room = _facets(scene, self.friction, self.force)
        return SpecificForceLoad(
            name=self.name,
            link=robot.tool_link,
            point=X_LO[:3, :3] @ grip.p_BC + X_LO[:3, 3],
            facets=facets @ X_LO[:3, :3].T,
            room=self.share * room,
            gravity=-float(scene.model.opt.gravity[2]),
        )

    def resting(self, scene: Scene) -> tuple[AxisRule, ...]:
        """Return the limits at rest: each facet keeps the vertical outside of a cone around its direction."""
        gravity = -float(scene.model.opt.gravity[2])
        facets, room = _facets(scene, self.friction, self.force)
        cosine = _AT_REST * self.share * room / gravity
        return tuple(
            AxisRule(
                name=self.name,
                frame="object",
                axis=(-x, -y, -z),
                direction=(0.0, 0.0, 1.0),
                angle=float(np.arccos(-limit)),
            )
            for (x, y, z), limit in zip(facets.tolist(), cosine.tolist(), strict=True)
            if limit < 1.0
        )

    def residual(self, batch: StateBatch) -> Float[Array, " n"]:
        """Return the load at rest minus its limit, as a fraction of the pads' capacity."""
        return self._resting_load(batch) - _AT_REST

    def _resting_load(self, batch: StateBatch) -> Float[Array, " n"]:
        """Return the load at rest as a fraction of the pads' capacity."""
        gravity = -float(batch.scene.shapes.opt.gravity[2])
        facets, room = _facets(batch.scene, self.friction, self.force)
        load = np.einsum("fi,ni->nf", facets, batch.object_poses[:, 2, :3]) * gravity / room
        return load.max(axis=1)

    def told(self, residual: float) -> str:
        """Describe a violation for messages."""
        load = residual + _AT_REST
        return f"{self.name}: at rest the load is {load:.2f} of what the grip holds, {_AT_REST:.2f} is allowed"


@per_layout(most=_KEPT)
def _facets(
    scene: Scene, friction: float | None, force: float | None
) -> tuple[Float[Array, "facet xyz"], Float[Array, " facet"]]:
    """Return `load_facets` of a scene's grasp; cached."""
    return load_facets(GraspHolds(friction, force).grip(scene))


def load_facets(grip: Grip | AdhesiveGrip) -> tuple[Float[Array, "facet xyz"], Float[Array, " facet"]]:
    """Return facets as unit vectors in the frame of the carried body, and the specific force each allows [m/s^2]."""
    stacked = np.concatenate(_pad_rows(grip) if isinstance(grip, Grip) else _disc_rows(grip))
    length = np.linalg.norm(stacked, axis=1)
    some = length > _FLAT * length.max()
    return stacked[some] / length[some, None], 1.0 / length[some]


def _disc_rows(grip: AdhesiveGrip) -> list[Float[Array, "row xyz"]]:
    """Return vectors w for which w f <= 1 keeps the object on a disc: it neither comes off, nor peels, nor slips."""
    moments, pull = grip.moments / grip.force, grip.mass * grip.axes / grip.force
    slips = np.stack([pull[1] / grip.friction, pull[2] / grip.friction, moments[0] / grip.torsion])
    rows = [pull[:1], _ball_facets(slips) + pull[0]]
    peels = moments[1:] / grip.radius
    return [*rows, _ball_facets(peels) + pull[0]] if peels.any() else rows


def _pad_rows(grip: Grip) -> list[Float[Array, "row xyz"]]:
    """Return vectors w for which w f <= 1 keeps the object between two pads."""
    moments, m, force = grip.moments, grip.mass, grip.force
    closing, h = m * grip.axes[0] / force, grip.half[0]
    rows = []
    for side in (1.0, -1.0):  # both pads
        pushed = side * np.array([0.0 if pressed else 1.0 for pressed in grip.pressed]) / h
        carried = [
            (m * grip.axes[1] + pushed[1] * moments[2]) / (grip.friction * force),
            (m * grip.axes[2] - pushed[0] * moments[1]) / (grip.friction * force),
        ]
        if grip.torsion > 0.0:
            carried.append(moments[0] / (grip.torsion * force))
        rows.append(_ball_facets(np.stack(carried)) - side * closing)
    for axis, rim in ((1, grip.half[2]), (2, grip.half[1])):
        if grip.pressed[axis - 1]:
            row = moments[axis] / (force * rim)
            rows.append(np.stack([row, -row]))
    rows.append(np.stack([closing, -closing]))
    return rows


def _ball_facets(A: Float[Array, "row xyz"]) -> Float[Array, "facet xyz"]:
    """Return vectors w for which w f <= 1 implies that A f is inside the unit ball."""
    _, size, axes = np.linalg.svd(A)
    size, axes = size[size > _FLAT * size[0]], axes[: int((size > _FLAT * size[0]).sum())]
    if len(size) == 3:
        around = np.array([d for d in product((-1.0, 0.0, 1.0), repeat=3) if any(d)])
        around /= np.linalg.norm(around, axis=1, keepdims=True)
        # At this scale, edge, face diagonal and space diagonal of the cube are equally far from the nearest vertex.
        inscribed = (1.0 + (2.0**0.5 - 1.0) ** 2 + (3.0**0.5 - 2.0**0.5) ** 2) ** -0.5
    elif len(size) == 2:
        turn = 2.0 * np.pi * np.arange(_SIDES) / _SIDES
        around, inscribed = np.stack([np.cos(turn), np.sin(turn)], axis=1), float(np.cos(np.pi / _SIDES))
    else:
        around, inscribed = np.array([[1.0], [-1.0]]), 1.0
    return around * size @ axes / inscribed
