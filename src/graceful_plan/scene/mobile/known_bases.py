"""Bases of the bundled robots, as defined in their models."""

from __future__ import annotations

from dataclasses import replace

import mujoco

from graceful_plan.exceptions import UnknownNameError
from graceful_plan.scene.loading.robot_models import robot_file, robots
from graceful_plan.scene.mobile.diff_drive import DiffDrive
from graceful_plan.scene.mobile.wheels import described_drive


def known_base(name: str, prefix: str | None = None) -> DiffDrive:
    """Return the base of a bundled robot.

    Args:
        name: "jackal" or "fetch". Comments in their models say which values are published and which are assumed.
        prefix: Prefix of the names of its joints and bodies; default: its name and "/".

    Raises:
        UnknownNameError: If there is no such robot with a mobile base.
    """
    found = {robot: _base(robot) for robot in robots()}
    base = found.get(name)
    if base is None:
        raise UnknownNameError(
            "robot that drives", name, (robot for robot, drive in found.items() if drive is not None)
        )
    before = f"{name}/" if prefix is None else prefix
    x, y, yaw = (f"{before}{joint}" for joint in base.joints)
    return replace(base, joints=(x, y, yaw), wheels=tuple(f"{before}{wheel}" for wheel in base.wheels))


def _base(robot: str) -> DiffDrive | None:
    return described_drive(mujoco.MjSpec.from_file(str(robot_file(robot))), "")
