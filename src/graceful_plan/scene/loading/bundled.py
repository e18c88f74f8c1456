"""Bundled scenes: pairs of a scene file and its MJCF world in this folder."""

from __future__ import annotations

from pathlib import Path

from graceful_plan.exceptions import UnknownNameError
from graceful_plan.scene.loading.file import read_scene
from graceful_plan.scene.scene import Scene

_FOLDER = Path(__file__).parents[1] / "scenes"


def scenes() -> tuple[str, ...]:
    """Names of the bundled scenes. Reads none of them."""
    return tuple(sorted(file.stem for file in _FOLDER.glob("*.yaml")))


def load_scene(name_or_path: str | Path) -> Scene:
    """Load a bundled scene by name, or any scene file by its path (ending in .yaml or .yml).

    Raises:
        UnknownNameError: If there is no bundled scene of that name.
        SceneError: If the file is broken or hostile, with file and line.
        UnsupportedError: If the model has features that cannot be represented.
    """
    path = Path(name_or_path)
    if path.suffix in (".yaml", ".yml"):
        return read_scene(path)
    if str(name_or_path) not in scenes():
        raise UnknownNameError("scene", str(name_or_path), scenes())
    return read_scene(_FOLDER / f"{name_or_path}.yaml")
