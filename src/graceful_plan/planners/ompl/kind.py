"""Description of an OMPL planner without importing OMPL."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, final


@final
@dataclass(frozen=True)
class Kind:
    """A planner of OMPL.

    Args:
        name: Name of its class in `ompl.geometric`.
        configure: Function that applies settings to the OMPL planner.
        informed: Whether to draw and keep only states that can improve the best path.
    """

    name: str
    configure: Callable[[Any], None]
    informed: bool = False


def set_growth(planner: Any, goal_bias: float, extension: float | None) -> None:
    """Set goal bias and range of a tree planner of OMPL.

    Args:
        planner: Planner of OMPL.
        goal_bias: Share of samples that are a goal.
        extension: Longest extension [rad]; OMPL's default if None.
    """
    planner.setGoalBias(goal_bias)
    if extension is not None:
        planner.setRange(extension)
