"""Calibration: simulate failures in many scenes, fit a model to them, and record the provenance of its constants.

A `Recipe` gives the faults and the fit of each model; the rest is common to all. A document holds each constant with
its interval, the failures and versions behind it, and the model's quality on each scene with constants fitted on all
other scenes.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path as FilePath
from typing import Any, ClassVar, NamedTuple, Protocol

import mujoco
import yaml

import graceful_plan as gp
from failbench.calibrations.failure_jobs import FailureSettings, Progress, fetch
from failbench.calibrations.failures import Failures
from failbench.calibrations.skill import Figures
from failbench.fault.fault import Fault
from graceful_plan import Scene

VERSION = 1
_HEAD = """\
# Written by `failbench calibrate`; do not edit. Intervals are 95 %, whole motions drawn with replacement.
# held_out: each scene with constants that were fitted on the others.
"""


class Calibration(ABC):
    """Constants of a model, with their provenance."""

    ONE_A_LINE: ClassVar[tuple[str, ...]] = ()
    """Parts of the document that are written with one constant per line."""
    ABOUT: ClassVar[str] = ""
    """Further comment lines for the head of the file."""

    @abstractmethod
    def to_document(self) -> dict[str, Any]:
        """Return the calibration as JSON values."""

    @abstractmethod
    def __str__(self) -> str:
        """Return the quality of the calibration as a table."""

    def to_yaml(self) -> str:
        """Return the calibration as YAML text that the model reads."""
        document = self.to_document()
        compact = {key: value for key, value in document.items() if key not in self.ONE_A_LINE}
        long = {key: document[key] for key in self.ONE_A_LINE}
        text = self.ABOUT + _HEAD + _dumped(compact, default_flow_style=None, width=120)
        return text + (_dumped(long, default_flow_style=False) if long else "")


class _Plain(yaml.SafeDumper):
    """YAML dumper without aliases, which models refuse."""

    def ignore_aliases(self, data: Any) -> bool:
        """Return True, to write repeated values in full."""
        del data
        return True


def _dumped(document: Mapping[str, Any], **style: Any) -> str:
    return yaml.dump(document, Dumper=_Plain, sort_keys=False, **style)


class Fit(Protocol):
    """Fits a model to failures."""

    def __call__(self, failures: Sequence[Failures], *, about: Mapping[str, Any], seed: int) -> Calibration:
        """Return the constants; `about` is recorded with them, and `seed` is for the intervals."""
        ...


class Recipe(NamedTuple):
    """Calibration recipe of a model."""

    faults: Callable[[Scene], Sequence[Fault]]
    """Faults to simulate, for the robot of a scene."""
    fit: Fit


def calibrate(
    recipe: Recipe,
    scenes: Sequence[str],
    settings: FailureSettings | None = None,
    *,
    kept: str | FilePath | None = None,
    progress: Progress | None = None,
) -> Calibration:
    """Calibrate a model with failures simulated in bundled scenes, or read from a file.

    Args:
        recipe: The model's recipe.
        scenes: Names of bundled scenes; most models need two.
        settings: Numbers of failures and motions; the fit runs in this process.
        kept: File to store the failures in, or to read them from if it exists. Only failures in `scenes` are used.
        progress: Called after each motion.

    Raises:
        UnknownNameError: If there is no such scene.
        SettingError: If there are too few scenes for the model.
        FormatError: If the file exists and holds something else.
    """
    settings = FailureSettings() if settings is None else settings
    failures, source = fetch(
        scenes,
        lambda: recipe.faults(gp.load_scene(scenes[0])),
        settings,
        kept=None if kept is None else FilePath(kept),
        progress=progress,
    )
    return recipe.fit(failures, about={"horizon": 1.0, **source}, seed=settings.seed)


def write(calibration: Calibration, file: str | FilePath) -> None:
    """Write a calibration as YAML."""
    FilePath(file).write_text(calibration.to_yaml(), encoding="utf-8")


def scenes_of(failures: Sequence[Failures], load: Callable[[str], Scene]) -> dict[tuple[str, str], Scene]:
    """Load the scenes of all failures, with the object attached, by name of the scene and the task."""
    loaded = {name: load(name) for name in sorted({part.scene for part in failures})}
    return {(part.scene, part.task): loaded[part.scene].tasks[part.task].scene for part in failures}


def versions() -> dict[str, str]:
    """Return the versions of the packages that determine constants."""
    return {"graceful_plan": gp.__version__, "mujoco": mujoco.__version__}


def rounded(value: float, digits: int = 5) -> float:
    """Return a number rounded to `digits` significant digits."""
    return float(f"{value:.{digits}g}")


def rounded_figures(found: Figures, digits: int = 5) -> dict[str, Any]:
    """Return figures as JSON values."""
    return {
        name: value if isinstance(value, int) else rounded(value, digits) for name, value in found._asdict().items()
    }
