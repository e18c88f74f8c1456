r"""The coast model: impact of a base that fails while driving, continues along its arc and hits entities.

A base with speed v and turning rate :math:`\omega` continues along the arc of curvature :math:`\omega / v`. A
skid-steer whose wheels are released straightens: it turns by at most :math:`c \omega^2`, then goes straight on.
Stopping modes differ by deceleration a, drag k and delay T. The coasting distance is

.. math:: D = |v| T + |v| / k - (a / k^2) \ln(1 + k |v| / a), \qquad D = |v| T + v^2 / 2a \text{ where } k = 0.

After a distance s, the share :math:`e = \min(1, 1 - (s - |v| T) / (D - |v| T))` of the kinetic energy remains.
Severities scale with :math:`\min(1, e v^2 / u^2)`, where u is the speed for which they are specified. The footprint of
the base is a set of rectangles, possibly rounded, one for each geom. The distance d from the footprint to a shape is
uncertain with standard deviation :math:`\sigma(s)`, which combines the position spread and the drift times s. With the
mode probabilities :math:`p_i`, the expected severity share of a hit is

.. math:: P = \sum_i p_i \max_s \Phi\left(-\frac{d(s)}{\sigma(s)}\right) B(s) \min(1, n(s) e_i(s) v^2 / u^2)

Here n is the share of the energy along the contact normal, :math:`\max(0, -d'(s))^2`. If :math:`\sigma` is large
compared with the size r of the entity, the normal is unknown and n approaches its mean of 1/2 with weight
:math:`\sigma^2 / (\sigma^2 + r^2)`. B is the probability that no obstacle has stopped the base before and no other
entity has absorbed the normal share of its energy. P is thus the probability of a hit, weighted by the share of the
severity that its energy causes. For one-sided failures, `four_wheel` integrates the motion, and places are interpolated
from its tables. Abrupt odometry failures add a curvature to the arc.

A base with proportional odometry error (`astray`) does not leave its path at once. It follows the path with a growing
lateral offset, through turns that one state does not show. Its harm is therefore assigned to the place where it occurs,
not to the onset. The drift has lasted for a time :math:`\tau`, uniform up to the detection time T, and the pose error
is

.. math:: \pm \kappa \ell^2 / 2 \text{ laterally, } \pm \kappa \ell \text{ in heading}, \quad \ell = c\, v_{max} \tau

with pace c, and :math:`\kappa` the relative error of one side's speed over the effective track. Entities touched within
the next short step, but not yet, are hit at the rate :math:`|v|\, d\Phi / ds`; P is that rate times :math:`p T`, n and
the energy share. Integrated along a path, this is the probability of hitting an entity beside it, at any speed.
Obstacles between the path and the base reduce it.

A skid-steer with weak drives (`weak`) follows its path until it has to turn, and then goes straight on. It leaves its
path once in a turn by an angle :math:`\Theta`, so the rate of bases that leave it is :math:`p\, T\, |\omega| / \Theta`
where T is the time until the weakness is detected. P is that rate times the worst touch along the straight line, which
the base follows for the rest of that time.

An object on an arm moves with the base. Along the same trajectories, with a disc of its width in place of the footprint
and the shapes at its height, its P is computed in the same way; it harms in full from 0.05 m/s on.

An object on the deck of a base without an arm goes on when an entity stops the base: friction stops it after
:math:`v^2 / 2 \mu g`, 0.4 m at 2 m/s. It therefore hits that entity, too, with the same P, whose factor of the energy
stands for the distance that the object slides.

The model leaves out ramps (scenes have none), deflection of the base by grazing contacts, objects pushed along, hits of
moving entities by an object on an arm, and contents that are spilled when the base is stopped. One constant is fitted,
the pace c; `coast.yaml` lists the sources.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.core import _native
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import ImpactKernel, reals
from graceful_plan.costs.cost import StateBatch
from graceful_plan.costs.models.failing_base import FailingBase
from graceful_plan.costs.models.moving.model import MovingModel
from graceful_plan.costs.native_model import NativeModel, OwnLoss
from graceful_plan.mobile.coast.constants import CoastSettings
from graceful_plan.mobile.coast.moving_entities import moving_coast
from graceful_plan.mobile.coast.native import coast_model
from graceful_plan.mobile.coast.reduced import reduced_settings
from graceful_plan.scene.scene import Scene


@final
@dataclass(frozen=True)
class Coast(NativeModel, FailingBase):
    """Probability that a failing base hits each entity, weighted by energy; 0 for robots without a `DiffDrive`.

    Args:
        settings: Constants of the model; default: the shipped ones.
    """

    settings: CoastSettings = field(default_factory=CoastSettings.shipped)

    @property
    def components(self) -> tuple[str, ...]:
        """The body, and an object that it carries while it fails; the drop model covers the fall of the object."""
        return ("body", "carried")

    def probability(self, batch: StateBatch) -> Float[Array, "n component entity"]:
        """Return the probability of a hit, weighted by the severity share of its energy."""
        scene = batch.scene
        P = np.zeros((len(batch), len(scene.components), len(scene.entities)))
        if scene.base is not None and P.size:
            found = coast_model(scene, self.settings).probability(reals(batch.q), reals(batch.qd))
            for row, component in enumerate(scene.components):
                if component in self.components:
                    P[:, row] = found[:, 0 if component in self.hits_with(scene) else 1]
        return P

    def hits_with(self, scene: Scene) -> tuple[str, ...]:
        """Return the body, and an object on the deck of a base without an arm."""
        assert scene.base is not None
        return ("body", "carried") if scene.joints == scene.base.joints else ("body",)

    def of_base(self, scene: Scene) -> float:
        """Return the probability that the base is the failing part."""
        return self.settings.of_base(scene)

    def of_cargo(self, scene: Scene) -> float:
        """Return the probability that a failure releases the carried object or throws it off a base without an arm."""
        return self.settings.of_cargo(scene)

    def worth(self, speed: float) -> float:
        """Return the ratio of the energy at a speed [m/s] to that at the reference speed of severities, at most 1."""
        return min(1.0, (speed / self.settings.reference_speed) ** 2)

    def meeting(self, scene: Scene) -> _native.MovingCoast:
        """Return the native model for hits of moving entities, weighted by energy: see `moving_coast`."""
        return moving_coast(scene, self.settings)

    def roughly(self) -> Coast:
        """Return a cheaper model with fewer stopping modes: see `reduced_settings`."""
        return Coast(reduced_settings(self.settings))

    def moving(self) -> MovingModel:
        """Return the model for moving entities: a failing base hits them at their predicted positions."""
        return MovingModel(drop=0.0, collapse=0.0, coast=1.0, base=self)

    def kernel(
        self,
        scene: Scene,
        severity: Float[Array, "component entity"],
        paces: tuple[float, float],
        own: OwnLoss | None = None,
    ) -> ImpactKernel:
        """Return the native kernel; its impact is 0 if the robot has no base."""
        del own
        kernels = compile_scene(scene).kernels
        if scene.base is None:
            return kernels.overlap(np.zeros_like(severity))
        with_base = np.array([name in self.hits_with(scene) for name in scene.components])
        on_arm = np.array([name == "carried" for name in scene.components]) & ~with_base
        rows = severity[with_base].sum(axis=0), severity[on_arm].sum(axis=0)
        speed = reals(scene.limits.velocity)
        models = coast_model(scene, self.settings), coast_model(scene, reduced_settings(self.settings))
        native = _native.CoastImpact(*models, reals(np.concatenate(rows)), speed, *paces)
        return ImpactKernel(kernels, native)

    def gradients(
        self, batch: StateBatch, severity: Float[Array, "component entity"], own: OwnLoss | None = None
    ) -> tuple[Float[Array, "n nq"], Float[Array, "n nq"]]:
        """Return derivatives with respect to q and the joint velocities, computed in the core."""
        del own
        return self.kernel(batch.scene, severity, (1.0, 1.0)).state_slopes(batch.q, batch.qd)[1:]
