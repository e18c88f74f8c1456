"""Packages whose public names are imported when somebody first asks for them.

Who plans does not wait for the viewer and for benchmarks; who asks for the version waits for nothing.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from importlib import import_module
from types import ModuleType
from typing import Any, final

_HOMES = "_homes"


@final
class PackageOnDemand(ModuleType):
    """A package that finds its public names in their modules (PEP 562, as a class for what `__setattr__` does)."""

    def __getattr__(self, name: str) -> Any:
        home = self.__dict__.get(_HOMES, {}).get(name)
        if home is None:
            raise AttributeError(f"module '{self.__name__}' has no attribute '{name}'", name=name, obj=self)
        module = import_module(home)
        value = getattr(module, name, module) if home == f"{self.__name__}.{name}" else getattr(module, name)
        setattr(self, name, value)
        return value

    def __setattr__(self, name: str, value: Any) -> None:
        # Python makes a module an attribute of its package as it is imported. `plan.py` would hide `plan` by that.
        if isinstance(value, ModuleType) and value.__name__ == self.__dict__.get(_HOMES, {}).get(name):
            value = getattr(value, name, value)
        super().__setattr__(name, value)

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *self.__dict__.get(_HOMES, ())})


def install(package: str, homes: Mapping[str, str]) -> None:
    """Make names of a package, which is being imported, ones that are imported on demand.

    Args:
        package: Its full name.
        homes: The full name of the module where each public name is defined; a submodule is its own home.
    """
    module = sys.modules[package]
    setattr(module, _HOMES, dict(homes))
    module.__class__ = PackageOnDemand
