"""Onset of a fault: at a fixed time, at a fraction of the trajectory, or uniform over a part of it."""

from __future__ import annotations

from dataclasses import dataclass

from graceful_plan.exceptions import SettingError
from graceful_plan.path import plain_numbers
from graceful_plan.setting_checks import fraction, not_negative


@dataclass(frozen=True)
class AtTime:
    """A fixed time after the start of the trajectory [s], clamped to its end."""

    time: float

    def __post_init__(self) -> None:
        plain_numbers(self)
        not_negative("time", self.time, "a finite time >= 0 s")

    def onset(self, u: float, duration: float) -> float:
        """Return the onset [s] on a trajectory of length `duration` [s]; `u` is ignored."""
        return min(self.time, duration)


@dataclass(frozen=True)
class AtFraction:
    """A fixed fraction of the trajectory's duration, in [0, 1]."""

    fraction: float

    def __post_init__(self) -> None:
        plain_numbers(self)
        fraction("fraction", self.fraction)

    def onset(self, u: float, duration: float) -> float:
        """Return the onset [s] on a trajectory of length `duration` [s]; `u` is ignored."""
        return self.fraction * duration


@dataclass(frozen=True)
class Uniform:
    """Uniformly distributed between two fractions of the trajectory's duration."""

    first: float = 0.0
    last: float = 1.0

    def __post_init__(self) -> None:
        plain_numbers(self)
        if not 0.0 <= self.first <= self.last <= 1.0:
            raise SettingError("first, last", (self.first, self.last), "0 <= first <= last <= 1")

    def onset(self, u: float, duration: float) -> float:
        """Return the onset [s] on a trajectory of length `duration` [s], for the quantile `u` in [0, 1]."""
        return (self.first + u * (self.last - self.first)) * duration


Onset = AtTime | AtFraction | Uniform
