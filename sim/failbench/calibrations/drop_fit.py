"""The drop model as a family of fitted constants.

Priors are estimates without any drop data: a gripper needs some hundredths of a second to release an object and does
not release it quite evenly; an object that falls off something moves by about its own size. The prior's spread is the
plausible error of the estimate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from failbench.calibrations.calibrate import Calibration, Recipe
from failbench.calibrations.failures import DROP, Failures
from failbench.calibrations.family_fit import States, fit_family
from failbench.calibrations.fitting import Constant, Family, Prior
from failbench.fault.fault import Fault
from graceful_plan import Scene
from graceful_plan.array_types import Array, Float
from graceful_plan.costs.models.drop.constants import SHARED, DropConstants, DropSettings
from graceful_plan.costs.models.drop.tables import SHAPE_CLASSES, drop_tables
from graceful_plan.costs.models.mixture.mixture import FailureMixture
from graceful_plan.costs.objective import moving_batch

_PRIORS: Mapping[str, Prior] = {
    "delay": Prior(0.03, 0.02, 0.0, 0.2, "s"),
    "velocity_spread": Prior(0.04, 0.5, 0.005, 0.3, "m/s"),
    "height_spread": Prior(0.1, 0.05, 0.0, 1.0, "m/m"),
    "carry_spread": Prior(0.1, 0.07, 0.0, 1.0, "s"),
    "side_spread": Prior(0.5, 0.3, 0.0, 3.0, "size"),
    "side_reach": Prior(0.0, 0.3, -1.5, 1.5, "size"),
    "side_height": Prior(0.05, 0.5, 0.005, 0.3, "m"),
    "catch": Prior(0.7, 0.2, 0.0, 1.0),
    "leave_tilt": Prior(1.5, 0.7, -3.0, 6.0),
    "position_spread": Prior(0.01, 0.4, 0.001, 0.1, "m"),
    "size_spread": Prior(1.0, 0.4, 0.0, 4.0, "size"),
    "tumble_reach": Prior(1.0, 0.4, -1.0, 4.0, "size"),
    "catch_margin": Prior(-0.4, 0.3, -2.0, 1.0, "size"),
    "leave": Prior(-0.3, 0.7, -5.0, 5.0),
    "leave_offset": Prior(1.5, 0.6, -1.0, 6.0),
    "leave_narrow": Prior(0.2, 0.4, -2.0, 3.0),
    "leave_speed": Prior(1.2, 0.6, -2.0, 6.0, "s/m"),
    "drift": Prior(1.0, 0.4, -1.0, 4.0, "size"),
    "carry": Prior(0.08, 0.05, -0.5, 1.0, "s"),
    "slide": Prior(0.1, 0.05, -0.5, 1.0, "s"),
    "topple_reach": Prior(0.6, 0.3, -1.0, 3.0, "size"),
}


class DropFamily(Family):
    """`FailureMixture` with one set of constants for each of `SHAPE_CLASSES`; some constants are shared."""

    constants = tuple(Constant(name=name, shared=name in SHARED, **prior._asdict()) for name, prior in _PRIORS.items())

    def shape(self, scene: Scene) -> str:
        """Return the shape class of the carried object."""
        return SHAPE_CLASSES[drop_tables(scene).shape_class]

    def prepare(self, scene: Scene, q: Float[Array, "n nq"], qd: Float[Array, "n nq"]) -> States:
        """Return the states with their scene."""
        return States(scene, q, qd)

    def probability(self, values: Mapping[str, float], prepared: Any) -> Float[Array, "n entity"]:
        """Return the probabilities that `FailureMixture` predicts for the carried object."""
        constants = DropConstants(**values)
        model = FailureMixture(settings=DropSettings(**dict.fromkeys(SHAPE_CLASSES, constants)))
        found = model.probability(moving_batch(prepared.scene, prepared.q, prepared.qd))
        return found[:, list(prepared.scene.components).index("carried")]


def fit_drop(failures: Sequence[Failures], *, about: Mapping[str, Any], seed: int = 0) -> Calibration:
    """Fit all constants to drops."""
    return fit_family(DropFamily(), failures, model="drop", shapes=SHAPE_CLASSES, seed=seed, about=about)


def faults_of(scene: Scene) -> Sequence[Fault]:
    """Return the fault that the model is fitted to, which is the same for all robots."""
    del scene
    return DROP


RECIPE = Recipe(faults_of, fit_drop)
