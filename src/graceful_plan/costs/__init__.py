"""Costs: the contract, motion cost, impact, composable costs, and the objective that combines them."""

from graceful_plan.costs.blocks.clearance_cost import ClearanceCost
from graceful_plan.costs.blocks.posture_costs import EnergyCost, JointCost, ManipulabilityCost, PoseCost

__all__ = ["ClearanceCost", "EnergyCost", "JointCost", "ManipulabilityCost", "PoseCost"]
