"""Registry of faults and reactions, their conversion from and to JSON documents, and loading of user faults."""

from __future__ import annotations

import dataclasses
import importlib.util
import sys
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from failbench.basics.onset import AtFraction, AtTime, Onset, Uniform
from failbench.fault.actuator import (
    CompleteShutdown,
    GradualDegradation,
    IncreasedFriction,
    LimitedRange,
    LooseJoint,
    PartialDegradation,
    StuckPosition,
)
from failbench.fault.end_effector import GripperFailure, StuckGripper, WeakGrip
from failbench.fault.fault import CATEGORIES, DEGREES, Fault
from failbench.fault.power import BatteryDegradation, PowerLoss, VoltageDrop
from failbench.fault.reaction import ProtectiveStop
from failbench.fault.sensor import BiasDrift, ControlDelay, DeadZone, Dropout, Noise, ScaleError
from graceful_plan.exceptions import FormatError, SettingError, UnknownNameError
from graceful_plan.path import is_real, is_whole

__all__ = [
    "CATEGORIES",
    "DEGREES",
    "BatteryDegradation",
    "BiasDrift",
    "CompleteShutdown",
    "ControlDelay",
    "DeadZone",
    "Dropout",
    "Fault",
    "GradualDegradation",
    "GripperFailure",
    "IncreasedFriction",
    "LimitedRange",
    "LooseJoint",
    "Noise",
    "PartialDegradation",
    "PowerLoss",
    "ProtectiveStop",
    "ScaleError",
    "StuckGripper",
    "StuckPosition",
    "VoltageDrop",
    "WeakGrip",
    "faults",
    "from_document",
    "load_class",
    "reactions",
    "to_document",
]

_FAULTS: Mapping[str, type[Fault]] = MappingProxyType(
    {
        fault.NAME: fault
        for fault in (
            CompleteShutdown,
            LooseJoint,
            LimitedRange,
            PartialDegradation,
            GradualDegradation,
            StuckPosition,
            IncreasedFriction,
            Noise,
            BiasDrift,
            ControlDelay,
            Dropout,
            ScaleError,
            DeadZone,
            GripperFailure,
            WeakGrip,
            StuckGripper,
            BatteryDegradation,
            VoltageDrop,
            PowerLoss,
        )
    }
)

_REACTIONS: Mapping[str, type[Fault]] = MappingProxyType({ProtectiveStop.NAME: ProtectiveStop})

_ONSETS: Mapping[str, type[Onset]] = MappingProxyType(
    {"at_time": AtTime, "at_fraction": AtFraction, "uniform": Uniform}
)


def faults() -> Mapping[str, type[Fault]]:
    """Return the class of each fault by its name, category by category."""
    return _FAULTS


def reactions() -> Mapping[str, type[Fault]]:
    """Return the class of each reaction by its name: deliberate stops that can still harm the carried object."""
    return _REACTIONS


def to_document(fault: Fault) -> dict[str, Any]:
    """Return a fault as a JSON document, with all its settings."""
    document: dict[str, Any] = {"fault": fault.NAME}
    for setting in dataclasses.fields(fault):
        value = getattr(fault, setting.name)
        document[setting.name] = list(value) if isinstance(value, tuple) else value
    kind = next(name for name, cls in _ONSETS.items() if isinstance(fault.when, cls))
    document["when"] = {"onset": kind, **dataclasses.asdict(fault.when)}
    return document


