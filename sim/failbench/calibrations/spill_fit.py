"""The spill model as a family of fitted constants, one family for each use of the model.

"dropped" is fitted to failures in which the gripper released the object. "held" is fitted to rollouts in which the
gripper kept the object and contents spilled, since the model predicts which entities they reach. Priors come from
physics and typical object sizes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, final

from failbench.calibrations.calibrate import VERSION, Calibration, Recipe
from failbench.calibrations.failures import Failures
from failbench.calibrations.family_fit import FamilyCalibration, States, fit_family
from failbench.calibrations.fitting import Constant, Family, Prior
from failbench.fault.fault import Fault
from failbench.fault.registry import faults
from graceful_plan import Scene
from graceful_plan.array_types import Array, Float
from graceful_plan.core.compile import compile_scene
from graceful_plan.costs.models.drop.constants import DropSettings
from graceful_plan.costs.models.drop.kernel import ROWS, DropKernel
from graceful_plan.costs.models.drop.tables import drop_tables
from graceful_plan.costs.models.spill.constants import USES, SpillConstants, SpillSettings
from graceful_plan.costs.models.spill.tables import spill_tables
from graceful_plan.exceptions import UnknownNameError

SPILT = 0.01
"""Lost fraction of the contents that counts as a spill."""
FAULTS: Mapping[str, tuple[str, ...]] = {
    "dropped": ("gripper_failure", "weak_grip", "stuck_gripper"),
    "held": ("complete_shutdown", "loose_joint", "power_loss", "dropout", "noise"),
}
"""Faults that each use is fitted to; only rollouts in which the object left the gripper ("dropped") or not ("held")."""
_ALWAYS = {"soft_speed": -10.0, "soft_spread": 0.4}
"""Constants of "held" in place of a soft landing: the contents have already left."""
_SHAPE = "all"


def faults_of(scene: Scene) -> list[Fault]:
    """Return the faults that the model is fitted to, which are the same for all robots."""
    del scene
    return [faults()[name](degree="severe") for use in USES for name in FAULTS[use]]


_PRIORS: Mapping[str, Prior] = {
    "position_spread": Prior(0.1, 0.5, 0.005, 1.0, "m"),
    "rim_spread": Prior(0.7, 0.3, 0.0, 3.0, "rim"),
    "speed_spread": Prior(0.1, 0.07, 0.0, 1.0, "s"),
    "height_spread": Prior(0.1, 0.1, 0.0, 1.0, "m/m"),
    "carry": Prior(0.1, 0.1, 0.0, 1.0, "s"),
    "margin": Prior(0.1, 0.07, 0.0, 0.5, "m"),
    "reach": Prior(0.89, 0.15, 0.0, 2.0, "puddle"),
    "run_off": Prior(0.7, 0.2, 0.0, 2.0, "puddle"),
    "edge": Prior(0.8, 0.2, 0.0, 2.0, "puddle"),
    "slosh": Prior(0.2, 0.2, 0.0, 2.0, "s/m"),
    "soft_speed": Prior(0.7, 0.3, -1.0, 3.0, "m/s"),
    "soft_spread": Prior(0.3, 0.5, 0.02, 2.0, "m/s"),
}
"""A square with the area of a disc has a half side of 0.89 times its radius; jolts of 0.7 m/s spill."""


class SpillFamily(Family):
    """One use of the spill model, over the shipped drop model.

    Args:
        use: "dropped" or "held", see `USES`.
        settings: Constants of the drop model.
    """

    components = ("contents",)

    def __init__(self, use: str, settings: DropSettings | None = None) -> None:
        if use not in USES:
            raise UnknownNameError("use of the spill model", use, USES)
        self.use, self.faults = use, FAULTS[use]
        self._settings = DropSettings.shipped() if settings is None else settings
        self._fixed = _ALWAYS if use == "held" else {}
        self.constants = tuple(
            Constant(name=name, shared=True, **prior._asdict())
            for name, prior in _PRIORS.items()
            if name not in self._fixed
        )

    def shape(self, scene: Scene) -> str:
        """Return the only shape class."""
        del scene
        return _SHAPE

    def prepare(self, scene: Scene, q: Float[Array, "n nq"], qd: Float[Array, "n nq"]) -> States:
        """Return the states with their scene."""
        return States(scene, q, qd)

    def probability(self, values: Mapping[str, float], prepared: Any) -> Float[Array, "n entity"]:
        """Return the probabilities that the spill model predicts for the contents."""
        scene, tables = prepared.scene, drop_tables(prepared.scene)
        constants = self.of(values)
        kernel = DropKernel(
            tables,
            self._settings.of(tables.shape_class),
            compile_scene(scene).kernels,
            scene.limits.velocity,
            len(scene.entities),
            (spill_tables(scene), SpillSettings(dropped=constants, held=constants)),
        )
        return kernel.probability(prepared.q, prepared.qd)[:, ROWS.index(self.use)]

    def of(self, values: Mapping[str, float]) -> SpillConstants:
        """Return the model's constants with fitted values."""
        return SpillConstants(**{**values, **self._fixed})

    def concerned(self, failures: Sequence[Failures]) -> list[Failures]:
        """Return the rollouts that this use is fitted to."""
        found = []
        for whole in failures:
            part = whole.only(self.faults)
            rows = part.dropped if self.use == "dropped" else ~part.dropped & (part.spilled > SPILT)
            if "contents" in part.components and rows.any():
                found.append(part.where(rows))
        return found


@final
@dataclass(frozen=True, kw_only=True)
class SpillCalibration(Calibration):
    """Fitted constants of the spill model by use, with their provenance. Made by `fit_spill`."""

    ONE_A_LINE: ClassVar[tuple[str, ...]] = USES

    uses: Mapping[str, FamilyCalibration]

    def settings(self) -> SpillSettings:
        """Return the constants as the model's settings."""
        return SpillSettings(**{use: self._constants(use) for use in USES})

    def _constants(self, use: str) -> SpillConstants:
        family = SpillFamily(use)
        return family.of({name: x.value for name, x in self.uses[use].constants[_SHAPE].items()})

    def to_document(self) -> dict[str, Any]:
        """Return the calibration as JSON values."""
        provenance: dict[str, Any] = {}
        constants: dict[str, dict[str, float]] = {}
        for use, found in self.uses.items():
            document = found.to_document()
            about = document["provenance"]
            about["intervals"] = about["intervals"]["shared"]
            provenance[use] = about
            fixed = _ALWAYS if use == "held" else {}
            constants[use] = {**document["shared"], **fixed}
        return {"version": VERSION, "provenance": provenance, **constants}

    def __str__(self) -> str:
        return "\n".join(f"{use}\n{found}" for use, found in self.uses.items())


def fit_spill(
    failures: Sequence[Failures], *, about: Mapping[str, Any] | None = None, seed: int = 0
) -> SpillCalibration:
    """Fit both uses to failures in at least two scenes."""
    found = {}
    for use in USES:
        family = SpillFamily(use)
        given = {"faults": list(family.faults), **(about or {})}
        found[use] = fit_family(family, family.concerned(failures), model=f"spill, {use}", about=given, seed=seed)
    return SpillCalibration(uses=found)


RECIPE = Recipe(faults_of, fit_spill)
