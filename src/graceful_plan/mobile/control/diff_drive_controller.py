"""Conversion of body commands into wheel commands: limits, slip compensation and trajectory tracking."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SettingError
from graceful_plan.mobile.control.drive_state import DriveCommand, DriveState, check_numbers, wrapped
from graceful_plan.path import finite_array, is_real, plain_numbers
from graceful_plan.scene.mobile.diff_drive import DiffDrive

_DRIVES = 0.4
"""Speed at which the base is held at half of the slip angle of its arc [m/s]."""
_TURNS = 0.3
"""Turning rate above which the full offset of `Tracking.share` applies when turning in place [rad/s]."""


def limited(wanted: DriveCommand, before: DriveCommand, base: DiffDrive, dt: float) -> DriveCommand:
    """Return the nearest command within the base's limits that is reachable from the previous command.

    Limits on body speeds and accelerations apply first. If a wheel would still be too fast, the speed is reduced and
    not the turning rate, so that the base stays on its path.

    Args:
        wanted: Desired command.
        before: Previous command.
        base: Base with its limits.
        dt: Time between the two commands [s], above 0.

    Raises:
        SettingError: If `dt` is not above 0.
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
"""Bound of the integral of the turning-rate error [rad]."""


@dataclass(frozen=True, kw_only=True)
class Pivot:
    r"""Point without sideways velocity, ahead of the origin by :math:`p_0 + p_1 v |\omega| / (|v \omega| + a)`.

    A skid-steer whose centre of mass is off its middle turns about a point other than its origin. Along arcs its tyres
    need sideways slip for the lateral force, so the base drives at an angle to its heading. Backwards, the other axle
    carries more of that force. Identify the parameters by driving (A. Mandow et al., IROS 2007).

    Args:
        still: p_0, the offset when turning in place [m].
        bend: p_1, the largest additional offset along fast arcs [m].
        acceleration: a, lateral acceleration at which the additional offset is p_1 / 2 [m/s^2].
        back_bend: p_1 when driving backwards [m]; default: the value for forwards.
        back_acceleration: a when driving backwards [m/s^2]; default: the value for forwards.
    """

    still: float = 0.0
    bend: float = 0.0
    acceleration: float = 1.0
    back_bend: float | None = None
    back_acceleration: float | None = None

    def __post_init__(self) -> None:
        plain_numbers(self)
        for field in fields(self):
            value, above = getattr(self, field.name), field.name.endswith("acceleration")
            if value is None and field.name.startswith("back_"):
                continue
            if not (is_real(value) and math.isfinite(value)) or (above and value <= 0.0):
                raise SettingError(f"Pivot.{field.name}", value, "a finite number; accelerations above 0")

    def ahead(self, v: float, omega: float) -> float:
        """Return the distance of the point ahead of the origin [m]."""
        across, bend, half = abs(v * omega), self.bend, self.acceleration
        if v < 0.0:
            bend = bend if self.back_bend is None else self.back_bend
            half = half if self.back_acceleration is None else self.back_acceleration
        return self.still + math.copysign(bend * across / (across + half), v)


@dataclass(frozen=True, kw_only=True)
class Tracking:
    r"""Trajectory tracking with :math:`v = v_r \cos e_h + k_x e_x` and feedback on the measured turning rate.

    The turning rate is :math:`\omega = \omega_r + v_r k_y e_y + (|v_r| k_h + k_x) \sin e_h`. The terms :math:`k_r
    (\omega - \omega_m)` and its integral are added, where :math:`\omega_m` is the measured rate, because a skid-steer
    slips less the faster it drives.

    Along arcs the base is held at the slip angle at which its origin stays on the path (`Pivot`). This fades in with
    speed, because a starting base cannot turn that fast. When the base turns in place, its origin circles the pivot.
    The base is then held behind its reference by `share` of the pivot offset, which reduces the lateral error.
    Corrections are limited to :math:`\sqrt{2 \alpha |e|}`, where e is the heading error plus the lateral error
    converted to an angle. Motors could not stop a faster turn in time, and the base would oscillate about its path.

    Y. Kanayama et al., "A stable tracking control method for an autonomous mobile robot", ICRA 1990.

    Args:
        k_x: Gain on the error along the heading [1/s].
        k_y: Gain on the lateral error [1/m^2].
        k_h: Gain on the heading error [1/m].
        k_rate: Gain on the error of the turning rate, as measured by a gyro.
        k_integral: Gain on the integral of that error [1/s].
        alpha: Angular acceleration the motors have in reserve [rad/s^2].
        lead: Response time of the motors [s]; reference speeds are looked up ahead by this time.
        pivot: Point without sideways velocity.
        share: Share of the pivot offset by which the base is held behind when turning in place.
        slant: Largest slip angle at which the base is held [rad]. Tight arcs may need more, but the base could not
            reach that angle and return from it in time.
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
        plain_numbers(self)
        check_numbers(self, ("k_x", "k_y", "k_h", "k_rate", "k_integral", "alpha", "lead", "share", "slant"))

    def command(self, state: DriveState, wanted: DriveState) -> DriveCommand:
        """Return the command that leads to a moving reference state, before feedback of the measured turning rate.

        Args:
            state: Current state of the base.
            wanted: Reference state at this time.

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
        """Return the turning rate that corrects lateral and heading errors [rad/s]."""
        stiff = abs(v) * self.k_h + self.k_x
        pull = v * self.k_y * across + stiff * math.sin(heading)
        missed = abs(heading) + (abs(v) * self.k_y * abs(across) / stiff if stiff else 0.0)
        most = math.sqrt(2.0 * self.alpha * missed)
        return min(max(pull, -most), most)

    def summed(self, before: float, command: DriveCommand, state: DriveState, dt: float) -> float:
        """Return the integral of commanded minus measured turning rate after a time step [rad].

        It is clamped at a value beyond any real slip, otherwise saturated motors would wind it up.

        Args:
            before: Integral before the step [rad].
            command: Commanded speeds.
            state: Measured state.
            dt: Time step [s].
        """
        return min(max(before + dt * (command.omega - state.omega), -_WINDS), _WINDS)

    def held(self, command: DriveCommand, state: DriveState, summed: float) -> DriveCommand:
        """Return the wheel-level command that makes the base turn as commanded in spite of slip.

        Args:
            command: Commanded speeds.
            state: Measured state.
            summed: Integral of commanded minus measured turning rate [rad].
        """
        off = command.omega - state.omega
        return DriveCommand(command.v, command.omega + self.k_rate * off + self.k_integral * summed)


def drive_states(q: Float[Array, "n nq"], qd: Float[Array, "n nq"]) -> Float[Array, "n 5"]:
    """Return x, y, yaw, forward speed and turning rate of configurations whose first three joints are the base."""
    c, s = np.cos(q[:, 2]), np.sin(q[:, 2])
    return np.column_stack([q[:, :3], qd[:, 0] * c + qd[:, 1] * s, qd[:, 2]])
