r"""Time integration of a base with a one-sided failure: four wheels with dry friction.

Each wheel carries its share of the weight on the driven wheels. Its contact slides over the floor at the velocity s,
and the floor exerts the force :math:`-\mu N s / \sqrt{|s|^2 + \epsilon^2}`. Rims of the working side keep their speed
for the delay, or follow a controller (`steering`), and then stop. Locked rims stand still. Free rims are driven by the
floor against the friction of their gears and the inertia of their motors. Two wheels with casters are modelled as four
wheels whose front and rear ones coincide. All quantities are per mass of the base, so only its radius of gyration and
its centre of mass matter.

There is no closed form. The results are tabulated over speeds and turning rates for `Coast`, and the tables are cached
in a folder of the user: see `kept`.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from graceful_plan import disk_cache
from graceful_plan.array_types import Array, Float
from graceful_plan.mobile.coast.constants import CoastSettings
from graceful_plan.mobile.coast.steering import MOTORS, TICK, OneSideSteering
from graceful_plan.scene.mobile.diff_drive import DiffDrive

_METHOD = 1
"""Version of the integration; change it together with anything that changes the cached tables."""
SAMPLES = 40
"""Number of places along each trajectory."""
_SPEEDS, _RATES = 8, 9
_GRAVITY = 9.81
_STEP = 0.004
_AFTER = 0.5
"""Time for which places are kept after the last rim has stopped [s]."""
_KEPT = round(TICK / _STEP)
"""Integration steps between stored places, and between commands."""
_SMOOTH = 0.04
"""Sliding speed at which friction is 70 % of its maximum [m/s]."""
_LEAST_ROTOR = 0.02


@dataclass(frozen=True, kw_only=True)
class BaseBody:
    """Parameters of a sliding base.

    Args:
        base: Drive parameters.
        mass: Mass of the base and everything that moves with it [kg].
        gyration: Radius of gyration about the vertical axis through the centre of mass [m].
        centre: Centre of mass in the frame of the base joints [m].
        middle: Centre of the driven wheels in the same frame [m].
    """

    base: DiffDrive
    mass: float
    gyration: float
    centre: tuple[float, float]
    middle: tuple[float, float] = (0.0, 0.0)


class Ways(NamedTuple):
    """Tabulated trajectories of bases after a one-sided failure.

    | field  | meaning                                                              | shape                     |
    |--------|----------------------------------------------------------------------|---------------------------|
    | share  | probability of each table                                            | table                     |
    | speeds | speed along the heading at the failure, from 0 [m/s]                 | speed                     |
    | rates  | turning rate at the failure [rad/s]                                  | rate                      |
    | places | x, y, angle turned in the frame of the base at the failure; speed of | speed rate table sample 5 |
    |        | its fastest point [m/s]; time [s]                                    |                           |
    """

    share: Float[Array, " table"]
    speeds: Float[Array, " speed"]
    rates: Float[Array, " rate"]
    places: Float[Array, "speed rate table sample 5"]


class Case(NamedTuple):
    """Parameters of one-sided failures; arrays broadcast with the shape of the states."""

    left: Array
    """Whether the left side fails."""
    held: Array
    """Whether the wheels of the failed side are locked; otherwise they turn freely."""
    friction: Array
    """Friction coefficient of the tyres."""
    rolling: Array
    """Deceleration of the base if all wheels turned freely [m/s^2]."""
    drag: Array
    """Additional deceleration per speed [1/s]."""
    delay: Array
    """Time for which the working side goes on [s]."""
    brakes: float
    """Deceleration of its rims after the delay [m/s^2]."""
    steered: Array = np.array(False)
    """Whether a controller steers it during the delay."""


@lru_cache(maxsize=8)
def one_sided_trajectories(body: BaseBody, settings: CoastSettings) -> Ways:
    """Tabulate the trajectories after all one-sided failures of the settings; without any, the tables are empty."""
    base, found = body.base, settings.one_sided()
    speeds = np.linspace(0.0, base.v_max, _SPEEDS)
    rates = np.linspace(-base.omega_max, base.omega_max, _RATES)
    if not found:
        return Ways(np.zeros(0), speeds, rates, np.zeros((len(speeds), len(rates), 0, SAMPLES, 5)))
    rows = [
        (left, way.wheels == "side_locked", a / _GRAVITY if way.wheels == "side_locked" else settings.friction, a,
         way.drag, delay, way.steered)
        for _, way, a, delay in found
        for left in (True, False)
    ]  # fmt: skip
    left, held, friction, rolling, drag, delay, steered = (np.array(column) for column in zip(*rows, strict=True))
    case = Case(left, held, friction, rolling, drag, delay=delay, brakes=settings.brakes, steered=steered)
    share = np.repeat([0.5 * p for p, *_ in found], 2)
    digest = hashlib.sha256(repr((_METHOD, SAMPLES, body, rows, settings.brakes)).encode()).hexdigest()
    places, shape = disk_cache.read(digest), (len(speeds), len(rates), len(rows))
    if places is None or places.shape != (*shape, SAMPLES, 5) or not np.isfinite(places).all():
        v, omega = np.broadcast_to(speeds[:, None, None], shape), np.broadcast_to(rates[None, :, None], shape)
        ways = integrated(body, v, omega, case)
        ways[..., 3] = _fastest(ways, base)
        places = resampled(ways, _reach(base), SAMPLES)
        disk_cache.write(digest, places)
    return Ways(share, speeds, rates, places)


def integrated(
    body: BaseBody, v: Float[Array, "*batch"], omega: Float[Array, "*batch"], case: Case
) -> Float[Array, "*batch time 5"]:
    """Integrate one-sided failures.

    Args:
        body: Parameters of the base.
        v: Speed along the heading at the failure [m/s].
        omega: Turning rate at the failure [rad/s].
        case: Parameters of the failures.

    Returns:
        x, y [m] and angle turned [rad] in the frame of the base at the failure; speed of its origin [m/s]; time [s].
    """
    base, batch = body.base, np.shape(v)
    v, omega = np.atleast_1d(v, omega)
    (cx, cy), (mx, my) = body.centre, body.middle
    side = np.array([1.0, 1.0, -1.0, -1.0])
    x = mx + 0.5 * base.wheel_base * np.array([1.0, -1.0, 1.0, -1.0])
    y = my + 0.5 * base.track * side
    broken = np.where(np.asarray(case.left)[..., None], side > 0.0, side < 0.0)
    held, free = broken & np.asarray(case.held)[..., None], broken & ~np.asarray(case.held)[..., None]
    grip = np.asarray(case.friction)[..., None] * _GRAVITY * base.load / 4.0
    rotor = max(base.rotor / (base.radius**2 * body.mass) * _wheels(base) / 4.0, _LEAST_ROTOR)
    weight = 1.0 + 4.0 * rotor
    rolling, drag = (np.asarray(value)[..., None] * weight / 4.0 for value in (case.rolling, case.drag))
    rim = v[..., None] - side * base.lever * omega[..., None]
    drive, rim = _Drive(case, rim, OneSideSteering(base, v, omega)), np.where(held, 0.0, rim)
    lasts = float(np.max(case.delay) + np.abs(drive.told).max() / case.brakes) + _AFTER
    vx, vy, w = v - omega * cy, omega * cx, omega.astype(float)
    px, py, turned = np.zeros_like(w), np.zeros_like(w), np.zeros_like(w)
    kept = []
    for step in range(int(lasts / _STEP) + 1):
        c, s = np.cos(turned), np.sin(turned)
        if step % _KEPT == 0:
            ox, oy = px + cx - (c * cx - s * cy), py + cy - (s * cx + c * cy)
            speed = np.hypot(vx + w * cy, vy - w * cx)
            kept.append(np.stack([ox, oy, turned, speed, np.full_like(w, step * _STEP)], axis=-1))
            drive.tell(step * _STEP, (ox, oy, turned), w, rim)
        rim = np.where(broken, rim, drive.going(step * _STEP, rim))
        sx, sy = vx[..., None] - w[..., None] * (y - cy) - rim, vy[..., None] + w[..., None] * (x - cx)
        share = grip / np.sqrt(sx**2 + sy**2 + _SMOOTH**2)
        fx, fy = -share * sx, -share * sy
        gears = (rolling + drag * np.abs(rim)) * np.tanh(rim / _SMOOTH)
        rim = np.where(free, rim + _STEP * (-fx - gears) / (rotor + _STEP * (share + rolling / _SMOOTH)), rim)
        ax, ay = fx.sum(axis=-1), fy.sum(axis=-1)
        alpha = ((x - cx) * fy - (y - cy) * fx).sum(axis=-1) / body.gyration**2
        vx, vy = vx + _STEP * (ax + w * vy), vy + _STEP * (ay - w * vx)
        w = w + _STEP * alpha
        px, py, turned = px + _STEP * (c * vx - s * vy), py + _STEP * (s * vx + c * vy), turned + _STEP * w
    return np.stack(kept, axis=-2).reshape(*batch, len(kept), 5)


@dataclass(eq=False)
class _Drive:
    """Rim speeds of the working side.

    Args:
        case: Parameters of the failures.
        told: Commanded rim speeds, initially the actual ones [m/s].
        steering: Controller that commands them.
    """

    case: Case
    told: Float[Array, "*batch wheel"]
    steering: OneSideSteering

    def tell(self, time: float, pose: tuple[Array, Array, Array], rate: Array, rim: Array) -> None:
        """Update the commands of steered cases whose delay is not over; see `OneSideSteering`."""
        asked = np.asarray(self.case.steered) & (time <= np.asarray(self.case.delay))
        if asked.any():
            told = self.steering.tell(time, pose, rate, (rim[..., 0], rim[..., 2]))
            self.told = np.where(asked[..., None], np.repeat(np.stack(told, axis=-1), 2, axis=-1), self.told)

    def going(self, time: float, rim: Float[Array, "*batch wheel"]) -> Float[Array, "*batch wheel"]:
        """Return the commanded rim speeds after a step [m/s]; steered ones change within the limits of the motors."""
        late = np.maximum(0.0, time - np.asarray(self.case.delay))[..., None]
        going = np.sign(self.told) * np.maximum(0.0, np.abs(self.told) - self.case.brakes * late)
        faster = MOTORS * self.steering.base.a_max * _STEP
        return np.where(np.asarray(self.case.steered)[..., None], rim + np.clip(going - rim, -faster, faster), going)


def resampled(places: Float[Array, "*batch time 5"], reach: float, count: int) -> Float[Array, "*batch count 5"]:
    """Resample trajectories so that the farthest point of the base moves equally far between successive places."""
    flat = places.reshape(-1, *places.shape[-2:])
    step = np.hypot(*np.moveaxis(np.diff(flat[..., :2], axis=1), -1, 0)) + reach * np.abs(np.diff(flat[..., 2], axis=1))
    moved = np.concatenate([np.zeros((len(flat), 1)), np.cumsum(step, axis=1)], axis=1)
    out = np.empty((len(flat), count, 5))
    for row, (place, s) in enumerate(zip(flat, moved, strict=True)):
        # After one full turn the base sweeps the same area again.
        most = s[np.searchsorted(np.abs(place[:, 2]), 2.0 * np.pi)] if np.abs(place[-1, 2]) > 2.0 * np.pi else s[-1]
        at = np.linspace(0.0, most, count)
        out[row] = np.stack([np.interp(at, s + 1e-12 * np.arange(len(s)), place[:, k]) for k in range(5)], axis=-1)
    return out.reshape(*places.shape[:-2], count, 5)


def _fastest(places: Float[Array, "*batch time 5"], base: DiffDrive) -> Float[Array, "*batch time"]:
    """Return the speed of the outermost point of a spinning base, which is the one that hits [m/s]."""
    turned, speed = places[..., 2], places[..., 3]
    return speed + _reach(base) * np.abs(np.diff(turned, axis=-1, append=turned[..., -1:])) / TICK


def _wheels(base: DiffDrive) -> int:
    return len(base.wheels) or (4 if base.wheel_base > 0.0 else 2)


def _reach(base: DiffDrive) -> float:
    return float(np.hypot(0.5 * base.track, 0.5 * base.wheel_base)) + base.radius
