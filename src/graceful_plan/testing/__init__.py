"""Checks that report contract violations to the author of a planner or a cost.

    from graceful_plan.testing import check_cost, check_planner
    check_planner(MyPlanner())
    check_cost(MyCost(), scene)

Each check runs the object, compares the results with the contract, and reports all findings together.
"""

from graceful_plan.testing.contract import ContractError
from graceful_plan.testing.costs import check_cost
from graceful_plan.testing.planners import PlannerTrial, check_planner

__all__ = ["ContractError", "PlannerTrial", "check_cost", "check_planner"]
