"""Packages that import their public names on first access, from the modules that their stub `__init__.pyi` names.

A program that only plans does not wait for imports of the viewer and the benchmarks. `lazy-loader` reads stubs in the
same way, but there the module `plan.py`, once imported, hides the function `plan`.
"""

from __future__ import annotations

import ast
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, final

_HOMES = "_homes"


@final
class LazyPackage(ModuleType):
    """A package with lazily imported public names: PEP 562, but as a class, since `__setattr__` is needed, too."""

    def __getattr__(self, name: str) -> Any:
        home = self.__dict__.get(_HOMES, {}).get(name)
        if home is None:
            raise AttributeError(f"module '{self.__name__}' has no attribute '{name}'", name=name, obj=self)
        module = import_module(home)
        value = getattr(module, name, module) if home == f"{self.__name__}.{name}" else getattr(module, name)
        setattr(self, name, value)
        return value

    def __setattr__(self, name: str, value: Any) -> None:
        # Importing a submodule sets it as an attribute of its package: `plan.py` would hide the function `plan`.
        if isinstance(value, ModuleType) and value.__name__ == self.__dict__.get(_HOMES, {}).get(name):
            value = getattr(value, name, value)
        super().__setattr__(name, value)

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *self.__dict__.get(_HOMES, ())})


def install(package: str) -> None:
    """Make a package import its public names on first access; called while the package is being imported.

    Args:
        package: Full name of a package with a stub `__init__.pyi` of `from module import name as name` lines.
    """
    module = sys.modules[package]
    homes = _read_stub(package, Path(str(module.__file__)).with_suffix(".pyi"))
    setattr(module, _HOMES, homes)
    module.__dict__["__all__"] = sorted(homes)
    module.__class__ = LazyPackage


def _read_stub(package: str, stub: Path) -> dict[str, str]:
    """Return the full name of the module that defines each public name; a submodule maps to itself."""
    return {
        alias.name: f"{package}.{alias.name}" if node.module == package else str(node.module)
        for node in ast.parse(stub.read_text(encoding="utf-8")).body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
