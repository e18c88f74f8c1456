r"""Constraint on the torques of the joints, for a healthy robot with its carried object.

Along a curve q(s), the torques are

.. math:: \tau = (M q')\, \ddot s + (M q'' + C(q, q'))\, \dot s^2 + G

with the mass matrix M, the torques C of velocity products, and the torques G that hold the robot still. They are linear
in path acceleration and squared path speed, the form that timing takes. Viscous damping is proportional to the path
speed v instead; with the largest path speed m, the bound :math:`v \le v^2 / (2 m) + m / 2` takes its place.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.constraints.constraint import Constraint
from graceful_plan.core.kernels import LEVER
from graceful_plan.costs.cost import StateBatch
from graceful_plan.costs.models.body.body import native_model
from graceful_plan.costs.models.body.constants import BodySettings
from graceful_plan.exceptions import RetimingError, UnsupportedError
from graceful_plan.path import plain_numbers
from graceful_plan.scene.rules.rules import TorqueRule
from graceful_plan.scene.scene import Scene
from graceful_plan.setting_checks import positive_fraction
from graceful_plan.timing.blend import CurveGrid
from graceful_plan.timing.dynamics import RobotDynamics

_AT_REST = 0.95
"""Fraction of the allowed torque that may hold the robot at rest; the rest is left for accelerations."""
_RESERVE = 0.98
"""Fraction of the allowed torque that timing uses: torques may be slightly greater between grid points."""


@final
@dataclass(frozen=True)
class TorqueWithin(Constraint):
    """Keep the torques of the joints within the limits of the scene, with the weight and inertia of the carried object.

    Searches avoid postures that the robot cannot hold, and timing slows down where acceleration needs too much torque.
    Joints without a torque limit are free.

    Args:
        share: Fraction of the limits to keep to, above 0 and at most 1.
    """

    share: float = 1.0
    lever: ClassVar[float] = LEVER

    def __post_init__(self) -> None:
        plain_numbers(self)
        positive_fraction("share", self.share)

    def rule(self, scene: Scene) -> TorqueRule:
        """Return the rule for a scene; raise if the scene limits no torque."""
        if not np.isfinite(scene.limits.torque).any():
            raise UnsupportedError(f"{self.name}: the model limits the torque of no joint")
        return TorqueRule(name=self.name, share=self.share)

    def residual(self, batch: StateBatch) -> Float[Array, " n"]:
        """Return the largest torque at rest relative to its limit, minus the fraction that is allowed at rest."""
        model = native_model(batch.scene, BodySettings.shipped())
        _, hold = model.dynamics(np.ascontiguousarray(batch.q, dtype=np.float64))
        return (np.abs(hold) / batch.scene.limits.torque).max(axis=1) - _AT_REST * self.share

    def told(self, residual: float) -> str:
        """Describe a violation for messages."""
        allowed = _AT_REST * self.share
        return f"{self.name}: a joint needs {residual + allowed:.2f} of its torque at rest, {allowed:.2f} is allowed"


def torque_limits(rule: TorqueRule, scene: Scene, grid: CurveGrid) -> Float[Array, "interval limit 3"]:
    """Return limits a u + b x <= c at both ends of each interval, two for each joint with a torque limit.

    Raises:
        RetimingError: If a joint needs all its torque to hold the robot still somewhere along the curve.
    """
    limit = rule.share * _RESERVE * scene.limits.torque
    limited = np.flatnonzero(np.isfinite(limit))
    inverse, still, steps = RobotDynamics(scene), np.zeros(len(limit)), np.diff(grid.s)
    model = scene.model
    damping = model.dof_damping[[model.jnt_dofadr[model.joint(name).id] for name in scene.joints]]
    rows = []
    for end in (0, 1):
        q = grid.q[end : len(grid.q) - 1 + end]
        slopes = grid.slope[:, end]
        states = list(zip(q, slopes, grid.bend[:, end], strict=True))
        hold = np.array([inverse(x, still, still) for x, _, _ in states])
        a = np.array([inverse(x, still, slope) for x, slope, _ in states]) - hold
        b = np.array([inverse(x, slope, bend) for x, slope, bend in states]) - hold - damping * slopes
        fastest = 1.0 / np.maximum((np.abs(slopes) / scene.limits.velocity).max(axis=1, keepdims=True), 1e-12)
        drag = 0.5 * damping * np.abs(slopes)
        b_drag, room_drag = drag / fastest, drag * fastest
        for sign in (1.0, -1.0):
            room = (limit - sign * hold - room_drag)[:, limited]
            if not (room > 0.0).all():
                joint = limited[int(np.argmin(room.min(axis=0)))]
                raise RetimingError(f"{rule.name}: joint {scene.joints[joint]!r} cannot move all along the path")
            speed = (sign * b + b_drag)[:, limited]
            # At the end of an interval the squared speed is x + 2 step u.
            push = sign * a[:, limited] + (2.0 * steps[:, None] * speed if end else 0.0)
            rows.append(np.stack([push, speed, room], axis=-1))
    return np.concatenate(rows, axis=1)
