r"""What is held stays in the grasp: friction and pressure of two pads carry its weight and its inertia.

What is carried has mass m and feels f, its acceleration less gravity, at its centre of mass r from the grasp. The pads
carry the force m f and the moment r x m f; what the object's own turning needs is left out. On each pad the tangential
force t and the torque T about the closing axis stay inside the ellipsoid of a soft finger,

.. math:: (t / \mu)^2 + (T / \mu_T)^2 \le N^2

with N half of what both fingers press with, more or less by half of the load along the closing axis. The moments about
the two other axes are carried by friction to opposite sides on both pads, or by pressure that shifts to the rim of what
they touch: by what carries more. All of that is linear in f but the ellipsoid; flat facets inside of it stand for it.

References:
    R. Howe and M. Cutkosky, "Practical Force-Motion Models for Sliding Manipulation", IJRR 1996: the ellipsoid.
    J. Ichnowski et al., "GOMP-FIT: Grasp-Optimized Motion Planning for Fast Inertial Transport", ICRA 2022.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import ClassVar, final

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.constraints.bounds import frame_in_link
from graceful_plan.constraints.felt import FeltConstraint, FeltLoad
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import LEVER
from graceful_plan.costs.cost import StateBatch
from graceful_plan.exceptions import SettingError
from graceful_plan.path import is_real
from graceful_plan.scene.per_scene import per_layout
from graceful_plan.scene.rules.grip import Grip, find_grip
from graceful_plan.scene.rules.rules import AxisRule, GripRule
from graceful_plan.scene.scene import Scene

Array = np.ndarray

_AT_REST = 0.95
"""Of what the pads may carry, what they may at rest: there has to be room for a motion."""
_ROOM = 0.01
"""Of what the pads can carry, what a motion may use beyond what an end needs."""
_FLAT = 1e-9
"""Singular values of the load below this share of the greatest are none."""
_KEPT = 8
"""Grips of a scene whose facets are kept."""
_SIDES = 12
"""Of the polygon that stands for an ellipse: it takes at most 1 - cos(pi / 12), 3 %."""


@final
@dataclass(frozen=True)
class GraspHolds(FeltConstraint):
    """A healthy robot does not lose what it holds: friction of both pads carries weight and inertia.

    Args:
        friction: Coefficient between pads and object; the model's by default. Torsion grows with it.
        force: What both fingers press with together [N]; by default what the model's drives can.
        share: Part of what the pads can carry that the motion may use, above 0 and at most 1. Where start or goal need
            more, they get more.
    """

    friction: float | None = None
    force: float | None = None
    share: float = 0.9
    lever: ClassVar[float] = LEVER

    def __post_init__(self) -> None:
        for name, value in (("friction", self.friction), ("force", self.force)):
            if value is not None and not (is_real(value) and 0.0 < value < np.inf):
                raise SettingError(name, value, "a finite number above 0")
        if not (is_real(self.share) and 0.0 < self.share <= 1.0):
            raise SettingError("share", self.share, "above 0 and at most 1")

    def rule(self, scene: Scene) -> GripRule:
        """Return what has to hold in a scene; raise if nothing is held between two pads there."""
        return GripRule(name=self.name, grip=self.grip(scene), share=1.0)

    def around(self, q: Float[Array, "n nq"], scene: Scene) -> GraspHolds:
        """Return one with room for some configurations, as far as pads hold at all there."""
        needed = float(self._resting_load(StateBatch(scene, q)).max()) / _AT_REST + _ROOM
        return self if needed <= self.share else replace(self, share=min(needed, 1.0))

    def grip(self, scene: Scene) -> Grip:
        """Return how the object is held.

        Raises:
            UnsupportedError: If it is not held between two pads.
            SettingError: If the model does not say how much the fingers press.
        """
        grip = find_grip(scene)
        if self.force is None and np.isnan(grip.force):
            raise SettingError("force", None, "what both fingers press with [N]: the model does not say")
        friction = grip.friction if self.friction is None else self.friction
        force = grip.force if self.force is None else self.force
        return replace(grip, friction=friction, torsion=grip.torsion * friction / grip.friction, force=force)

    def felt(self, scene: Scene) -> FeltLoad:
        """Return what has to hold for what is felt at the centre of mass of what is carried."""
        robot = compile_scene(scene).robot
        X_LO = frame_in_link(scene, robot, "object")
        grip = self.grip(scene)
        facets, room = _facets(scene, self.friction, self.force)
        return FeltLoad(
            name=self.name,
            link=robot.tool_link,
            point=X_LO[:3, :3] @ grip.p_BC + X_LO[:3, 3],
            facets=facets @ X_LO[:3, :3].T,
            room=self.share * room,
            gravity=-float(scene.model.opt.gravity[2]),
        )

    def resting(self, scene: Scene) -> tuple[AxisRule, ...]:
        """Return what has to hold in every configuration: each facet holds the vertical inside of a cone."""
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
        """Return by how much the load at rest exceeds what the pads may carry, as a share of what they can."""
        return self._resting_load(batch) - _AT_REST

    def _resting_load(self, batch: StateBatch) -> Float[Array, " n"]:
        """Return the load as a share of what the pads can carry."""
        gravity = -float(batch.scene.model.opt.gravity[2])
        facets, room = _facets(batch.scene, self.friction, self.force)
        load = np.einsum("fi,ni->nf", facets, batch.object_poses[:, 2, :3]) * gravity / room
        return load.max(axis=1)

    def told(self, residual: float) -> str:
        """Say in words how far outside a state is."""
        load = residual + _AT_REST
        return f"{self.name}: at rest the load is {load:.2f} of what the fingers hold, {_AT_REST:.2f} is allowed"


@per_layout(most=_KEPT)
def _facets(
    scene: Scene, friction: float | None, force: float | None
) -> tuple[Float[Array, "facet xyz"], Float[Array, " facet"]]:
    """Return `load_facets` of how an object is held; computed once."""
    return load_facets(GraspHolds(friction, force).grip(scene))


def load_facets(grip: Grip) -> tuple[Float[Array, "facet xyz"], Float[Array, " facet"]]:
    """Return unit vectors in the frame of the carried body, and how much may be felt along each [m/s^2]."""
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
    stacked = np.concatenate(rows)
    length = np.linalg.norm(stacked, axis=1)
    some = length > _FLAT * length.max()
    return stacked[some] / length[some, None], 1.0 / length[some]


def _ball_facets(A: Float[Array, "row xyz"]) -> Float[Array, "facet xyz"]:
    """Return vectors w such that w f is at most 1 for all of them only where A f is inside the unit ball."""
    _, size, axes = np.linalg.svd(A)
    size, axes = size[size > _FLAT * size[0]], axes[: int((size > _FLAT * size[0]).sum())]
    if len(size) == 3:
        around = np.array([d for d in product((-1.0, 0.0, 1.0), repeat=3) if any(d)])
        around /= np.linalg.norm(around, axis=1, keepdims=True)
        # Where an edge, a face diagonal and a space diagonal of the cube are equally far.
        inscribed = (1.0 + (2.0**0.5 - 1.0) ** 2 + (3.0**0.5 - 2.0**0.5) ** 2) ** -0.5
    elif len(size) == 2:
        turn = 2.0 * np.pi * np.arange(_SIDES) / _SIDES
        around, inscribed = np.stack([np.cos(turn), np.sin(turn)], axis=1), float(np.cos(np.pi / _SIDES))
    else:
        around, inscribed = np.array([[1.0], [-1.0]]), 1.0
    return around * size @ axes / inscribed
