"""Goals given as a pose of the base."""

from __future__ import annotations

from dataclasses import dataclass

from graceful_plan.path import plain_numbers
from graceful_plan.setting_checks import finite


@dataclass(frozen=True)
class BasePose:
    """A pose of the base as a goal; the arm stays in its start configuration.

    Args:
        x: Position in W [m].
        y: Position in W [m].
        yaw: Heading [rad]; None for any.

    Raises:
        SettingError: If a value is not a finite number.
    """

    x: float
    y: float
    yaw: float | None = None

    def __post_init__(self) -> None:
        plain_numbers(self)
        for name in ("x", "y", "yaw"):
            value = getattr(self, name)
            if value is None and name == "yaw":
                continue
            finite(f"BasePose.{name}", value)
