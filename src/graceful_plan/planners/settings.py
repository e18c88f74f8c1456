"""Early checks of planner settings."""

from __future__ import annotations

import numpy as np

from graceful_plan.exceptions import SettingError
from graceful_plan.path import is_real

MOST = 2**31 - 1
"""What the core counts to."""


def positive(name: str, value: float | None) -> None:
    """Refuse numbers that are not finite and above 0; None means "choose by the problem" and passes.

    Raises:
        SettingError: With the name of the setting.
    """
    if value is not None and not (is_real(value) and 0.0 < value < np.inf):
        raise SettingError(name, value, "a finite number > 0")


def fraction(name: str, value: float) -> None:
    """Refuse numbers outside of [0, 1].

    Raises:
        SettingError: With the name of the setting.
    """
    if not (is_real(value) and 0.0 <= value <= 1.0):
        raise SettingError(name, value, "a number in [0, 1]")


def positive_fraction(name: str, value: float) -> None:
    """Refuse numbers outside of (0, 1].

    Raises:
        SettingError: With the name of the setting.
    """
    if not (is_real(value) and 0.0 < value <= 1.0):
        raise SettingError(name, value, "a number in (0, 1]")


def count(name: str, value: int, least: int = 1, most: int = MOST) -> None:
    """Refuse anything but an integer of at least `least` and at most `most`.

    Raises:
        SettingError: With the name of the setting.
    """
    if isinstance(value, bool) or not isinstance(value, int) or value < least:
        raise SettingError(name, value, f"an integer >= {least}")
    if value > most:
        raise SettingError(name, value, f"an integer <= {most}")
