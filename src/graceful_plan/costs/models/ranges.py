"""Ranges of the constants of models."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping

from graceful_plan.exceptions import SettingError


def check_ranges(values: Mapping[str, float], *, positive: Collection[str], not_negative: Collection[str]) -> None:
    """Refuse constants that are not finite, or out of their range.

    Raises:
        SettingError: For the first of them.
    """
    for name, value in values.items():
        if not math.isfinite(value):
            raise SettingError(name, value, "a finite number")
        if name in positive and value <= 0.0:
            raise SettingError(name, value, "a positive number")
        if name in not_negative and value < 0.0:
            raise SettingError(name, value, "at least 0")
