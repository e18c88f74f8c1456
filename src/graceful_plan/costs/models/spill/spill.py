r"""The spill model: whom contents reach if their container is dropped here, or if they get out of it in the gripper.

Contents leave over the rim, come down on something, run out to a puddle as deep as surface tension lets it be (dry
contents to a heap), reach what stands in it, and run over the edges of what carries it to what is below. What the drop
model says about where the container comes down serves for both uses, `USES`: contents that get out in the gripper come
down on the same things, at a less certain place.

"dropped" is P(contents reach the entity | the gripper lets go); a soft landing spills nothing. "held" is P(contents
reach the entity | contents get out while the gripper holds). How likely that is does not show in the state (fits to
speed and tilt explain less than 1 % of the variance), so it is left to the prior over faults.

Hot contents: severities have columns for hot contents already, so that nothing here depends on the temperature.

Specification
-------------
Symbols, functions and the drop model's results as in `footprint.py`; F_l, M_l: sums over a level; tc_l: tc of its
first target; Z_l: its top. Constants, for each use: `SpillConstants`. Tables: `SpillTables`.

.. code-block:: text

    Contents
      o = R mouth;  m = c + o;  vm = v + w x o;  sm2 = vmx^2 + vmy^2;  z = (R axis)_z;  p = (z + sqrt(z^2 + 0.01))/2
      lean = max(0, sqrt(1.0051 - p^2)/p - repose) + kv sqrt(sm2 + 1e-4);  x = r lean/H
      fill = (1 + x + x^2 + 1.7 x^3)/full        what it could hold at this tilt is 1/fill of what was in it
      rho = R (1 + fill^4)^(-power/4)            radius of a puddle of what is in it
      s = sqrt(s0^2 + (cr r)^2 + cv^2 sm2 + (ch hs)^2)

    Down the levels, with O = 0, o = (0, 0): P that something has run over an edge, and that times where it is, from m
      u = sqrt(vz^2 + 2 g pos(low - Z_l));  q = S((u - u0)/us);  a = F_l q + M_l (1 - q)
      L = vm (tc_l + kt)
      A_k = a box(x, a' + km, s) box(y, b' + km, s)                  at m + L - (X, Y);  a', b' half sizes
      i_k = visible box(x, a' + ko rho, s) box(y, b' + ko rho, s)    at m + o/(O + 1e-6) - (X, Y);  B_k = O i_k
      g = product over the level of 1 - i_k
      U_l = a + O (1 - g);  W_l = a L + O (1 - g) o/(O + 1e-6)
      j_k = box(x, a' - ke R, s) box(y, b' - ke R, s)                at m + W_l/(U_l + 1e-6) - (X, Y); 0 unless
                                                                     a' and b' exceed ke R
      h = product over the level of 1 - j_k;  O <- O g + U_l h;  o <- o g + W_l h

    What stands in the puddle
      U, W = sums of U_l, W_l over the levels that target k stands on or beside
      D_k = min(1, U) box(x, a' + kr rho, s) box(y, b' + kr rho, s)  at m + W/(U + 1e-6) - (X, Y)

    Together: P_k = 1 - (1 - A_k)(1 - B_k)(1 - D_k);  P(entity) = max over its targets, 0 if it has none

The volume that a tilted cylinder holds is a wedge; 1/(1 + x + x^2 + 1.7 x^3) is within 0.03 of it, in shares of what
it holds upright.

References:
    Depth of a puddle: capillary length and contact angle, de Gennes, Brochard-Wyart, Quéré, "Capillarity and Wetting
    Phenomena", 2004. The rest: own work, fitted to FailBench; see the head of `spill.yaml`.
"""

from __future__ import annotations

from typing import NamedTuple, final

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.costs.cost import StateBatch
from graceful_plan.costs.models.drop.constants import FootprintConstants
from graceful_plan.costs.models.drop.drop import LEAST_MASS, Landing, Release, land, release
from graceful_plan.costs.models.drop.functions import GRAVITY, box, positive, step
from graceful_plan.costs.models.drop.tables import FootprintTables
from graceful_plan.costs.models.spill.constants import SpillConstants
from graceful_plan.costs.models.spill.tables import SpillTables

Array = np.ndarray


@final
class Poured(NamedTuple):
    """What a spill depends on besides the constants of its use.

    | field    | meaning                                                     | unit | shape       |
    |----------|-------------------------------------------------------------|------|-------------|
    | landing  | where the container would come down                         |      |             |
    | mouth    | m: the middle of the contents' top                          | m    | n 3         |
    | velocity | vm: its velocity                                            | m/s  | n 3         |
    | up       | z: cosine of the container's tilt                           |      | n 1         |
    | falling  | vz: vertical velocity of the object's centre of mass        | m/s  | n 1         |
    """

    landing: Landing
    mouth: Float[Array, "n 3"]
    velocity: Float[Array, "n 3"]
    up: Float[Array, "n 1"]
    falling: Float[Array, "n 1"]


def pour(batch: StateBatch, tables: FootprintTables, spill: SpillTables, constants: FootprintConstants) -> Poured:
    """Return what spills depend on, for a scene with something to land on."""
    state: Release = release(batch, tables)
    R = batch.link_poses[:, tables.link, :3, :3]
    offset = R @ spill.mouth
    return Poured(
        landing=land(tables, constants, state),
        mouth=state.c + offset,
        velocity=state.v + np.cross(state.w, offset),
        up=(R @ spill.axis)[:, 2:],
        falling=state.v[:, 2:],
    )


