"""A differential-drive base, with wheels or tracks: it rolls along its heading and turns in place, never sideways."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, fields

from graceful_plan.exceptions import SettingError
from graceful_plan.path import is_real, plain_numbers

_LEAST, _MOST = 1e-4, 1e3
"""Range of all quantities of a base, and of `wheel_max` times the radius."""

GRAVITY_SHARE = 2.0
"""Default `lateral_max` [m/s^2], for friction and load: a fifth of gravity. An object on deck neither tips nor slides
if the height of its centre of mass is at most five times its support radius and its friction at least 0.2."""


@dataclass(frozen=True, kw_only=True)
class DiffDrive:
    """Kinematics and limits of a planar base; its joints are the planned model's.

    | field       | meaning                                                                          | unit    |
    |-------------|----------------------------------------------------------------------------------|---------|
    | joints      | slide along x of W, slide along y, hinge about z whose 0 points along x          |         |
    | radius      | of the driven wheels                                                             | m       |
    | track       | distance between the centres of left and right wheels                            | m       |
    | slip        | effective track over track: 1 for two wheels, about 1.5 for a skid-steer         |         |
    | v_max       | largest speed along the heading                                                  | m/s     |
    | omega_max   | largest yaw rate                                                                 | rad/s   |
    | a_max       | largest acceleration along the heading                                           | m/s^2   |
    | alpha_max   | largest yaw acceleration                                                         | rad/s^2 |
    | lateral_max | largest lateral acceleration, speed times yaw rate                               | m/s^2   |
    | wheel_max   | largest wheel rate; default: that of `v_max` on a straight line                  | rad/s   |
    | reverse     | whether it may drive backwards                                                   |         |
    | wheels      | bodies of the driven wheels, left ones first; in simulations they turn about y   |         |
    | load        | fraction of the weight on the driven wheels; casters carry the rest              |         |
    | rotor       | inertia of a driven wheel with its motor and gears, about its axle               | kg m^2  |

    Wheel rates are (v -+ omega slip track / 2) / radius, with minus for left wheels. For a skid-steer see A. Mandow et
    al., "Experimental kinematics for wheeled skid-steer mobile robots", IROS 2007. The origin of the joints is the
    point that never moves sideways. For two wheels it is the middle of their axle. For a skid-steer it is the point
    about which it turns in place, which is ahead of the middle of its wheels if its centre of mass is.

    Raises:
        SettingError: If a number is not finite and above 0, or the joints are not three different names.
    """

    joints: tuple[str, str, str]
    radius: float
    track: float
    slip: float = 1.0
    v_max: float
    omega_max: float
    a_max: float
    alpha_max: float
    lateral_max: float = GRAVITY_SHARE
    wheel_max: float | None = None
    reverse: bool = True
    wheels: tuple[str, ...] = ()
    load: float = 1.0
    rotor: float = 0.1

    def __post_init__(self) -> None:
        plain_numbers(self)
        for name in ("joints", "wheels"):
            given = getattr(self, name)
            if isinstance(given, str) or not isinstance(given, Iterable):
                raise SettingError(f"DiffDrive.{name}", given, "names of joints")
            object.__setattr__(self, name, tuple(given))
        if len(set(self.joints)) != 3 or not all(isinstance(name, str) for name in self.joints):
            raise SettingError("DiffDrive.joints", self.joints, "three names: slide x, slide y and hinge yaw")
        for item in fields(self):
            value = getattr(self, item.name)
            if item.name in ("joints", "wheels", "reverse") or (item.name == "wheel_max" and value is None):
                continue
            if not (is_real(value) and _LEAST <= value <= _MOST):
                raise SettingError(f"DiffDrive.{item.name}", value, f"a finite number above 0, {_LEAST:g} to {_MOST:g}")
        if self.wheel_max is None:
            object.__setattr__(self, "wheel_max", self.v_max / self.radius)
        if self.rim_max > _MOST:
            raise SettingError("DiffDrive.wheel_max", self.wheel_max, f"at most {_MOST:g} m/s at the rim")
        if self.slip < 1.0:
            raise SettingError("DiffDrive.slip", self.slip, "at least 1, the value without slip")
        if self.load > 1.0:
            raise SettingError("DiffDrive.load", self.load, "a share of the weight, at most 1")
        if not isinstance(self.reverse, bool):
            raise SettingError("DiffDrive.reverse", self.reverse, "True or False")

    @property
    def lever(self) -> float:
        """Half the effective track [m]: distance that a wheel rolls per radian of turning in place."""
        return 0.5 * self.slip * self.track

    @property
    def wheel_base(self) -> float:
        """Distance between front and rear wheels [m], for a skid-steer derived from its slip; 0 for two wheels."""
        return self.track * math.sqrt(self.slip - 1.0)

    @property
    def joint_limits(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """Limits of speed and acceleration of the three joints, valid for all headings."""
        hardest = math.hypot(self.a_max, self.lateral_max)
        return (self.v_max, self.v_max, self.omega_max), (hardest, hardest, self.alpha_max)

    @property
    def rim_max(self) -> float:
        """Largest speed of a wheel's rim [m/s]."""
        return float(self.wheel_max or 0.0) * self.radius
