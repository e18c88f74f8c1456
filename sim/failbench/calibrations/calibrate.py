"""Calibration: let robots fail in many scenes, fit a model to that, and write down where its constants come from.

A `Recipe` says for each model what has to fail for it and how it is fitted; the rest is the same for all. A document
holds, beside each constant and its interval, what failed where with which versions, and how good the model is on each
scene with constants that were fitted on all the others.
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
    """Constants of a model, and why they are what they are."""

    ONE_A_LINE: ClassVar[tuple[str, ...]] = ()
    """Parts of the document whose constants get a line each when it is written."""
    ABOUT: ClassVar[str] = ""
    """What else the head of the file says, as comments."""

    @abstractmethod
    def to_document(self) -> dict[str, Any]:
        """Return it as JSON values."""

    @abstractmethod
    def __str__(self) -> str:
        """Return what it is worth, as a table."""

    def to_yaml(self) -> str:
        """Return it as YAML text that the model reads."""
        document = self.to_document()
        compact = {key: value for key, value in document.items() if key not in self.ONE_A_LINE}
        long = {key: document[key] for key in self.ONE_A_LINE}
        text = self.ABOUT + _HEAD + _dumped(compact, default_flow_style=None, width=120)
        return text + (_dumped(long, default_flow_style=False) if long else "")


class _Plain(yaml.SafeDumper):
    """Writes what is in two places twice: models refuse aliases."""

    def ignore_aliases(self, data: Any) -> bool:
        """Return that there are to be none."""
        del data
        return True


def _dumped(document: Mapping[str, Any], **style: Any) -> str:
    return yaml.dump(document, Dumper=_Plain, sort_keys=False, **style)


class Fit(Protocol):
    """Fits a model to failures."""

    def __call__(self, failures: Sequence[Failures], *, about: Mapping[str, Any], seed: int) -> Calibration:
        """Return the constants; `about` is put down with them, and `seed` is of the intervals."""
        ...


class Recipe(NamedTuple):
    """How a model is calibrated."""

    faults: Callable[[Scene], Sequence[Fault]]
    """What has to fail for it, on the robot of a scene."""
    fit: Fit


def calibrate(
    recipe: Recipe,
    scenes: Sequence[str],
    settings: FailureSettings | None = None,
    *,
    kept: str | FilePath | None = None,
    progress: Progress | None = None,
) -> Calibration:
    """Let robots fail in bundled scenes, or take failures from a file, and calibrate a model with them.

    Args:
        recipe: How.
        scenes: Names of bundled scenes; most models need two.
        settings: How often something fails; the fit is done in this process.
        kept: File that the failures are kept in, or taken from if it is there. Then only those in `scenes` count.
        progress: Called after each motion.

    Raises:
        UnknownNameError: If there is no such scene.
        SettingError: If there are too few scenes for the model.
        FormatError: If the file is there and holds something else.
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
    """Load the scene of every scene's name and task's name, with the object attached."""
    loaded = {name: load(name) for name in sorted({part.scene for part in failures})}
    return {(part.scene, part.task): loaded[part.scene].tasks[part.task].scene for part in failures}


def versions() -> dict[str, str]:
    """Return the versions of what decides about constants."""
    return {"graceful_plan": gp.__version__, "mujoco": mujoco.__version__}


def rounded(value: float, digits: int = 5) -> float:
    """Return a number with so many significant digits."""
    return float(f"{value:.{digits}g}")


def rounded_figures(found: Figures, digits: int = 5) -> dict[str, Any]:
    """Return figures as JSON values."""
    return {
        name: value if isinstance(value, int) else rounded(value, digits) for name, value in found._asdict().items()
    }
