"""Goals given as where the base should stand."""

from __future__ import annotations

import math
from dataclasses import dataclass

from graceful_plan.exceptions import SettingError


@dataclass(frozen=True)
class BasePose:
    """Where a base should stand, the arm as it is at the start.

    Args:
        x: In W [m].
        y: In W [m].
        yaw: Heading [rad]; any if None.

    Raises:
        SettingError: If something is not a finite number.
    """

    x: float
    y: float
    yaw: float | None = None

    def __post_init__(self) -> None:
        for name in ("x", "y", "yaw"):
            value = getattr(self, name)
            if value is None and name == "yaw":
                continue
            if isinstance(value, bool) or not (isinstance(value, int | float) and math.isfinite(value)):
                raise SettingError(f"BasePose.{name}", value, "a finite number")
