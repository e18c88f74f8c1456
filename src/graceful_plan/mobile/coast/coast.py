r"""What a base does that fails while it drives: it goes on along its arc for a while, and meets what is there.

A base at speed v and rate of turning :math:`\omega` goes on along the arc of curvature :math:`\omega / v`; a skid-steer
whose wheels are let go straightens: it turns by :math:`c \omega^2` at most, then goes straight on. Ways to come
to rest differ by deceleration a, drag k and delay T; it goes

.. math:: D = |v| T + |v| / k - (a / k^2) \ln(1 + k |v| / a), \qquad D = |v| T + v^2 / 2a \text{ where } k = 0

far. After a way s it still has the share :math:`e = \min(1, 1 - (s - |v| T) / (D - |v| T))` of its energy, which is
what severities are worth: :math:`\min(1, e v^2 / u^2)`, with u the speed that they are for. From above, the base is
what its geoms are, rectangles that may be rounded; whether one of them touches a shape at a distance d is uncertain by
:math:`\sigma(s)`: the position spread, and the drift times s. With the probabilities :math:`p_i` of the ways,

.. math:: P = \sum_i p_i \max_s \Phi\left(-\frac{d(s)}{\sigma(s)}\right) B(s) \min(1, n(s) e_i(s) v^2 / u^2)

where n is the share of the energy that is along the normal, from how fast the distance closes,
:math:`\max(0, -d'(s))^2`; where :math:`\sigma` is large beside the size r of who is met, nobody knows the normal, and
n goes to its mean of 1/2 with :math:`\sigma^2 / (\sigma^2 + r^2)`. B is the probability that no obstacle has stopped
the base before and nobody else has taken its energy, n of it. P is the probability of a hit, times the share of the
severity that its energy is worth. Bases of which one side fails go where `four_wheel` integrates them to, at tabulated
places; odometry that drifts bends the arc.

A base that errs in proportion about how far it goes (`astray`) does not leave its way at once: it follows it, ever
farther beside it, past all turns that no state tells. So its harm counts where it is done instead of where it began: as
likely as each other, it has been astray for times :math:`\tau` until somebody notices after T, and is

.. math:: \pm \kappa \ell^2 / 2 \text{ aside, turned by } \pm \kappa \ell, \qquad \ell = c\, v_{max} \tau

with pace c, and :math:`\kappa` what it misjudges of the speed of one side over the effective track. Whom it touches a
moment later, and not yet, it meets at the rate :math:`|v|\, d\Phi / ds`; P has that rate times :math:`p T`, n and the
energy. Along a way that adds up to how likely somebody beside it is met at all, at any speed; obstacles between keep
it off. Ramps, which scenes do not have, how who is grazed turns the base aside, and what it pushes along are not
modelled. Two constants are fitted, `harmless` and the pace c: `coast.yaml` says where they come from.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import final

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.core import _native
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import ImpactKernel, reals
from graceful_plan.costs.cost import StateBatch
from graceful_plan.costs.models.failing_base import FailingBase
from graceful_plan.costs.models.moving.model import MovingModel
from graceful_plan.costs.native_model import NativeModel, OwnLoss
from graceful_plan.mobile.coast.constants import CoastSettings
from graceful_plan.mobile.coast.native import coast_model
from graceful_plan.mobile.coast.thinned import thinned
from graceful_plan.mobile.coast.walkers import moving_coast
from graceful_plan.scene.scene import Scene

Array = np.ndarray


@final
@dataclass(frozen=True)
class Coast(NativeModel, FailingBase):
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
            native = coast_model(scene, self.settings)
            P[:, list(scene.components).index("body")] = native.probability(reals(batch.q), reals(batch.qd))
        return P

    @property
    def share(self) -> float:
        """P that it is the base that fails, given a failure of a robot that has an arm besides."""
        return self.settings.share

    def of_base(self, scene: Scene) -> float:
        """Return P that it is the base that fails."""
        return self.settings.of_base(scene)

    def of_cargo(self, scene: Scene) -> float:
        """Return P that it is not, or that a base without an arm throws off what stands on it."""
        return self.settings.of_cargo(scene)

    def worth(self, speed: float) -> float:
        """Return the share of its energy at a speed [m/s] in what severities are for."""
        return min(1.0, (speed / self.settings.reference_speed) ** 2)

    def meeting(self, scene: Scene) -> _native.MovingCoast:
        """Return P that entities that move are met, times what the energy is worth: see `moving_coast`."""
        return moving_coast(scene, self.settings)

    def roughly(self) -> Coast:
        """Return a model of fewer ways to fail: see `thinned`."""
        return Coast(thinned(self.settings))

    def moving(self) -> MovingModel:
        """Return the model for entities that move: a failing base meets them where they then are."""
        return MovingModel(drop=0.0, collapse=0.0, coast=1.0, base=self)

    def kernel(
        self,
        scene: Scene,
        severity: Float[Array, "component entity"],
        paces: tuple[float, float],
        own: OwnLoss | None = None,
    ) -> ImpactKernel:
        """Return the native kernel; nobody is in it if the robot does not drive."""
        del own
        kernels = compile_scene(scene).kernels
        if scene.base is None:
            return kernels.overlap(np.zeros_like(severity))
        row = severity[list(scene.components).index("body")]
        speed = reals(scene.limits.velocity)
        models = coast_model(scene, self.settings), coast_model(scene, thinned(self.settings))
        native = _native.CoastImpact(*models, reals(row), speed, *paces)
        return ImpactKernel(kernels, native)

    def gradients(
        self, batch: StateBatch, severity: Float[Array, "component entity"], own: OwnLoss | None = None
    ) -> tuple[Float[Array, "n nq"], Float[Array, "n nq"]]:
        """Return derivatives with respect to q and to the joint velocities, by differences in the core."""
        del own
        return self.kernel(batch.scene, severity, (1.0, 1.0)).state_slopes(batch.q, batch.qd)[1:]