def spread_out(
    tables: FootprintTables, spill: SpillTables, constants: SpillConstants, poured: Poured
) -> Float[Array, "n target"]:
    """Return P that contents reach each target."""
    k, place = constants, _Places(tables, poured.mouth)
    speed2 = (poured.velocity[:, :2] ** 2).sum(axis=1, keepdims=True)
    rho = _radius(spill, k, poured.up, speed2)
    s = k.position_spread**2 + (k.rim_spread * spill.rim) ** 2 + k.speed_spread**2 * speed2
    s = np.sqrt(s + (k.height_spread * poured.landing.fallen) ** 2)
    arrives, L = _arrivals(tables, k, poured)
    n, (a, b) = len(L), tables.target_half.T
    A, B = np.zeros((n, len(a))), np.zeros((n, len(a)))
    mass, o, U, W = np.zeros((n, 1)), np.zeros((n, 2)), [], []  # mass: O
    inner = spill.radius * k.edge
    for level, (first, last) in enumerate(zip(tables.level_start[:-1], tables.level_start[1:], strict=True)):
        here, come = slice(first, last), arrives[:, level, None]
        x, y = place(L[:, level, None], here)
        A[:, here] = come * box(x, a[here] + k.margin, s) * box(y, b[here] + k.margin, s)
        flows = o / (mass + LEAST_MASS)
        x, y = place(flows[:, None], here)
        onto = spill.visible[here] * box(x, a[here] + k.run_off * rho, s) * box(y, b[here] + k.run_off * rho, s)
        B[:, here] = mass * onto
        past = np.prod(1.0 - onto, axis=1, keepdims=True)
        U.append(come + mass * (1.0 - past))
        W.append(come * L[:, level] + mass * (1.0 - past) * flows)
        x, y = place((W[-1] / (U[-1] + LEAST_MASS))[:, None], here)
        wide = np.minimum(a[here], b[here]) > inner
        over = np.prod(1.0 - wide * box(x, a[here] - inner, s) * box(y, b[here] - inner, s), axis=1, keepdims=True)
        mass, o = mass * past + U[-1] * over, o * past + W[-1] * over
    D = _standing(tables, spill, place, np.concatenate(U, axis=1), np.stack(W, axis=1), k.reach * rho, s)
    return 1.0 - (1.0 - A) * (1.0 - B) * (1.0 - D)


def _radius(spill: SpillTables, k: SpillConstants, up: Array, speed2: Array) -> Float[Array, "n 1"]:
    """Rho: the radius of a puddle of what is in the container."""
    up = 0.5 * (up + np.sqrt(up * up + 0.01))  # above 0, and below the root of 1.0051
    lean = np.maximum(np.sqrt(1.0051 - up * up) / up - spill.repose, 0.0) + k.slosh * np.sqrt(speed2 + 1e-4)
    x = spill.rim * lean / spill.depth
    fill = (1.0 + x + x * x + 1.7 * x**3) / spill.full
    return spill.radius * (1.0 + fill**4) ** (-0.25 * spill.power)


def _arrivals(tables: FootprintTables, k: SpillConstants, poured: Poured) -> tuple[Array, Array]:
    """Return a [n level] and L [n level 2]."""
    landing = poured.landing
    top = tables.target_height[tables.level_start[:-1], 1]
    u = np.sqrt(poured.falling**2 + 2.0 * GRAVITY * positive(landing.low - top))
    hard = step((u - k.soft_speed) / k.soft_spread)
    time = (landing.times + k.carry)[..., None]
    arrives = landing.mass * hard + landing.leaving * (1.0 - hard)
    return arrives, poured.velocity[:, None, :2] * time


def _standing(
    tables: FootprintTables, spill: SpillTables, place: _Places, U: Array, W: Array, reach: Array, s: Array
) -> Float[Array, "n target"]:
    """D: P that contents reach what stands where they are."""
    sums = np.cumsum(np.concatenate([np.zeros((len(U), 1)), U], axis=1), axis=1)
    weighed = np.cumsum(np.concatenate([np.zeros((len(W), 1, 2)), W], axis=1), axis=1)
    first, end = spill.stands.T
    U, W = sums[:, end] - sums[:, first], weighed[:, end] - weighed[:, first]
    x, y = place(W / (U + LEAST_MASS)[..., None], slice(None))
    a, b = tables.target_half.T
    return np.minimum(U, 1.0) * box(x, a + reach, s) * box(y, b + reach, s)


@final
class _Places:
    """Puts points [n target 2] or [n 1 2], seen from m in W, into the axes of some targets, seen from above."""

    def __init__(self, tables: FootprintTables, mouth: Float[Array, "n 3"]) -> None:
        self._mouth, self._centre, self._axis = mouth[:, None, :2], tables.target_centre, tables.target_axis

    def __call__(self, point: Array, here: slice) -> tuple[Array, Array]:
        away, (c, n) = self._mouth + point - self._centre[here], self._axis[here].T
        return c * away[..., 0] + n * away[..., 1], c * away[..., 1] - n * away[..., 0]
