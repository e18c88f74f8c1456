"""Early checks of planner settings."""

from __future__ import annotations

import numpy as np

from graceful_plan.exceptions import SettingError
from graceful_plan.path import is_real, is_whole

MOST = 2**31 - 1
"""Largest integer of the core."""


def positive(name: str, value: float | None) -> None:
    """Check that a setting is finite and above 0, or None, which means "chosen from the problem".

    Raises:
        SettingError: If it is not; with the name of the setting.
    """
    if value is not None and not (is_real(value) and 0.0 < value < np.inf):
        raise SettingError(name, value, "a finite number > 0")


def fraction(name: str, value: float) -> None:
    """Check that a setting is in [0, 1].

    Raises:
        SettingError: If it is not; with the name of the setting.
    """
    if not (is_real(value) and 0.0 <= value <= 1.0):
        raise SettingError(name, value, "a number in [0, 1]")


def positive_fraction(name: str, value: float) -> None:
    """Check that a setting is in (0, 1].

    Raises:
        SettingError: If it is not; with the name of the setting.
    """
    if not (is_real(value) and 0.0 < value <= 1.0):
        raise SettingError(name, value, "a number in (0, 1]")


def count(name: str, value: int, least: int = 1, most: int = MOST) -> None:
    """Check that a setting is an integer from `least` to `most`.

    Raises:
        SettingError: If it is not; with the name of the setting.
    """
    if not is_whole(value) or value < least:
        raise SettingError(name, value, f"an integer >= {least}")
    if value > most:
        raise SettingError(name, value, f"an integer <= {most}")
