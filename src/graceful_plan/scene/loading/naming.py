"""Names in MuJoCo models: validity and lookup."""

from __future__ import annotations

from typing import TypeGuard

import mujoco

from graceful_plan.exceptions import SceneError


def is_name(name: object) -> TypeGuard[str]:
    """Return whether MuJoCo accepts a value as a name: it crashes on None and truncates at the first null byte."""
    if not isinstance(name, str) or not name or "\0" in name:
        return False
    return not any("\ud800" <= sign <= "\udfff" for sign in name)  # surrogates, invalid in UTF-8


def lookup(model: mujoco.MjModel, kind: mujoco.mjtObj, name: object) -> int:
    """Return an id by name; -1 if there is none."""
    return mujoco.mj_name2id(model, kind, name) if is_name(name) else -1


def check_new(spec: mujoco.MjSpec, name: object) -> None:
    """Check that a name is valid and unused, for a new body with its geom.

    Raises:
        SceneError: If the name is invalid or taken.
    """
    if not is_name(name):
        raise SceneError(f"the name {name!r} is empty or not a valid text")
    if spec.body(name) is not None or spec.geom(name) is not None:
        raise SceneError(f"the name {name!r} is taken")
