"""Which of OMPL's planners is meant, without importing OMPL."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, final


@final
@dataclass(frozen=True)
class Kind:
    """A planner of OMPL.

    Args:
        name: Of its class in `ompl.geometric`.
        configure: Sets its settings.
        informed: Whether to draw and keep only states that can improve the best path.
    """

    name: str
    configure: Callable[[Any], None]
    informed: bool = False


def set_growth(planner: Any, goal_bias: float, extension: float | None) -> None:
    """Set how a tree of OMPL grows.

    Args:
        planner: OMPL's.
        goal_bias: Share of samples that are a goal.
        extension: Longest one; OMPL's own if None.
    """
    planner.setGoalBias(goal_bias)
    if extension is not None:
        planner.setRange(extension)
