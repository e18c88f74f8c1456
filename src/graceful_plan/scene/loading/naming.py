"""Names in MuJoCo models: what can be one, and whose it is."""

from __future__ import annotations

from typing import TypeGuard

import mujoco

from graceful_plan.exceptions import SceneError


def is_name(name: object) -> TypeGuard[str]:
    """Whether it can be the name of anything: MuJoCo crashes on None, and ends a text at its first null."""
    if not isinstance(name, str) or not name or "\0" in name:
        return False
    return not any("\ud800" <= sign <= "\udfff" for sign in name)  # UTF-8 has none of these


def lookup(model: mujoco.MjModel, kind: mujoco.mjtObj, name: object) -> int:
    """Return an id by name, -1 if there is none."""
    return mujoco.mj_name2id(model, kind, name) if is_name(name) else -1


def check_new(spec: mujoco.MjSpec, name: object) -> None:
    """Refuse what cannot be the name of a new body with its geom.

    Raises:
        SceneError: If it is no name, or taken.
    """
    if not is_name(name):
        raise SceneError(f"the name {name!r} is empty, or no text that a model can hold")
    if spec.body(name) is not None or spec.geom(name) is not None:
        raise SceneError(f"the name {name!r} is taken")
