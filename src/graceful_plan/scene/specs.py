"""Load and compile models of MuJoCo: untrusted files are screened first, and failures of the compiler become errors."""

from __future__ import annotations

import re
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import mujoco

from graceful_plan.exceptions import SceneError, SettingError, TooLargeError
from graceful_plan.regular_file import path_of
from graceful_plan.scene.screening import Screen

_BYTES_ANYHOW = 2**24
"""Approximate size of MuJoCo's default memory for contacts and scratch [bytes]."""
_BYTES_OF_PAIR = 4
"""Bytes per pair: collision detection reserves two lists of all body pairs, with two 2-byte indices: 4 n^2 in all."""


def load_spec(
    source: str | Path | mujoco.MjSpec, folder: str | Path | None = None, *, visuals: bool = True
) -> mujoco.MjSpec:
    """Load a model from a file or from text that starts with "<", or copy a MjSpec.

    Args:
        source: MJCF file, MJCF text or a MjSpec.
        folder: Folder that must contain all files of the model; by default the folder of the model's file.
        visuals: Whether to keep textures, materials and geoms that do not collide. Without them, bodies keep their mass
            and inertia, and the files of textures are never opened.

    Raises:
        SceneError: If the model is broken or hostile, with file and line.
        SettingError: If `source` has another type, or is a file outside `folder`.
    """
    if not isinstance(source, str | Path | mujoco.MjSpec):
        raise SettingError("source", source, "MJCF, the name of a file of it, or a MjSpec")
    if not isinstance(source, str | Path):
        return _kept(source.copy(), visuals)
    if isinstance(source, str) and source.lstrip().startswith("<"):
        Screen(None, visuals=visuals).text(source)
        return _kept(_parsed(source, None), visuals)
    file = path_of(source)
    if file.suffix.lower() == ".mjb":
        raise SceneError("binary models cannot be screened; give the MJCF", file=str(file))
    Screen(_root(file, folder), up=folder is not None, visuals=visuals).model(file)
    return _kept(_parsed(None, file), visuals)


def _kept(spec: mujoco.MjSpec, visuals: bool) -> mujoco.MjSpec:
    """Return a model, without its visual elements unless they are kept."""
    if not visuals:
        try:
            spec.discard_visual()
        except (ValueError, RuntimeError) as error:
            raise _translated(error, None) from None
    return spec


def _root(file: Path, folder: str | Path | None) -> Path:
    """Return the folder that must contain all files."""
    if folder is None:
        return file.parent.resolve()
    root = path_of(folder).resolve()
    if not (root.is_dir() and file.resolve().is_relative_to(root)):
        raise SettingError("folder", str(folder), f"one that {str(file)!r} is in")
    return root


def compile_spec(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compile a model, with enough memory for collision detection among all of its bodies.

    Raises:
        SceneError: If it cannot be compiled; the message is MuJoCo's.
        TooLargeError: If it needs more memory than is available.
    """
    bodies = len(spec.bodies)
    pairs = _BYTES_OF_PAIR * bodies**2
    if pairs > _BYTES_ANYHOW // 4:
        spec.memory = max(spec.memory, _BYTES_ANYHOW + pairs)
    try:
        with within_memory(f"a model with {bodies} bodies"):
            return spec.compile()
    except (ValueError, RuntimeError) as error:
        raise _translated(error, None) from None


@contextmanager
def within_memory(what: str) -> Generator[None]:
    """Raise `TooLargeError` if MuJoCo or numpy run out of memory.

    Args:
        what: Description of the operation for the message.
    """
    try:
        yield
    except (MemoryError, mujoco.FatalError) as error:
        raise TooLargeError(what, " ".join(str(error).split())) from error


def _parsed(text: str | None, file: Path | None) -> mujoco.MjSpec:
    try:
        spec = mujoco.MjSpec.from_string(text) if file is None else mujoco.MjSpec.from_file(str(file))
    except (ValueError, RuntimeError, UnicodeError) as error:
        raise _translated(error, None if file is None else str(file)) from None
    spec.nconmax = spec.njmax = -1
    return spec


def _translated(error: Exception, file: str | None) -> SceneError:
    text = " ".join(str(error).split())
    line = re.search(r"[Ll]ine:? (\d+)", text)
    return SceneError(text, file=file, line=int(line.group(1)) if line and file is not None else None)
