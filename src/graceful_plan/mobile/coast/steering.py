r"""What a controller tells the wheels of a base of which it does not know that one side fails.

It leads the base back to its way, as `graceful_plan.mobile.control`'s `Tracking` does, in fewer words: the speed is
:math:`v \cos e_h + k_x e_x`, the rate of turning :math:`\omega + v k_y e_y + (|v| k_h + k_x) \sin e_h`, what is
corrected at most :math:`\sqrt{2 \alpha |e|}`, and what gyros miss of it is added (Kanayama et al., ICRA 1990). One side
does not do what it is told, so that the base swings about its way. The way goes on with the rate of turning that it
has, and gets as fast as the base may be: who is slow at a place is fast again soon after it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.scene.mobile.diff_drive import DiffDrive

Array = np.ndarray

TICK = 0.02
"""Time between two commands [s]."""
MOTORS = 2.5
"""How hard motors speed up rims, over the acceleration that motions have: 2.5 of a Jackal, 3.3 of a Fetch."""
_ALONG, _ACROSS, _HEADING = 6.0, 20.0, 6.0
_SPARE = 3.0
"""Angular acceleration to bring it back from a turn [rad/s^2]."""
_RATE, _SUM, _WINDS = 1.0, 5.0, 0.15
BEHIND = 3.0
"""How far from what was told the rates of wheels may be before they count instead [rad/s]."""
FASTER = 1.3
"""Greatest speed of rims that is told, over that of motions: room for what tracking adds to the fastest."""


def gone_on(base: DiffDrive, v: Float[Array, "*batch"], time: float) -> tuple[Array, Array]:
    """Return how far a motion has gone on a time after it had a speed [m], and the speed that it has then [m/s].

    Args:
        base: How it drives.
        v: Along the heading, backwards below 0 [m/s].
        time: Afterwards [s].
    """
    speed = np.abs(v)
    faster = np.minimum(time, np.maximum(base.v_max - speed, 0.0) / base.a_max)
    far = speed * time + base.a_max * faster * (time - 0.5 * faster)
    return np.sign(v) * far, np.sign(v) * (speed + base.a_max * faster)


@dataclass(eq=False)
class OneSideSteering:
    """Controllers of a batch of bases.

    Args:
        base: How they drive.
        v: Speed along the heading when one side fails [m/s].
        omega: Rate of turning then [rad/s].
    """

    base: DiffDrive
    v: Float[Array, "*batch"]
    omega: Float[Array, "*batch"]
    _told: tuple[Array, Array] = field(init=False)
    """Speeds of the left and the right rim [m/s]."""
    _summed: Array = field(init=False)

    def __post_init__(self) -> None:
        turning = self.base.lever * self.omega
        self._told = self.v - turning, self.v + turning
        self._summed = np.zeros_like(self.v)

    def tell(
        self, time: float, pose: tuple[Array, Array, Array], rate: Array, rims: tuple[Array, Array]
    ) -> tuple[Array, Array]:
        """Return the speeds of the left and the right rim that it wants [m/s].

        Args:
            time: After the failure [s].
            pose: x, y and angle turned of the base, in its frame then.
            rate: Of turning [rad/s].
            rims: Speeds that the left and the right rim have [m/s].
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
        """Return the speed and the rate of turning that lead back to the way."""
        (x, y, turned), omega = pose, self.omega
        far, v = gone_on(self.base, self.v, time)
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
