"""Costs: the contract, motion, impact, blocks to compose, and the objective that puts them together."""

from graceful_plan.costs.blocks.clearance_cost import ClearanceCost
from graceful_plan.costs.blocks.posture_costs import EnergyCost, JointCost, ManipulabilityCost, PoseCost

__all__ = ["ClearanceCost", "EnergyCost", "JointCost", "ManipulabilityCost", "PoseCost"]
