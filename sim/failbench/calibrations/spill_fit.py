"""The spill model `spill` as something whose constants can be fitted: for each use, to failures of its own.

"dropped" is fitted to what the gripper let go of. "held" is fitted to rollouts in which the gripper held on and
contents got out, since the model tells whom they reach then. Priors are what physics and the size of things suggest.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import Any, NamedTuple

import numpy as np
import yaml

from failbench.calibrations.calibrate import HEAD, VERSION, Calibration, Progress, calibrate, fetch
from failbench.calibrations.failures import Failures
from failbench.calibrations.fitting import Constant, Family, Prior
from failbench.fault.fault import Fault
from failbench.fault.registry import faults
from graceful_plan import Scene, UnknownNameError
from graceful_plan.array_types import Float
from graceful_plan.core.compile import compile_scene
from graceful_plan.costs.models.drop.constants import DropSettings
from graceful_plan.costs.models.drop.kernel import ROWS, DropKernel
from graceful_plan.costs.models.drop.tables import drop_tables
from graceful_plan.costs.models.spill.constants import USES, SpillConstants, SpillSettings
from graceful_plan.costs.models.spill.tables import spill_tables

Array = np.ndarray

SPILT = 0.01
"""Part of the contents whose loss counts as a spill."""
FAULTS: Mapping[str, tuple[str, ...]] = {
    "dropped": ("gripper_failure", "weak_grip", "stuck_gripper"),
    "held": ("complete_shutdown", "loose_joint", "power_loss", "dropout", "noise"),
}
"""Faults that each use is fitted to; only of rollouts in which the object left the gripper, or did not."""
_ALWAYS = {"soft_speed": -10.0, "soft_spread": 0.4}
"""What "held" has instead of a soft landing: contents are out."""
_SHAPE = "all"


def feared() -> list[Fault]:
    """Return the faults that the model is fitted to."""
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
"""A square with the area of a disc has 0.89 times its radius; jolts of 0.7 m/s spill."""


class _Prepared(NamedTuple):
    scene: Scene
    q: Float[Array, "n nq"]
    qd: Float[Array, "n nq"]


class SpillFamily(Family):
    """One use of the spill model, over the shipped drop model.

    Args:
        use: One of `spill_constants.USES`.
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
        """Return the same for all."""
        del scene
        return _SHAPE

    def prepare(self, scene: Scene, q: Float[Array, "n nq"], qd: Float[Array, "n nq"]) -> _Prepared:
        """Return the states with their scene."""
        return _Prepared(scene, q, qd)

    def probability(self, values: Mapping[str, float], prepared: Any) -> Float[Array, "n entity"]:
        """Return what the spill model predicts for the contents."""
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
        """Return the rollouts that this use is about."""
        found = []
        for whole in failures:
            part = whole.only(self.faults)
            rows = part.dropped if self.use == "dropped" else ~part.dropped & (part.spilled > SPILT)
            if "contents" in part.components and rows.any():
                found.append(part.where(rows))
        return found


@dataclass(frozen=True, kw_only=True)
class SpillCalibration:
    """Constants of the spill model by use, and why they are what they are. Made by `calibrate_spill`."""

    uses: Mapping[str, Calibration]

    def settings(self) -> SpillSettings:
        """Return the constants as the model's settings."""
        return SpillSettings(**{use: self._constants(use) for use in USES})

    def _constants(self, use: str) -> SpillConstants:
        family = SpillFamily(use)
        return family.of({name: x.value for name, x in self.uses[use].constants[_SHAPE].items()})

    def to_document(self) -> dict[str, Any]:
        """Return it as JSON values."""
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

    def to_yaml(self) -> str:
        """Return it as YAML text that `SpillSettings.load` reads."""
        document = self.to_document()
        about = {key: document[key] for key in ("version", "provenance")}
        constants = {use: document[use] for use in self.uses}
        compact = yaml.safe_dump(about, sort_keys=False, default_flow_style=None, width=120)
        return HEAD + compact + yaml.safe_dump(constants, sort_keys=False, default_flow_style=False)

    def __str__(self) -> str:
        return "\n".join(f"{use}\n{found}" for use, found in self.uses.items())


def fit_spill(
    failures: Sequence[Failures], *, about: Mapping[str, Any] | None = None, **options: Any
) -> SpillCalibration:
    """Calibrate both uses with failures in two scenes at least; options as of `calibrate`."""
    found = {}
    for use in USES:
        family = SpillFamily(use)
        concerned = family.concerned(failures)
        given = {"faults": list(family.faults), **(about or {})}
        found[use] = calibrate(family, concerned, model=f"spill, {use}", about=given, **options)
    return SpillCalibration(uses=found)


def calibrate_spill(
    scenes: Sequence[str],
    *,
    n: int = 30,
    repeats: int = 2,
    seed: int = 0,
    processes: int = 1,
    drops: str | FilePath | None = None,
    progress: Progress | None = None,
) -> SpillCalibration:
    """Let robots that carry containers fail in bundled scenes, or take failures from a file, and calibrate with them.

    Args:
        scenes: Names of bundled scenes, two at least that have tasks with contents.
        n: Failures along each motion.
        repeats: Motions of each kind for each task.
        seed: Of everything random.
        processes: How many to let fail in; the fit is done in this one.
        drops: File that the failures are kept in, or taken from if it is there. Then only those in `scenes` count.
        progress: Called after each motion.

    Raises:
        UnknownNameError: If there is no such scene.
        SettingError: If there is but one scene with contents.
        FormatError: If the file is there and holds something else.
    """
    failures, without = fetch(
        scenes, feared, n=n, repeats=repeats, seed=seed, processes=processes, kept=drops, progress=progress
    )
    about: dict[str, Any] = {"horizon": 1.0}
    about |= {"failures_from": FilePath(str(drops)).name} if without is None else {"motions_without": without}
    return fit_spill(failures, about=about, seed=seed)
