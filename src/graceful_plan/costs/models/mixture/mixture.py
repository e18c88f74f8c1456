r"""The drop model: whom the carried object hits if the gripper lets go here, at this velocity.

A drop is told in four steps, each with smooth formulas of its own, so that the result has a gradient nearly everywhere:

1. *First contact.* The object flies on: ballistics from the velocity of its centre of mass, each part with the velocity
   of the turning tool at its place. A part meets a target if, when it is down at the target's top, the two overlap
   seen from above. Shapes are octagons (a box in the target's axes and one turned by 45 degrees) at uncertain places.
2. *Support.* Where the first contact carries the object, under or beside its centre of mass, and how wide compared
   with the height of that centre, tells whether it stays there.
3. *Falls.* What does not stay moves off, away from its support and along its velocity, and comes down on something
   lower; wide tops under its path catch it, the rest goes on.
4. *Side contacts.* On its way to rest it sweeps into what stands beside the place where it comes down.

`Footprint` is this for what is carried; `spill.py` for contents, of a container that is dropped or still held; and
`body.py` for an arm that fails. A prior over faults (`FaultPrior`) says how much each of these weighs.

Specification
-------------
Everything is in double precision, z is up, g = 9.81. Tables: `FootprintTables`. Constants: `FootprintConstants`; those
named below carry the symbols given there. The native kernel follows this text operation by operation.

.. code-block:: text

    Functions
      S(u)       = 1/(1 + exp(-e(u/beta)))        beta = sqrt(3)/pi: logistic, standard deviation 1; e clamps to +-300
      box(x,A,s) : A <- max(A, 1e-4);  f = exp(e((x-A)/(s beta)));  h = exp(e(-(x+A)/(s beta)))
                   (1 - f h)/((1 + f)(1 + h))     = P(|x + noise| < A) for logistic noise of standard deviation s
      fall(h)    = (vz + sqrt(vz^2 + 2 g k))/g,   k = (h + sqrt(h^2 + 0.01^2))/2
      pos(x)     = (x + sqrt(x^2 + 0.01^2))/2

    Object (R, p: pose of the link; qd: joint velocities)
      c = R centre + p;  over the joints that move it: hinges w = sum qd_j z_j, v = sum qd_j (z_j x (c - p_j)),
      slides add qd_j z_j to v;  z_j, p_j: third axis and place of the joint's link
      part: o = R offset, axes Q = R rotation (columns); reach(u), u a unit vector:
        FLAT  sum_i |Q_i . u| h_i
        ROUND |Q_2 . u| h_2 + h_0 sqrt(max(1e-12, 1 - (Q_2 . u)^2))
        BALL  h_0
      bottom_p = c_z + o_z - reach(z);  low = min bottom_p;  high = max (c_z + o_z + reach(z));  hh = c_z - low
      m = squared z components of the main part's axes; FLAT (m0, m1, m2), ROUND (m0 + m1, m2), BALL (1)
      tilt = 1 - sum of the squares of these;  sp2 = vx^2 + vy^2;  sp = sqrt(sp2 + 1e-4)

    1. First contact: target k with centre (X, Y), axis (cos, sin), half sizes (a, b), diagonal d, top Z; x is along the
       axis, y to its left
      t = fall(bottom_p - Z);  s = sqrt(s0^2 + (sv t)^2)
      (x, y) = (c + o - (X, Y)) + (v + w x o)(t + delay), turned into the target's axes
      D_p = box(x, a + rx, s) box(y, b + ry, s) box((x+y)/sqrt2, d + r1, s) box((y-x)/sqrt2, d + r2, s)
            S((bottom_p - Z)/0.008 + 1)         with the part's reaches rx, ry, r1, r2 in these four directions
      D = max over parts
      per level l (targets whose tops are within LEVEL of its highest), from the highest down:
        A_l = product of (1 - D) over all targets of higher levels;  U_l = 1 - product of (1 - D) over the level
      C_k = A_l D_k                                    part of the first contact; several targets may be at once
      F_k = A_l U_l D_k/(sum of D over the level + 1e-6)      first impact, shared; sum over all targets <= 1
      tc_k = fall(low - Z) + delay
      total = sum F + 1e-6;  zs = sum F Z/total;  tl = sum F tc/total;  hs = sum F max(low - Z, 0)/total

    2. Support (a', b': what of the top carries), per target and part, in the target's axes relative to c
      (X', Y') = (c - (X, Y)) + v tc_k;  weight = exp(-((bottom_p - low)/0.012)^2)
      x from max(ox - rx, -a' - X') to min(ox + rx, a' - X'), y likewise; widths wx, wy >= 0; area = weight wx wy
      centre (mx, my) of that rectangle; second moments mx^2 + wx^2/12, my^2 + wy^2/12, mx my; all turned into W
      per level: S0 = sum area + 1e-6;  E = sum area (centre)/S0;  V = sum area (second moments)/S0 - E E^T + 1e-5 I
      det = max(Vxx Vyy - Vxy^2, 1e-11);  d2 = (Vyy Ex^2 - 2 Vxy Ex Ey + Vxx Ey^2)/det;  off = d2/(3 + d2)
      narrow = det/(Vxx + Vyy)
      T_l = S(g0 + 2 gd (off - 1/2) + gt/2 ln((hh^2 + 1e-6)/(3 narrow)) + gv sp + 2 gti tilt)      P(it does not stay)
      n_l = -off E/sqrt(Ex^2 + Ey^2 + 1e-6)                                     where to
      M_k = F_k T_l

    3. Falls; L = c + v tl is where it comes down
      sd = sqrt(s0^2 + (sv tl)^2 + (ch hs)^2 + cv^2 sp2 + (ct size)^2);  B = 0, N = (0, 0)
      levels from the highest down:
        (x, y) = L + ks v + drift size N/(B + 1e-6) - (X, Y), turned into the target's axes
        G_k = B box(x, a + kb size, sd) box(y, b + kb size, sd)
        keep = product over the level of 1 - catch box(x, pos(a' + kc size), sd) box(y, pos(b' + kc size), sd)
        B <- B keep + sum of M over the level;  N <- N keep + n_l times that sum

    4. Side contacts
      Tm = sum M/total;  n = sum M n_l/total
      from x0 = (c - (X, Y)) + v tc_k to x1 = L - (X, Y) + ksl v + drift size n, both turned into the target's axes
      sl = sqrt(s0^2 + (sv tl)^2 + (ch hs)^2 + (cl size)^2 + (ct size Tm)^2);  r = (kl + tk Tm) size
      per axis: box((x0 + x1)/2, a + sqrt((x1 - x0)^2 + 1e-6)/2 + r, sl), y with b
      H_k = max(0, sum of F over this level and lower ones - C_k) S((zs + high - low - bottom_k)/sh) times these two

    Together: P_k = 1 - (1 - C_k)(1 - G_k)(1 - H_k);  P(entity) = max over its targets, 0 if it has none

References:
    Own work, fitted to rollouts in MuJoCo; see the head of `footprint.yaml`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import reduce
from operator import add
from typing import final

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import ImpactKernel
from graceful_plan.costs.cost import AHEAD, StateBatch
from graceful_plan.costs.fault_prior import FaultPrior
from graceful_plan.costs.models.body.body import BodyModel
from graceful_plan.costs.models.body.constants import GENERATORS, BodySettings
from graceful_plan.costs.models.body.tables import ROWS as HOLDING
from graceful_plan.costs.models.drop.constants import FootprintSettings
from graceful_plan.costs.models.drop.drop import Drop, release, simulate
from graceful_plan.costs.models.drop.kernel import ROWS, footprint_kernel
from graceful_plan.costs.models.drop.tables import footprint_tables
from graceful_plan.costs.models.moving.model import MovingModel
from graceful_plan.costs.models.spill.constants import SpillSettings
from graceful_plan.costs.native_model import NativeModel
from graceful_plan.exceptions import SettingError
from graceful_plan.scene.elements import COMPONENTS
from graceful_plan.scene.scene import Scene

Array = np.ndarray

FALLING = ("carried", "contents")
"""Components that fall when the gripper lets go."""
_SOURCE = {"carried": (("carried", "drop"),), "contents": (("dropped", "drop"), ("held", "spill"))}
"""Rows of the drop kernel that strike as a component, and the generator behind each."""
_CHUNK = 200_000  # states times targets that are worked on at once


@final
@dataclass(frozen=True)
class Footprint(NativeModel):
    """What failures do, by models of drops, spills and failing arms: fast in the native core, details in NumPy.

    Args:
        faults: Which failures to fear, a prior or the name of a preset: "drop_only", the gripper lets go; "arm";
            "service_robot". Models of failing arms take much longer than those of drops and spills.
        settings: Constants of the drop model; the shipped ones by default.
        spill: Constants of the spill model; the shipped ones by default.
        body: Constants of the body model; the shipped ones by default.

    Raises:
        UnknownNameError: If there is no such preset.
    """

    faults: str | FaultPrior = "drop_only"
    settings: FootprintSettings = field(default_factory=FootprintSettings.shipped)
    spill: SpillSettings = field(default_factory=SpillSettings.shipped)
    body: BodySettings = field(default_factory=BodySettings.shipped)

    def __post_init__(self) -> None:
        if not isinstance(self.faults, str | FaultPrior):
            raise SettingError("faults", self.faults, "a FaultPrior or the name of a preset")
        _ = self.prior

    @property
    def prior(self) -> FaultPrior:
        """Which failures are feared."""
        return FaultPrior.preset(self.faults) if isinstance(self.faults, str) else self.faults

    @property
    def components(self) -> tuple[str, ...]:
        """The robot's body counts if there are failures of the arm to fear."""
        return COMPONENTS if self._arm_weights().any() else FALLING

    def probability(self, batch: StateBatch) -> Float[Array, "n component entity"]:
        """Return P of a contact, summed over all that may go wrong."""
        none = np.zeros((len(batch), len(batch.scene.components), len(batch.scene.entities)))
        return sum(self.sources(batch).values(), none)

    def sources(self, batch: StateBatch) -> Mapping[str, Float[Array, "n component entity"]]:
        """Return the same by generator, those that have a weight."""
        return {**self._gripper_sources(batch), **self._arm_sources(batch)}

    def fault_shares(self) -> Mapping[str, Mapping[str, float]]:
        """Return which faults are behind each of the sources, and how much they weigh."""
        return self.prior.fault_shares()

    def moving(self) -> MovingModel:
        """Return the model for entities that move, with the constants and weights of this one."""
        weights = self.prior.weights()
        return MovingModel(settings=self.settings, drop=weights["drop"], collapse=weights["collapse"])

    def kernel(
        self, scene: Scene, severity: Float[Array, "component entity"], paces: tuple[float, float]
    ) -> ImpactKernel:
        """Return the native kernel."""
        parts: list[ImpactKernel] = []
        rows = self._severities(scene, severity)
        if scene.carried is not None and rows.any():
            parts.append(footprint_kernel(scene, self.settings, self.spill).with_severity(rows, paces))
        weights = self._arm_weights()
        if weights.any() and severity.any():
            parts.append(BodyModel(self.body).kernel(scene, severity, weights, paces))
        if not parts:  # nothing can happen
            return compile_scene(scene).kernels.overlap(np.zeros_like(severity))
        return reduce(add, parts)

    def gradient(self, batch: StateBatch, severity: Float[Array, "component entity"]) -> Float[Array, "n nq"] | None:
        """Return the derivative of sums of P S, None where arms may fail."""
        found = self.gradients(batch, severity)
        return None if found is None else found[0]

    def gradients(
        self, batch: StateBatch, severity: Float[Array, "component entity"]
    ) -> tuple[Float[Array, "n nq"], Float[Array, "n nq"]] | None:
        """Return the derivatives with respect to q and to the joint velocities, None where there are none."""
        if self._arm_weights().any():
            return None
        if batch.scene.carried is None:
            return np.zeros_like(batch.q), np.zeros_like(batch.q)
        kernel = footprint_kernel(batch.scene, self.settings, self.spill)
        return kernel.gradient(batch.q, self._severities(batch.scene, severity), batch.qd)[1:]

    def widened(self, metres: float) -> Footprint | None:
        """Return a model whose objects fall from places that are uncertain by so much more, None if arms may fail."""
        if self._arm_weights().any():
            return None
        return replace(self, settings=self.settings.widened(metres), spill=self.spill.widened(metres))

    def drop(self, batch: StateBatch) -> Drop:
        """Return what becomes of the object, per target and per entity.

        Raises:
            ShapeError: If nothing is carried.
        """
        batch.object_poses  # noqa: B018  refuses a scene without a carried object
        tables = footprint_tables(batch.scene)
        constants = self.settings.of(tables.shape_class)
        size = max(1, _CHUNK // max(1, len(tables.target_entity)))
        chunks = [slice(i, i + size) for i in range(0, max(1, len(batch)), size)]
        parts = [simulate(tables, constants, release(batch, tables, rows)) for rows in chunks]
        first, contact, hit = (np.concatenate([getattr(p, k) for p in parts]) for k in ("first", "contact", "hit"))
        entity = np.zeros((len(batch), len(batch.scene.entities)))
        for k, owner in enumerate(tables.target_entity):
            if owner >= 0:
                np.maximum(entity[:, owner], hit[:, k], out=entity[:, owner])
        return Drop(first=first, contact=contact, hit=hit, entity=entity)

    def _gripper_sources(self, batch: StateBatch) -> dict[str, Float[Array, "n component entity"]]:
        """What comes of drops and of spills."""
        scene, weights = batch.scene, self.prior.weights()
        names = [name for name in ("drop", "spill") if weights[name] > 0.0]
        found = {name: np.zeros((len(batch), len(scene.components), len(scene.entities))) for name in names}
        if scene.carried is None or not len(batch) or not names:
            return found
        P = footprint_kernel(scene, self.settings, self.spill).probability(batch.q, batch.qd)
        for row, component in enumerate(scene.components):
            for own, source in _SOURCE.get(component, ()):
                if source in found:
                    found[source][:, row] += weights[source] * P[:, ROWS.index(own)]
        return found

    def _arm_sources(self, batch: StateBatch) -> dict[str, Float[Array, "n component entity"]]:
        """What comes of failing arms."""
        scene, weights = batch.scene, self._arm_weights()
        if not weights.any():
            return {}
        known = batch.ahead if np.isclose(self.body.step, AHEAD[0]) else None
        P = BodyModel(self.body).probability(batch, known)
        found: dict[str, Float[Array, "n component entity"]] = {}
        for g, name in enumerate(GENERATORS):
            if weights[g].any():
                found[name] = np.zeros((len(batch), len(scene.components), len(scene.entities)))
                for row, component in enumerate(scene.components):
                    if component in HOLDING:
                        k = HOLDING.index(component)
                        found[name][:, row] = weights[g, k] * P[:, g, k]
        return found

    def _arm_weights(self) -> Float[Array, "generator 2"]:
        """Weight of each of `GENERATORS` for the arm and for what it still holds."""
        weights, held = self.prior.weights(), self.prior.held_weights()
        return np.array([[weights[name], held[name]] for name in GENERATORS])

    def _severities(self, scene: Scene, severity: Float[Array, "component entity"]) -> Float[Array, "row entity"]:
        """Severities in the rows of the drop kernel, with their weights."""
        rows, weights = np.zeros((len(ROWS), severity.shape[1])), self.prior.weights()
        for own, component in zip(severity, scene.components, strict=True):
            for row, source in _SOURCE.get(component, ()):
                rows[ROWS.index(row)] = weights[source] * own
        return rows
