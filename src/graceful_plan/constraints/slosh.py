r"""Sloshing: a pendulum model of how a liquid's surface lags behind the specific force and overshoots.

The first antisymmetric mode of a liquid in an upright cylinder moves like a pendulum suspended in it:

.. math:: l = \frac{R}{1.841 \tanh(1.841 h / R)}, \qquad \omega^2 = g / l

The surface is approximately a plane perpendicular to the pendulum. Higher modes are neglected.

References:
    H. Abramson (ed.), "The Dynamic Behavior of Liquids in Moving Containers", NASA SP-106, 1966: frequencies, and the
    damping where the liquid is deep, a logarithmic decrement of 4.98 nu^(1/2) R^(-3/4) g^(-1/4).
    R. Muchacho et al., "A Solution to Slosh-free Robot Trajectory Optimization", IROS 2022: the spherical pendulum.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from graceful_plan.scene.rules.vessel import Vessel

_ROOT = 1.841
"""First zero of the derivative of the Bessel function J_1."""
_VISCOSITY = 1e-6
"""Kinematic viscosity of water [m^2/s], the least damped of the usual contents."""


@final
@dataclass(frozen=True)
class Slosh:
    """The first sloshing mode of a liquid in a vessel.

    | field     | meaning                         | unit  |
    |-----------|---------------------------------|-------|
    | frequency | at rest                         | rad/s |
    | damping   | ratio to the critical damping   |       |
    | length    | of the pendulum                 | m     |
    """

    frequency: float
    damping: float
    length: float

    @classmethod
    def of(cls, vessel: Vessel, gravity: float) -> Slosh:
        """Return the mode of a vessel's contents for small angles around the vessel's axis."""
        R = vessel.radius
        depth = vessel.volume / (np.pi * R**2)
        length = float(R / (_ROOT * np.tanh(_ROOT * depth / R)))
        damping = 4.98 / (2.0 * np.pi) * _VISCOSITY**0.5 * R**-0.75 * gravity**-0.25
        return cls(float(np.sqrt(gravity / length)), float(damping), length)

    @property
    def drag(self) -> float:
        """Damping rate of the pendulum's velocity [1/s]."""
        return 2.0 * self.damping * self.frequency
