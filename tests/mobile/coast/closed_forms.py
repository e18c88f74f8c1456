r"""Closed-form distances and deviations of a base after a failure. All functions broadcast over arrays.

:math:`m_e = m + n J / r^2` is the effective mass of a base with n wheels of radius r, where J is the inertia of each
wheel with its motor. :math:`\tau_f` is the friction torque of a wheel's gears and b their damping. On level floor the
base decelerates by :math:`a = n \tau_f / (r m_e)` plus :math:`k v` with :math:`k = n b / (r^2 m_e)`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Float
from graceful_plan.scene.mobile.diff_drive import DiffDrive

Array = np.ndarray

GRAVITY = 9.81


def coasting_distance(v: ArrayLike | float, a: ArrayLike | float, k: ArrayLike | float = 0.0) -> Float[Array, "*batch"]:
    r"""Compute the distance a base rolls without power: :math:`v/k - (a/k^2) \ln(1 + k v / a)`.

    Args:
        v: Speed [m/s].
        a: Deceleration by dry friction, above 0 [m/s^2].
        k: Deceleration per speed [1/s].
    """
    v, a, k = np.broadcast_arrays(*(np.asarray(x, dtype=float) for x in (np.abs(v), a, k)))
    drag = np.where(k > 0.0, k, 1.0)
    return np.asarray(np.where(k > 0.0, v / drag - a / drag**2 * np.log1p(drag * v / a), v**2 / (2.0 * a)))


def sliding_distance(v: ArrayLike | float, friction: ArrayLike | float, load: float = 1.0) -> Float[Array, "*batch"]:
    """Compute the sliding distance [m] with locked wheels that carry a share of the weight: v^2 / (2 mu g load)."""
    return np.asarray(np.square(v) / (2.0 * np.asarray(friction) * GRAVITY * load))


def runaway_distance(v: ArrayLike | float, delay: ArrayLike | float, a: ArrayLike | float) -> Float[Array, "*batch"]:
    """Compute the arc length [m] until a watchdog stops a base after a delay [s] with a deceleration [m/s^2]."""
    return np.asarray(np.abs(v) * np.asarray(delay) + np.square(v) / (2.0 * np.asarray(a)))


def slope_acceleration(
    slope: ArrayLike | float, a: ArrayLike | float, mass: float, effective: float
) -> Float[Array, "*batch"]:
    """Compute the acceleration of an unpowered base down a slope; 0 where friction holds it.

    Args:
        slope: Angle of the floor along the heading, positive downwards [rad].
        a: Deceleration on level floor by dry friction [m/s^2].
        mass: Mass of the base [kg].
        effective: Effective mass, including the rotating parts of the wheels [kg].
    """
    pull, held = GRAVITY * np.sin(slope) * mass / effective, np.asarray(a)
    return np.asarray(np.sign(pull) * np.maximum(0.0, np.abs(pull) - held))


def slope_distance(
    v: ArrayLike | float, seconds: float, slope: ArrayLike | float, a: ArrayLike | float, share: float
) -> Float[Array, "*batch"]:
    """Compute the distance an unpowered base rolls down a slope in a given time, starting at a downhill speed.

    Args:
        v: Speed, at least 0 [m/s].
        seconds: Time after the failure [s].
        slope: Angle of the floor along the heading, positive downwards [rad].
        a: Deceleration on level floor by dry friction, without drag [m/s^2].
        share: Ratio of mass to effective mass.
    """
    rate = GRAVITY * np.sin(slope) * share - np.asarray(a)
    moving = np.where(rate < 0.0, np.minimum(seconds, np.asarray(v) / np.maximum(-rate, 1e-12)), seconds)
    return np.asarray(np.asarray(v) * moving + 0.5 * rate * moving**2)


def spin_rate(rim: ArrayLike | float, base: DiffDrive) -> Float[Array, "*batch"]:
    """Compute the turning rate when one side is locked and the other drives at a rim speed: rim / (slip track)."""
    return np.asarray(np.asarray(rim) / (base.slip * base.track))


def pivot_radius(base: DiffDrive) -> float:
    """Return the turning radius of a two-wheeled base with one locked wheel [m]; for skid-steers see `four_wheel`."""
    return 0.5 * base.track


def sideways_of_bias(s: ArrayLike | float, bias: ArrayLike | float) -> Float[Array, "*batch"]:
    """Compute the lateral error after a distance s [m] from an odometry curvature bias [1/m]: bias s^2 / 2."""
    return np.asarray(0.5 * np.asarray(bias) * np.square(s))


def sideways_of_noise(s: ArrayLike | float, noise: ArrayLike | float) -> Float[Array, "*batch"]:
    """Compute the standard deviation of the lateral error from white curvature noise [m^-.5], noise (s^3 / 3)^.5."""
    return np.asarray(np.asarray(noise) * np.sqrt(np.power(s, 3.0) / 3.0))


def overshoot_of_delay(
    v: ArrayLike | float, delay: ArrayLike | float, curvature: ArrayLike | float = 0.0
) -> Float[Array, "*batch 2"]:
    """Compute the overshoot along and across the path from delayed commands [m]: v delay, curvature (v delay)^2 / 2."""
    far = np.abs(v) * np.asarray(delay)
    return np.stack(np.broadcast_arrays(far, 0.5 * np.asarray(curvature) * far**2), axis=-1)


def straightening_angle(
    omega: ArrayLike | float, base: DiffDrive, mass: float, friction: float
) -> Float[Array, "*batch"]:
    r"""Compute the angle by which a skid-steer still turns after its wheels are released [rad].

    Its turning rate falls linearly to 0 within :math:`t = (\omega \chi B / 2 r) J / (0.57 \mu m g r / 4)`.

    Args:
        omega: Turning rate at the release [rad/s].
        base: Parameters of the base.
        mass: Mass of the base [kg].
        friction: Friction coefficient of the tyres.
    """
    rate = np.abs(omega)
    torque = 0.57 * friction * mass * GRAVITY * base.radius / 4.0
    return np.asarray(0.5 * rate * (rate * base.lever / base.radius * base.rotor / torque))
