r"""Closed forms of what a base does after a failure: how far it goes, and how far aside. All take arrays.

:math:`m_e = m + n J / r^2` is its mass with what turns in its n wheels of radius r, J the inertia of each with its
motor; :math:`\tau_f` the friction of a wheel's gears, b its damping. On the level it loses
:math:`a = n \tau_f / (r m_e)` and :math:`k v` with :math:`k = n b / (r^2 m_e)` of its speed per second.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Float
from graceful_plan.scene.mobile.diff_drive import DiffDrive

Array = np.ndarray

GRAVITY = 9.81


def coasting_distance(v: ArrayLike | float, a: ArrayLike | float, k: ArrayLike | float = 0.0) -> Float[Array, "*batch"]:
    r"""Return how far a base rolls without power: :math:`v/k - (a/k^2) \ln(1 + k v / a)`.

    Args:
        v: Speed [m/s].
        a: Deceleration by dry friction, above 0 [m/s^2].
        k: Deceleration per speed [1/s].
    """
    v, a, k = np.broadcast_arrays(*(np.asarray(x, dtype=float) for x in (np.abs(v), a, k)))
    drag = np.where(k > 0.0, k, 1.0)
    return np.asarray(np.where(k > 0.0, v / drag - a / drag**2 * np.log1p(drag * v / a), v**2 / (2.0 * a)))


def sliding_distance(v: ArrayLike | float, friction: ArrayLike | float, load: float = 1.0) -> Float[Array, "*batch"]:
    """Return how far a base slides whose wheels are held, a share of its weight on them: v^2 / (2 mu g load)."""
    return np.asarray(np.square(v) / (2.0 * np.asarray(friction) * GRAVITY * load))


def runaway_distance(v: ArrayLike | float, delay: ArrayLike | float, a: ArrayLike | float) -> Float[Array, "*batch"]:
    """Return how far a base goes that a watchdog stops after a delay [s] with a deceleration [m/s^2], along its arc."""
    return np.asarray(np.abs(v) * np.asarray(delay) + np.square(v) / (2.0 * np.asarray(a)))


def slope_acceleration(
    slope: ArrayLike | float, a: ArrayLike | float, mass: float, effective: float
) -> Float[Array, "*batch"]:
    """Return the acceleration down a slope of a base without power; 0 where friction holds it.

    Args:
        slope: Angle of the floor along the heading, downwards above 0 [rad].
        a: Deceleration on the level by dry friction [m/s^2].
        mass: Of the base [kg].
        effective: With what turns in its wheels [kg].
    """
    pull, held = GRAVITY * np.sin(slope) * mass / effective, np.asarray(a)
    return np.asarray(np.sign(pull) * np.maximum(0.0, np.abs(pull) - held))


def slope_distance(
    v: ArrayLike | float, seconds: float, slope: ArrayLike | float, a: ArrayLike | float, share: float
) -> Float[Array, "*batch"]:
    """Return how far a base without power gets down a slope in a time, if it drives down at first.

    Args:
        v: Speed, at least 0 [m/s].
        seconds: After the failure [s].
        slope: Downwards along the heading [rad].
        a: Deceleration on the level by dry friction, without drag [m/s^2].
        share: Mass over mass with what turns in the wheels.
    """
    rate = GRAVITY * np.sin(slope) * share - np.asarray(a)
    moving = np.where(rate < 0.0, np.minimum(seconds, np.asarray(v) / np.maximum(-rate, 1e-12)), seconds)
    return np.asarray(np.asarray(v) * moving + 0.5 * rate * moving**2)


def spin_rate(rim: ArrayLike | float, base: DiffDrive) -> Float[Array, "*batch"]:
    """Return the rate of turning once one side stands and the other has this speed of rims: rim / (slip track)."""
    return np.asarray(np.asarray(rim) / (base.slip * base.track))


def pivot_radius(base: DiffDrive) -> float:
    """Return the radius about which two wheels turn one of which is held [m]; skid-steers slide, see `four_wheel`."""
    return 0.5 * base.track


def sideways_of_bias(s: ArrayLike | float, bias: ArrayLike | float) -> Float[Array, "*batch"]:
    """Return how far aside a bias of the curvature [1/m] in odometry leads, after a way [m]: bias s^2 / 2."""
    return np.asarray(0.5 * np.asarray(bias) * np.square(s))


def sideways_of_noise(s: ArrayLike | float, noise: ArrayLike | float) -> Float[Array, "*batch"]:
    """Return the standard deviation of that of white noise of the curvature [1/m per root of m]: noise (s^3 / 3)^.5."""
    return np.asarray(np.asarray(noise) * np.sqrt(np.power(s, 3.0) / 3.0))


def overshoot_of_delay(
    v: ArrayLike | float, delay: ArrayLike | float, curvature: ArrayLike | float = 0.0
) -> Float[Array, "*batch 2"]:
    """Return how far on and aside late commands lead: v delay, curvature (v delay)^2 / 2 [m]."""
    far = np.abs(v) * np.asarray(delay)
    return np.stack(np.broadcast_arrays(far, 0.5 * np.asarray(curvature) * far**2), axis=-1)


def straightening_angle(
    omega: ArrayLike | float, base: DiffDrive, mass: float, friction: float
) -> Float[Array, "*batch"]:
    r"""Return by how much a skid-steer turns on once its wheels are let go [rad].

    It straightens within :math:`t = (\omega \chi B / 2 r) J / (0.57 \mu m g r / 4)`, evenly.

    Args:
        omega: Rate of turning [rad/s].
        base: How it drives.
        mass: Of the base [kg].
        friction: Coefficient of its tyres.
    """
    rate = np.abs(omega)
    torque = 0.57 * friction * mass * GRAVITY * base.radius / 4.0
    return np.asarray(0.5 * rate * (rate * base.lever / base.radius * base.rotor / torque))
