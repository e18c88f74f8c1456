"""Configurations given by the user: numbers, or names of keyframes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import ShapeError, UnsupportedError
from graceful_plan.path import finite_array
from graceful_plan.scene.scene import Scene
from graceful_plan.scene.tasks import named_configuration
from graceful_plan.timing.trajectory import State

_ROUNDING = 1e-12
"""Rounding error of a number of turns."""
Configuration = ArrayLike | str
"""A configuration [nq] or the name of a keyframe."""


def configurations_of(goal: Configuration | Sequence[Configuration], scene: Scene) -> Float[Array, "n nq"]:
    """Return configurations and keyframes as rows.

    Raises:
        ShapeError: If a configuration does not fit the scene's joints.
        NonFiniteError: If a configuration contains a NaN or an infinity.
        UnknownNameError: If a keyframe does not exist.
        UnsupportedError: If a goal is the state of a robot that moves; `plan` and `replan` take one such goal.
    """
    if isinstance(goal, State) or (isinstance(goal, Sequence) and any(isinstance(item, State) for item in goal)):
        raise UnsupportedError("a goal with a velocity is for plan() and replan(), and must be the only goal")
    nq = len(scene.joints)
    if isinstance(goal, str):
        return named_configuration(goal, scene)[None]
    if isinstance(goal, Sequence) and any(isinstance(item, str) for item in goal):
        return np.concatenate([configurations_of(item, scene) for item in goal])  # type: ignore[arg-type]
    q = finite_array("goal", goal, last=nq)  # type: ignore[arg-type]
    if q.ndim > 2 or q.size == 0:
        raise ShapeError("goal", q.shape, f"({nq},) or (n >= 1, {nq})")
    return np.atleast_2d(q)


def wrapped_near(q: Float[Array, "n nq"], start: Float[Array, " nq"], scene: Scene) -> Float[Array, "n nq"]:
    """Return goals with continuous joints wrapped by full turns to be near the start, within the planning range."""
    lower, upper = scene.limits.position.T
    turned = q - 2.0 * np.pi * np.round((q - start) / (2.0 * np.pi))
    turned = turned + 2.0 * np.pi * ((turned < lower).astype(float) - (turned > upper))
    return np.where(scene.endless, turned, q)


def nearest_turns(q: Float[Array, "n nq"], start: Float[Array, " nq"], scene: Scene) -> Float[Array, "n nq"]:
    """Return configurations with each hinge turned by whole turns to be as near to the start as its limits allow.

    The tool stays where it is, so this is for configurations that were found for a pose.
    """
    lower, upper = scene.limits.position.T
    turn = 2.0 * np.pi
    # Whole turns that stay within the limits; a configuration outside of them stays as it is.
    least, most = np.ceil((lower - q) / turn - _ROUNDING), np.floor((upper - q) / turn + _ROUNDING)
    turns = np.clip(np.round((start - q) / turn), least, np.maximum(least, most))
    return np.where(scene.hinges & (least <= most), np.clip(q + turn * turns, lower, upper), q)


def goal_labels(count: int) -> Sequence[str]:
    """Return names of goals for messages."""
    return ["goal"] if count == 1 else [f"goal {k}" for k in range(count)]
