"""How bundled robots drive, from published facts."""

from __future__ import annotations

from graceful_plan.exceptions import UnknownNameError
from graceful_plan.scene.mobile.diff_drive import DiffDrive

_WHEELS = ("front_left", "rear_left", "front_right", "rear_right")


def known_base(name: str, prefix: str | None = None) -> DiffDrive:
    """Return how a bundled robot drives.

    Args:
        name: "jackal". Its accelerations are bounded by friction alone, so that these are ours.
        prefix: Before the names of its joints and bodies; default: its name and "/".

    Raises:
        UnknownNameError: If there is no such robot.
    """
    if name != "jackal":
        raise UnknownNameError("robot that drives", name, ("jackal",))
    before = f"{name}/" if prefix is None else prefix
    return DiffDrive(
        joints=(f"{before}x", f"{before}y", f"{before}yaw"),
        radius=0.098,
        track=0.3756,
        slip=1.487,
        v_max=2.0,
        omega_max=4.0,
        a_max=2.0,
        alpha_max=6.0,
        wheels=tuple(f"{before}{wheel}" for wheel in _WHEELS),
    )
