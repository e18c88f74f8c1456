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
