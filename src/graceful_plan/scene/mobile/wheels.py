"""The drive described in a robot's model."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import MISSING, fields

import mujoco
import numpy as np

from graceful_plan.exceptions import SceneError
from graceful_plan.scene.loading.naming import is_name
from graceful_plan.scene.mobile.diff_drive import DiffDrive

KEEP_OUT = "keep_out"
"""Name prefix of geoms that exist only for planning: over stairs going down, where a base must not drive."""


def described_drive(spec: mujoco.MjSpec, robot: str, planned: Collection[str] | None = None) -> DiffDrive | None:
    """Read the drive of a robot from its model: texts and numerics "<robot>drive/FIELD", with the fields of DiffDrive.

    Names of joints and wheels are without prefix, separated by spaces.

    Args:
        spec: The model.
        robot: Prefix of the names of the robot's bodies, or its root body.
        planned: Names of the joints to plan; all by default.

    Returns:
        The base; None if the model does not describe one, or not all of its joints are planned.

    Raises:
        SceneError: If the description is incomplete or has unknown fields.
    """
    prefix = robot[: robot.rfind("/") + 1] if is_name(robot) and spec.body(robot) is not None else robot
    start = f"{prefix}drive/"
    told: dict[str, object] = {}
    for text in spec.texts:
        if text.name.startswith(start):
            told[text.name.removeprefix(start)] = tuple(prefix + name for name in text.data.split())
    for number in spec.numerics:
        if number.name.startswith(start):
            told[number.name.removeprefix(start)] = float(np.array(number.data)[0])
    if not told:
        return None
    known = {item.name: item.default is MISSING for item in fields(DiffDrive)}
    wrong = sorted(set(told) - set(known))
    missing = [name for name, needed in known.items() if needed and name not in told]
    if wrong or missing:
        what = f"does not know {', '.join(wrong)}" if wrong else f"needs {', '.join(missing)}"
        raise SceneError(f"the drive of {robot!r} in its model {what}; its fields are {', '.join(known)}")
    if "reverse" in told:
        told["reverse"] = bool(told["reverse"])
    drive = DiffDrive(**told)  # pyright: ignore[reportArgumentType]  checked by DiffDrive
    return drive if planned is None or set(drive.joints).issubset(planned) else None
