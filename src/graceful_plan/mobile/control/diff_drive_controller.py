"""From what a base should do to what its wheels should: limits of body, accelerations and wheels, slip, tracking."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.exceptions import SettingError
from graceful_plan.mobile.control.drive_state import DriveCommand, DriveState, check_numbers, wrapped
from graceful_plan.path import finite_array, is_real
from graceful_plan.scene.mobile.diff_drive import DiffDrive

Array = np.ndarray

_DRIVES = 0.4
"""Speed at which a base is held at half the angle to its way that the bend asks for [m/s]."""
_TURNS = 0.3
"""Rate of turning from which on a base that turns in place is held behind its place [rad/s]."""


def wheel_speeds(command: DriveCommand, base: DiffDrive) -> tuple[float, float]:
    """Return the rates of left and right wheels [rad/s]: (v -+ omega slip track / 2) / radius."""
    return (
        (command.v - base.lever * command.omega) / base.radius,
        (command.v + base.lever * command.omega) / base.radius,
    )


def body_speeds(left: float, right: float, base: DiffDrive) -> DriveCommand:
    """Return what the base does whose wheels turn at these rates [rad/s]; inverse of `wheel_speeds`."""
    return DriveCommand(0.5 * (left + right) * base.radius, 0.5 * (right - left) * base.radius / base.lever)


def limited(wanted: DriveCommand, before: DriveCommand, base: DiffDrive, dt: float) -> DriveCommand:
    """Return what comes nearest to a command within the base's limits, a time after another command.

    Speeds and accelerations of the body come first. Where wheels would be too fast, the speed gives way and not the
    rate of turning, so that the base stays on its way.

    Args:
        wanted: What it should do.
        before: What it was told before.
        base: Its limits.
        dt: Time between the two [s], above 0.

    Raises:
        SettingError: If the time is not above 0.
        NonFiniteError: If a speed is not finite.
    """
    if not dt > 0.0:
        raise SettingError("dt", dt, "a time above 0 s")
    finite_array("wanted and before", [wanted, before], ndim=2, last=2)
    least = -base.v_max if base.reverse else 0.0
    v = min(max(wanted.v, before.v - base.a_max * dt, least), before.v + base.a_max * dt, base.v_max)
    omega = min(max(wanted.omega, before.omega - base.alpha_max * dt), before.omega + base.alpha_max * dt)
    omega = min(max(omega, -base.omega_max), base.omega_max, base.rim_max / base.lever)
    omega = max(omega, -base.rim_max / base.lever)
    room = base.rim_max - base.lever * abs(omega)
    return DriveCommand(min(max(v, -room), room), omega)


_WINDS = 0.15
"""Greatest integral of the rate of turning that is missed [rad]."""


@dataclass(frozen=True, kw_only=True)
class Pivot:
    r"""Where a base has no sideways speed: ahead of its origin by :math:`p_0 + p_1 v |\omega| / (|v \omega| + a)`.

    A skid-steer whose centre of mass is not in the middle turns about another point than its origin, and in bends its
    tyres have to carry it sideways: it drives at an angle to its heading. Backwards the other tyres carry more of it.
    Measure it by driving (A. Mandow et al., IROS 2007).

    Args:
        still: p_0, where it turns in place [m].
        bend: p_1, what fast bends add at most [m].
        acceleration: a, acceleration across the heading at which that is half of it [m/s^2].
        back_bend: p_1 where it drives backwards [m]; as forwards by default.
        back_acceleration: a, likewise [m/s^2].
    """

    still: float = 0.0
    bend: float = 0.0
    acceleration: float = 1.0
    back_bend: float | None = None
    back_acceleration: float | None = None

    def __post_init__(self) -> None:
        for field in fields(self):
            value, above = getattr(self, field.name), field.name.endswith("acceleration")
            if value is None and field.name.startswith("back_"):
                continue
            if not (is_real(value) and math.isfinite(value)) or (above and value <= 0.0):
                raise SettingError(f"Pivot.{field.name}", value, "a finite number, of the acceleration above 0")

    def ahead(self, v: float, omega: float) -> float:
        """Return how far ahead of the origin it is [m]."""
        across, bend, half = abs(v * omega), self.bend, self.acceleration
        if v < 0.0:
            bend = bend if self.back_bend is None else self.back_bend
            half = half if self.back_acceleration is None else self.back_acceleration
        return self.still + math.copysign(bend * across / (across + half), v)


@dataclass(frozen=True, kw_only=True)
class Tracking:
    r"""Follows a motion: :math:`v = v_r \cos e_h + k_x e_x`, and a rate of turning that also heeds the rate it has.

    :math:`\omega = \omega_r + v_r k_y e_y + (|v_r| k_h + k_x) \sin e_h`, to which :math:`k_r (\omega - \omega_m)` and
    its integral are added, :math:`\omega_m` being the measured rate: a skid-steer slips less the faster it drives. In
    bends the base is held at the angle to its way at which its origin does not leave it (`Pivot`), but not before it
    drives: no base that gets going turns so fast. Where it turns in place, its origin has to go round the pivot; it is
    kept `share` of that behind, so that it is off less to the side. What is corrected is bounded by
    :math:`\sqrt{2 \alpha |e|}`, e being the heading that is missed and what the way aside counts as: from a faster turn
    the motors could not bring it back, and it would swing about its way.

    Y. Kanayama et al., "A stable tracking control method for an autonomous mobile robot", ICRA 1990.

    Args:
        k_x: Along the heading [1/s].
        k_y: Across it [1/m^2].
        k_h: Of the heading [1/m].
        k_rate: Of the rate of turning as a gyro measures it.
        k_integral: Of its integral [1/s].
        alpha: Angular acceleration that motors have to spare [rad/s^2].
        lead: What motors need until they do as they are told [s]: speeds are looked up as much ahead.
        pivot: Where the base has no sideways speed.
        share: Of the distance to the pivot, where it turns in place.
        slant: Greatest angle to its way at which the base is held [rad]. Bends may ask for more, but where it turns
            so tightly, it cannot get there and back in time.
    """

    k_x: float = 6.0
    k_y: float = 20.0
    k_h: float = 6.0
    k_rate: float = 1.0
    k_integral: float = 5.0
    alpha: float = 3.0
    lead: float = 0.05
    pivot: Pivot = Pivot()
    share: float = 0.6
    slant: float = 0.15

    def __post_init__(self) -> None:
        check_numbers(self, ("k_x", "k_y", "k_h", "k_rate", "k_integral", "alpha", "lead", "share", "slant"))

    def command(self, state: DriveState, wanted: DriveState) -> DriveCommand:
        """Return what leads to a state that moves on, before the measured rate of turning counts.

        Args:
            state: Where the base is and how fast.
            wanted: Where it should be now and how fast.

        Raises:
            NonFiniteError: If a number is not finite.
        """
        finite_array("state and wanted", [state, wanted], ndim=2, last=5)
        c, s = math.cos(state.yaw), math.sin(state.yaw)
        dx, dy = wanted.x - state.x, wanted.y - state.y
        ahead = self.pivot.ahead(wanted.v, wanted.omega)
        sideways = ahead * wanted.omega
        rolls = wanted.v**2 / (wanted.v**2 + sideways**2) if wanted.v else 0.0
        turns = min(1.0, abs(wanted.omega) / _TURNS)
        along = c * dx + s * dy - self.share * (1.0 - rolls) * turns * ahead
        across = -s * dx + c * dy
        drives = wanted.v**2 / (wanted.v**2 + _DRIVES**2)
        slant = drives * rolls * math.atan2(sideways, abs(wanted.v)) * math.copysign(1.0, wanted.v)
        slant = min(max(slant, -self.slant), self.slant)
        heading = wrapped(wanted.yaw + slant - state.yaw)
        v = wanted.v * math.cos(heading - slant) + self.k_x * along
        return DriveCommand(v, wanted.omega + self._pull(wanted.v, across, heading))

    def _pull(self, v: float, across: float, heading: float) -> float:
        """Return the rate of turning that leads back to the way [rad/s]."""
        stiff = abs(v) * self.k_h + self.k_x
        pull = v * self.k_y * across + stiff * math.sin(heading)
        missed = abs(heading) + (abs(v) * self.k_y * abs(across) / stiff if stiff else 0.0)
        most = math.sqrt(2.0 * self.alpha * missed)
        return min(max(pull, -most), most)

    def summed(self, before: float, command: DriveCommand, state: DriveState, dt: float) -> float:
        """Return the integral of commanded minus measured rate of turning a time later [rad].

        It stops growing where it asks for more than slip ever does: motors at their limit would wind it up.

        Args:
            before: What it was.
            command: What the base should do.
            state: What it does.
            dt: Time [s].
        """
        return min(max(before + dt * (command.omega - state.omega), -_WINDS), _WINDS)

    def held(self, command: DriveCommand, state: DriveState, summed: float) -> DriveCommand:
        """Return what to tell the wheels so that the base turns as commanded, though it slips.

        Args:
            command: What the base should do.
            state: What it does.
            summed: Integral of commanded minus measured rate of turning [rad].
        """
        off = command.omega - state.omega
        return DriveCommand(command.v, command.omega + self.k_rate * off + self.k_integral * summed)


def drive_states(q: Float[Array, "n nq"], qd: Float[Array, "n nq"]) -> Float[Array, "n 5"]:
    """Return x, y, yaw, speed along it and rate of turning of configurations whose first three joints drive."""
    c, s = np.cos(q[:, 2]), np.sin(q[:, 2])
    return np.column_stack([q[:, :3], qd[:, 0] * c + qd[:, 1] * s, qd[:, 2]])
