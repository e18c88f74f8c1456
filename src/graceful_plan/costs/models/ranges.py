"""Range checks of model constants."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from graceful_plan.exceptions import SettingError
from graceful_plan.setting_checks import finite


def check_ranges(values: Mapping[str, float], *, positive: Collection[str], not_negative: Collection[str]) -> None:
    """Check that constants are finite and within their ranges.

    Raises:
        SettingError: For the first constant that is not.
    """
    for name, value in values.items():
        finite(name, value)
        if name in positive and value <= 0.0:
            raise SettingError(name, value, "a positive number")
        if name in not_negative and value < 0.0:
            raise SettingError(name, value, "at least 0")
