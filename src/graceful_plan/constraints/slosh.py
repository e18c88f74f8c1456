r"""Sloshing: how the surface of a liquid lags behind what is felt.

The first antisymmetric mode of a liquid in an upright cylinder moves like a pendulum. For small angles the slope
:math:`\sigma` of its surface, horizontal and complex here, follows what is felt by

.. math:: \ddot\sigma + 2 \zeta \omega \dot\sigma + \omega^2 \sigma = \omega^2 \sigma_f, \qquad
    \omega^2 = \frac{1.841 g}{R} \tanh \frac{1.841 h}{R}

with the slope :math:`\sigma_f` of a surface that is level for what is felt.

References:
    H. Abramson (ed.), "The Dynamic Behavior of Liquids in Moving Containers", NASA SP-106, 1966: frequencies, and the
    damping where the liquid is deep, a logarithmic decrement of 4.98 nu^(1/2) R^(-3/4) g^(-1/4).
"""

from __future__ import annotations

import cmath
from dataclasses import dataclass
from typing import final

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.constraints.vessel import Vessel

Array = np.ndarray

_ROOT = 1.841
"""First zero of the derivative of the Bessel function J_1."""
_VISCOSITY = 1e-6
"""Of water [m^2/s]: of what is carried, least damped."""


@final
@dataclass(frozen=True)
class Slosh:
    """The first mode of a liquid in a vessel: its frequency [rad/s] and its damping ratio."""

    frequency: float
    damping: float

    @classmethod
    def of(cls, vessel: Vessel, gravity: float) -> Slosh:
        """Return that of a vessel's contents, round about its axis."""
        R = vessel.radius
        depth = vessel.volume / (np.pi * R**2)
        squared = _ROOT * gravity / R * np.tanh(_ROOT * depth / R)
        damping = 4.98 / (2.0 * np.pi) * _VISCOSITY**0.5 * R**-0.75 * gravity**-0.25
        return cls(float(np.sqrt(squared)), float(damping))

    def follow(self, slope: Float[Array, "n 2"], dt: float) -> Float[Array, "n 2"]:
        """Return how the surface's slope follows that of what is felt, from rest, for even samples `dt` apart [s].

        Exact for what is felt if that is constant from each sample to the next.
        """
        target = (slope[:, 0] + 1j * slope[:, 1]).tolist()
        pole = self.frequency * (-self.damping + 1j * np.sqrt(1.0 - self.damping**2))
        turn = cmath.exp(pole * dt)
        # In the variable rate - conj(pole) (sigma - target) the homogeneous motion is a rotation by the pole.
        a, b = pole.conjugate(), pole
        sigma, rate = target[0], 0j
        followed: list[complex] = []
        for level in target:
            followed.append(sigma)
            off = sigma - level
            u, v = (rate - a * off) * turn, (rate - b * off) * turn.conjugate()
            off, rate = (u - v) / (b - a), (b * u - a * v) / (b - a)
            sigma = level + off
        return np.array([(each.real, each.imag) for each in followed])
