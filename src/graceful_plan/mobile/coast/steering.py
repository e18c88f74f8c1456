r"""A path-tracking controller that is unaware that one side of its base has failed.

It is a vectorised form of `Tracking` in `graceful_plan.mobile.control`. The speed is :math:`v \cos e_h + k_x e_x` and
the turning rate :math:`\omega + v k_y e_y + (|v| k_h + k_x) \sin e_h`. The correction is limited to :math:`\sqrt{2
\alpha |e|}`, and the turning-rate error measured by gyros is fed back (Kanayama et al., ICRA 1990). One side does not
follow its commands, so the base swings about the reference. The reference keeps its turning rate and accelerates to the
greatest speed of the base, because planned motions pass slow places only briefly.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.scene.mobile.diff_drive import DiffDrive

TICK = 0.02
"""Time between commands [s]."""
MOTORS = 2.5
"""Ratio of the motors' rim acceleration to the acceleration limit of motions; 2.5 for a Jackal, 3.3 for a Fetch."""
_ALONG, _ACROSS, _HEADING = 6.0, 20.0, 6.0
_SPARE = 3.0
"""Angular acceleration available to recover from a turn [rad/s^2]."""
_RATE, _SUM, _WINDS = 1.0, 5.0, 0.15
BEHIND = 3.0
"""Largest difference between commanded and measured wheel rates; commands are clamped to it [rad/s]."""
FASTER = 1.3
"""Ratio of the greatest commanded rim speed to the limit of motions; a reserve for tracking corrections."""


def reference_motion(base: DiffDrive, v: Float[Array, "*batch"], time: float) -> tuple[Array, Array]:
    """Return the distance a reference has covered [m] and its speed [m/s], a time after it had a given speed.

    Args:
        base: Parameters of the base.
        v: Initial speed along the heading, negative backwards [m/s].
        time: Time since then [s].
    """
    speed = np.abs(v)
    faster = np.minimum(time, np.maximum(base.v_max - speed, 0.0) / base.a_max)
    far = speed * time + base.a_max * faster * (time - 0.5 * faster)
    return np.sign(v) * far, np.sign(v) * (speed + base.a_max * faster)


@dataclass(eq=False)
class OneSideSteering:
    """Controllers of a batch of bases.

    Args:
        base: Parameters of the bases.
        v: Speed along the heading when one side fails [m/s].
        omega: Turning rate at that time [rad/s].
    """

    base: DiffDrive
    v: Float[Array, "*batch"]
    omega: Float[Array, "*batch"]
    _told: tuple[Array, Array] = field(init=False)
    """Commanded speeds of the left and right rims [m/s]."""
    _summed: Array = field(init=False)

    def __post_init__(self) -> None:
        turning = self.base.lever * self.omega
        self._told = self.v - turning, self.v + turning
        self._summed = np.zeros_like(self.v)

    def tell(
        self, time: float, pose: tuple[Array, Array, Array], rate: Array, rims: tuple[Array, Array]
    ) -> tuple[Array, Array]:
        """Return the commanded speeds of the left and right rims [m/s].

        Args:
            time: Time after the failure [s].
            pose: x, y and angle turned, in the frame of the base at the failure.
            rate: Measured turning rate [rad/s].
            rims: Actual speeds of the left and right rims [m/s].
        """
        v, turn = self._wanted(time, pose)
        self._summed = np.clip(self._summed + TICK * (turn - rate), -_WINDS, _WINDS)
        turn = turn + _RATE * (turn - rate) + _SUM * self._summed
        reach, lever = MOTORS * self.base.a_max * TICK, self.base.lever
        near = BEHIND * self.base.radius
        left, right = (np.clip(told, rim - near, rim + near) for told, rim in zip(self._told, rims, strict=True))
        before, turned = 0.5 * (left + right), 0.5 * (right - left)
        faster = np.clip(v - before, -0.5 * reach, 0.5 * reach)
        room = reach - np.abs(faster)
        turned = turned + np.clip(lever * turn - turned, -room, room)
        most, v = FASTER * self.base.rim_max, before + faster
        self._told = np.clip(v - turned, -most, most), np.clip(v + turned, -most, most)
        return self._told

    def _wanted(self, time: float, pose: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        """Return the speed and turning rate that lead back to the reference."""
        (x, y, turned), omega = pose, self.omega
        far, v = reference_motion(self.base, self.v, time)
        way = omega * time
        chord = far * np.sinc(0.5 * way / np.pi)
        dx, dy = chord * np.cos(0.5 * way) - x, chord * np.sin(0.5 * way) - y
        c, s = np.cos(turned), np.sin(turned)
        along, across = c * dx + s * dy, c * dy - s * dx
        off = np.mod(way - turned + np.pi, 2.0 * np.pi) - np.pi
        stiff = np.abs(v) * _HEADING + _ALONG
        most = np.sqrt(2.0 * _SPARE * (np.abs(off) + np.abs(v) * _ACROSS * np.abs(across) / stiff))
        back = np.clip(v * _ACROSS * across + stiff * np.sin(off), -most, most)
        return v * np.cos(off) + _ALONG * along, omega + back
