"""Imports of the optional subpackage for mobile bases from packages that must not depend on it.

Modules outside of `graceful_plan.mobile` know only its contracts and import the implementation once a scene has a
base. Calls for fixed arms load none of its modules, and the library can be installed without it.
"""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

from graceful_plan.exceptions import UnsupportedError


def import_mobile(part: str, of: str = "graceful_plan") -> ModuleType:
    """Import a module of the subpackage `mobile`.

    Args:
        part: Name of the module within the subpackage, such as "coast.coast".
        of: Package that contains the subpackage: FailBench has one, too.

    Raises:
        UnsupportedError: If the subpackage is not installed.
    """
    room = f"{of}.mobile"
    try:
        import_module(room)  # empty module: fails only if not installed; errors in a part propagate
    except ImportError as error:
        raise UnsupportedError(
            f"the robot has a mobile base, which needs {room}: not installed; fixed robots work without it"
        ) from error
    return import_module(f"{room}.{part}")
