r"""What a base does that fails while it drives: it goes on along its arc for a while, and meets what is there.

A base at speed v and rate of turning :math:`\omega` goes on along the arc of curvature :math:`\omega / v`. Ways to come
to rest differ by deceleration a, drag k and delay T; it goes

.. math:: D = |v| T + |v| / k - (a / k^2) \ln(1 + k |v| / a), \qquad D = |v| T + v^2 / 2a \text{ where } k = 0

far. After a way s it still has the share :math:`e = \min(1, 1 - (s - |v| T) / (D - |v| T))` of its energy, which is
what severities are worth: :math:`\min(1, e v^2 / u^2)`, with u the speed that they are for. From above, the base is a
row of discs; whether one of them touches a shape at a distance d is uncertain by :math:`\sigma(s)`: the position
spread, and the drift times s. With the probabilities :math:`p_i` of the ways,

.. math:: P = \max_s \Phi\left(-\frac{d(s)}{\sigma(s)}\right) B(s) \sum_i p_i \min(1, e_i(s) v^2 / u^2)

where B is the probability that no obstacle has stopped it before. P is the probability of a hit, times the share of the
severity that its energy is worth. What one side does that is locked alone, ramps, and what the base pushes along
are not modelled. No constant is fitted: `coast.yaml` says where they come from.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import final

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.core import _native
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import ImpactKernel
from graceful_plan.costs.cost import StateBatch
from graceful_plan.costs.models.coast.constants import CoastSettings
from graceful_plan.costs.models.coast.tables import CoastTables, coast_tables
from graceful_plan.costs.native_model import NativeModel, OwnLoss
from graceful_plan.scene.scene import Scene

Array = np.ndarray

SPACING, SAMPLES = 0.1, 64
"""Between places along the way of a failing base at which is seen what it meets [m], and how many of them at most."""
_STILL = 1e-6
"""Speed below which a base stands [m/s]."""


@final
@dataclass(frozen=True)
class Coast(NativeModel):
    """P that a failing base hits each entity; of a robot without a `DiffDrive` nobody fears it.

    Args:
        settings: Constants; the shipped ones by default.
    """

    settings: CoastSettings = field(default_factory=CoastSettings.shipped)

    @property
    def components(self) -> tuple[str, ...]:
        """The body alone: what it carries falls by the drop model."""
        return ("body",)

    def probability(self, batch: StateBatch) -> Float[Array, "n component entity"]:
        """Return P of a hit, times what its energy is worth."""
        scene = batch.scene
        P = np.zeros((len(batch), len(scene.components), len(scene.entities)))
        if scene.base is not None and P.size:
            P[:, list(scene.components).index("body")] = _hits(batch, coast_tables(scene), self.settings)
        return P

    def kernel(
        self,
        scene: Scene,
        severity: Float[Array, "component entity"],
        paces: tuple[float, float],
        own: OwnLoss | None = None,
    ) -> ImpactKernel | None:
        """Return the native kernel; nobody is in it if the robot does not drive."""
        del own
        kernels = compile_scene(scene).kernels
        if scene.base is None:
            return kernels.overlap(np.zeros_like(severity))
        tables, s = coast_tables(scene), self.settings
        native = _native.CoastImpact(
            kernels.core,
            disc=_reals(tables.disc),
            entity=np.ascontiguousarray(tables.entity, dtype=np.int32),
            shape=_reals(tables.shape),
            stops=_reals(s.stops),
            constants=_reals([s.reference_speed, s.position_spread, s.drift]),
            severity=_reals(severity[list(scene.components).index("body")]),
            speed=_reals(scene.limits.velocity),
            slow=paces[0],
            fast=paces[1],
        )
        return ImpactKernel(kernels, native)

    def gradients(
        self, batch: StateBatch, severity: Float[Array, "component entity"], own: OwnLoss | None = None
    ) -> tuple[Float[Array, "n nq"], Float[Array, "n nq"]] | None:
        """Return derivatives with respect to q and to the joint velocities, by differences in the core."""
        del own
        kernel = self.kernel(batch.scene, severity, (1.0, 1.0))
        return None if kernel is None else kernel.state_slopes(batch.q, batch.qd)[1:]


def _hits(batch: StateBatch, tables: CoastTables, settings: CoastSettings) -> Float[Array, "n entity"]:
    """Return P for each entity, as the core does."""
    from scipy.special import erfc

    q, qd = batch.q[:, :3], batch.qd[:, :3]
    c, s = np.cos(q[:, 2]), np.sin(q[:, 2])
    v = qd[:, 0] * c + qd[:, 1] * s
    p, a, k, delay = settings.stops.T
    speed = np.abs(v)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        dragged = speed / k - a / k**2 * np.log1p(k * speed / a)
    free, braked = speed * delay, np.where(k > 0.0, dragged, speed**2 / (2.0 * a))
    far = (free + braked).max(axis=1)
    places = min(SAMPLES, 1 + int(np.ceil(far.max(initial=0.0) / SPACING)))
    way = np.minimum(far[:, None], SPACING * np.arange(places))
    # What is touched at a place may have been met anywhere since the place before.
    met = np.concatenate([way[:, :1], 0.5 * (way[:, :-1] + way[:, 1:])], axis=1)
    left = 1.0 - (met[:, :, None] - free[:, None]) / np.maximum(braked, 1e-12)[:, None]
    worth = np.clip(left, 0.0, 1.0) * (speed**2)[:, :, None] / settings.reference_speed**2
    energy = (p * np.minimum(1.0, worth)).sum(axis=2)
    # Along the arc: by the mean heading, over the length of the chord.
    moves, sign = np.abs(v) > _STILL, np.sign(v)[:, None]
    turned = sign * way * (np.where(moves, qd[:, 2], 0.0) / np.where(moves, v, 1.0))[:, None]
    chord = sign * way * np.sinc(0.5 * turned / np.pi)
    middle, heading = q[:, 2:3] + 0.5 * turned, q[:, 2:3] + turned
    x, y = q[:, 0:1] + chord * np.cos(middle), q[:, 1:2] + chord * np.sin(middle)
    ch, sh = np.cos(heading), np.sin(heading)
    d = np.full((len(q), places, len(tables.shape)), np.inf)
    for bx, by, r in tables.disc:
        at = np.stack([x + ch * bx - sh * by, y + sh * bx + ch * by])
        d = np.minimum(d, _distance(at, tables.shape) - r)
    spread = np.hypot(settings.position_spread, settings.drift * way)[..., None]
    touch = 0.5 * erfc(d / spread / np.sqrt(2.0))
    wall = touch[:, :, tables.entity < 0].max(axis=2, initial=0.0)
    stopped = np.maximum.accumulate(wall, axis=1)
    reached = (energy * (1.0 - stopped))[..., None] * touch
    P = np.zeros((len(q), len(batch.scene.entities)))
    for k_, entity in enumerate(tables.entity.tolist()):
        if entity >= 0:
            P[:, entity] = np.maximum(P[:, entity], reached[:, :, k_].max(axis=1))
    return P


def _distance(at: Float[Array, "2 n s"], shape: Float[Array, "shape 7"]) -> Float[Array, "n s shape"]:
    """Signed distance of points to rounded rectangles; inside of a rectangle minus the way to its nearest side."""
    ux, uy = shape[:, 2], shape[:, 3]
    dx, dy = at[0][..., None] - shape[:, 0], at[1][..., None] - shape[:, 1]
    ex, ey = np.abs(ux * dx + uy * dy) - shape[:, 4], np.abs(-uy * dx + ux * dy) - shape[:, 5]
    outside = np.hypot(np.maximum(ex, 0.0), np.maximum(ey, 0.0))
    return outside + np.minimum(np.maximum(ex, ey), 0.0) - shape[:, 6]


def _reals(values: object) -> Float[Array, "..."]:
    return np.ascontiguousarray(values, dtype=np.float64)
