"""Bundled robot models, by name. Limits that MJCF cannot express are custom numerics in the model files."""

from __future__ import annotations

from pathlib import Path

from graceful_plan.exceptions import UnknownNameError

_FOLDER = Path(__file__).parents[1] / "robots"


def robots() -> tuple[str, ...]:
    """Return the names of the bundled robots."""
    return tuple(sorted(file.stem for file in _FOLDER.glob("*.xml")))


def robot_file(name: str) -> Path:
    """Return the MJCF file of a bundled robot.

    Raises:
        UnknownNameError: If there is no such robot.
    """
    if name not in robots():
        raise UnknownNameError("robot", name, robots())
    return _FOLDER / f"{name}.xml"
