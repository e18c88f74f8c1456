"""A base on two driven sides, of wheels or tracks: it rolls along its heading and turns in place, never sideways."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, fields

from graceful_plan.exceptions import SettingError
from graceful_plan.path import is_real

_LEAST, _MOST = 1e-4, 1e3
"""Of what a base has; of `wheel_max` times the radius too."""

GRAVITY_SHARE = 2.0
"""Default of what friction and the load stand across the heading [m/s^2]: a fifth of gravity, which nothing aboard tips
or slides at that stands on 1/5 of its height."""


@dataclass(frozen=True, kw_only=True)
class DiffDrive:
    """How a planar base drives; its joints are those of the model that is planned with.

    | field       | meaning                                                                          | unit    |
    |-------------|----------------------------------------------------------------------------------|---------|
    | joints      | slide along x of the world, slide along y, hinge about z whose 0 looks along x   |         |
    | radius      | of the driven wheels                                                             | m       |
    | track       | between the middles of left and right wheels                                     | m       |
    | slip        | effective track over track: 1 for two wheels, about 1.5 for a skid-steer         |         |
    | v_max       | greatest speed along the heading                                                 | m/s     |
    | omega_max   | greatest rate of turning                                                         | rad/s   |
    | a_max       | greatest acceleration along the heading                                          | m/s^2   |
    | alpha_max   | greatest acceleration of turning                                                 | rad/s^2 |
    | lateral_max | greatest acceleration across the heading, speed times rate of turning            | m/s^2   |
    | wheel_max   | greatest rate of a wheel; default: that of `v_max` on the straight               | rad/s   |
    | reverse     | whether it may drive backwards                                                   |         |
    | wheels      | bodies of the driven wheels, left ones first; in simulations they turn about y   |         |
    | load        | share of the weight on the driven wheels; casters carry the rest                 |         |
    | rotor       | inertia of a driven wheel with its motor and gears, about its axle               | kg m^2  |

    Wheel rates are (v -+ omega slip track / 2) / radius, left with minus. For a skid-steer see A. Mandow et al.,
    "Experimental kinematics for wheeled skid-steer mobile robots", IROS 2007. The origin of the joints is the point
    that never moves sideways: the middle of the axle of two wheels; of a skid-steer the point about which it turns in
    place, ahead of the middle of its wheels if its mass is.

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
            raise SettingError("DiffDrive.slip", self.slip, "at least 1, the share of wheels that do not slip")
        if self.load > 1.0:
            raise SettingError("DiffDrive.load", self.load, "a share of the weight, at most 1")
        if not isinstance(self.reverse, bool):
            raise SettingError("DiffDrive.reverse", self.reverse, "True or False")

    @property
    def lever(self) -> float:
        """Half the effective track [m]: what one radian of turning moves a wheel."""
        return 0.5 * self.slip * self.track

    @property
    def wheel_base(self) -> float:
        """Between front and rear wheels of a skid-steer, as its slip says; 0 for two wheels [m]."""
        return self.track * math.sqrt(self.slip - 1.0)

    @property
    def joint_limits(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """Bounds of the speeds and accelerations of the three joints: what holds in all headings."""
        hardest = math.hypot(self.a_max, self.lateral_max)
        return (self.v_max, self.v_max, self.omega_max), (hardest, hardest, self.alpha_max)

    @property
    def rim_max(self) -> float:
        """Greatest speed of a wheel's rim [m/s]."""
        return float(self.wheel_max or 0.0) * self.radius