def from_document(document: Mapping[str, Any], classes: Mapping[str, type[Fault]] | None = None) -> Fault:
    """Return the fault that a JSON document describes; missing settings take their defaults.

    Args:
        document: Result of `to_document`, or a part of it with at least the key "fault".
        classes: Further fault classes that the document may name.

    Raises:
        UnknownNameError: If it names a fault, a setting or an onset that does not exist.
        SettingError: If a setting has the wrong type or is out of range.
    """
    known = {**_FAULTS, **_REACTIONS, **(classes or {})}
    settings = _mapping("fault", document)
    name = str(settings.pop("fault", None))
    if name not in known:
        raise UnknownNameError("fault", name, known)
    cls = known[name]
    if "when" in settings:
        settings["when"] = _onset(settings["when"])
    defaults = {setting.name: setting.default for setting in dataclasses.fields(cls)}
    for key, value in settings.items():
        if key not in defaults:
            raise UnknownNameError(f"setting of the fault {name!r}", key, defaults)
        settings[key] = _checked(key, value, defaults[key])
    return cls(**settings)


def load_class(where: str) -> type[Fault]:
    """Load a fault class from a user's file, "path/to/file.py:ClassName". Executes the file.

    Raises:
        FormatError: If there is no such file, it cannot be run, or it has no such class.
    """
    file, _, name = where.rpartition(":")
    if not file or not name:
        raise FormatError(where, "expected a file and a class in it, as in my_faults.py:MyFault")
    path = Path(file)
    if not path.is_file():
        raise FormatError(file, "there is no such file")
    module_name = f"failbench_user_{path.stem}"
    spec = importlib.util.spec_from_file_location(module_name, path)
    if spec is None or spec.loader is None:
        raise FormatError(file, "expected a file whose name ends in .py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[module_name] = module  # dataclasses look up their own module
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        del sys.modules[module_name]
        raise FormatError(file, f"cannot be run: {type(error).__name__}: {error}") from error
    cls = getattr(module, name, None)
    if not (isinstance(cls, type) and issubclass(cls, Fault) and cls is not Fault):
        there = [n for n, c in vars(module).items() if isinstance(c, type) and issubclass(c, Fault) and c is not Fault]
        raise FormatError(file, f"has no fault {name!r}; it has {', '.join(sorted(there)) or 'none'}")
    return cls


def _mapping(name: str, value: Any) -> dict[str, Any]:
    if not isinstance(value, Mapping):
        raise SettingError(name, value, "a mapping of names to values")
    return {str(key): item for key, item in value.items()}


def _onset(document: Any) -> Onset:
    settings = _mapping("when", document)
    kind = str(settings.pop("onset", None))
    if kind not in _ONSETS:
        raise UnknownNameError("onset", kind, _ONSETS)
    cls = _ONSETS[kind]
    valid = {setting.name for setting in dataclasses.fields(cls)}
    for key, value in settings.items():
        if key not in valid:
            raise UnknownNameError(f"setting of the onset {kind!r}", key, valid)
        settings[key] = _checked(key, value, 0.0)
    missing = {f.name for f in dataclasses.fields(cls) if f.default is dataclasses.MISSING} - settings.keys()
    if missing:
        raise SettingError("when", dict(document), f"also {', '.join(sorted(missing))}")
    return cls(**settings)


def _checked(name: str, value: Any, default: Any) -> Any:
    """Return a setting converted to the type of its default; raise SettingError if it has another type."""
    if name == "rates":
        if not isinstance(value, list | tuple) or not all(is_real(x) for x in value):
            raise SettingError(name, value, "a list of numbers")
        return tuple(float(x) for x in value)
    if isinstance(default, tuple):
        if not isinstance(value, list | tuple) or not all(isinstance(item, str) for item in value):
            raise SettingError(name, value, "a list of names")
        return tuple(value)
    if value is None and (name == "duration" or default is None):
        return None
    if isinstance(default, bool) or isinstance(default, str):
        if not isinstance(value, type(default)):
            raise SettingError(name, value, "true or false" if isinstance(default, bool) else "a text")
        return value
    if isinstance(default, int):
        if not is_whole(value):
            raise SettingError(name, value, "a whole number")
        return int(value)
    if default is None or isinstance(default, float):
        if not is_real(value):
            raise SettingError(name, value, "a number")
        return float(value)
    return value
