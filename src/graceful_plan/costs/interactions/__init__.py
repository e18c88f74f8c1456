"""Interaction models, one a file; the words that select them."""

from graceful_plan.costs.interactions.aabb import BoxOverlap
from graceful_plan.costs.interactions.footprint import Footprint
from graceful_plan.costs.interactions.interaction import InteractionModel

MODELS: dict[str, type[InteractionModel]] = {"aabb": BoxOverlap, "footprint": Footprint}
"""Models by the word that selects them in `ImpactCost(model=...)`."""

__all__ = ["MODELS", "BoxOverlap", "Footprint", "InteractionModel"]
