"""Imports of the room of everything that drives, by the rooms below it.

Rooms below `graceful_plan.mobile` know it by contracts alone, and import what implements them once a scene has a base:
an arm's call loads no module of it, and an installation may be without.
"""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

from graceful_plan.exceptions import UnsupportedError


def mobile_room(part: str, of: str = "graceful_plan") -> ModuleType:
    """Import a module of the room.

    Args:
        part: Its name within the room, such as "coast.coast".
        of: Package whose room it is: FailBench has one as well.

    Raises:
        UnsupportedError: If the room is not installed.
    """
    room = f"{of}.mobile"
    try:
        import_module(room)  # empty: if it fails, the room is missing; errors inside of a part are told as they are
    except ImportError as error:
        raise UnsupportedError(
            f"the robot has a base that drives, which needs {room}: not installed; robots that stand work without it"
        ) from error
    return import_module(f"{room}.{part}")
