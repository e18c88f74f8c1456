"""Bundled scenes: pairs of a scene file and its MJCF world; those with mobile bases are in a separate folder."""

from __future__ import annotations

from pathlib import Path

from graceful_plan.exceptions import UnknownNameError, names_file
from graceful_plan.regular_file import path_of
from graceful_plan.scene.loading.file import read_scene
from graceful_plan.scene.scene import Scene

_FOLDER = Path(__file__).parents[1] / "scenes"
_MOBILE = _FOLDER / "mobile"


def scenes() -> tuple[str, ...]:
    """Return the names of the bundled scenes with fixed arms, without reading them."""
    return _names(_FOLDER)


def mobile_scenes() -> tuple[str, ...]:
    """Return the names of the bundled scenes with mobile bases, without reading them."""
    return _names(_MOBILE)


def _names(folder: Path) -> tuple[str, ...]:
    return tuple(sorted(file.stem for file in folder.glob("*.yaml")))


@names_file
def load_scene(name_or_path: str | Path) -> Scene:
    """Load a bundled scene by name, or any scene file by its path (ending in .yaml or .yml).

    Raises:
        UnknownNameError: If there is no bundled scene of that name.
        SceneError: If the file is broken or hostile, with file and line.
        UnsupportedError: If the model has unsupported features.
    """
    path = path_of(name_or_path)
    return read_scene(path) if path.suffix in (".yaml", ".yml") else read_bundled(str(name_or_path))


def read_bundled(name: str) -> Scene:
    """Read a bundled scene from its file.

    Raises:
        UnknownNameError: If there is no bundled scene of that name.
    """
    for folder in (_FOLDER, _MOBILE):
        if name in _names(folder):
            return read_scene(folder / f"{name}.yaml")
    raise UnknownNameError("scene", name, (*scenes(), *mobile_scenes()))
