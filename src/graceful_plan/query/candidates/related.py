"""A related objective that is much cheaper to plan for: its motions are where descents along the full one begin.

Where failing arms count, or the energy of hits, a state costs many times what a drop does, so that a search in the same
time sees little. A plan for drops alone is often better by the full objective than the result of that search.
"""

from __future__ import annotations

from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.models.mixture.mixture import Footprint
from graceful_plan.costs.objective import Objective, SceneObjective


def related_objective(objective: SceneObjective) -> SceneObjective | None:
    """Return an objective that is related and much cheaper to plan for; None if this one is cheap.

    Of a mixture with failing arms and of damage by energy it is the contacts of drops; of a custom cost, the length.
    """
    impact = objective.objective.impact
    if objective.w == 0.0 or not objective.motion_is_length:
        return None
    if not isinstance(impact, ImpactCost):
        return Objective(w=0.0).bind(objective.scene, objective.paces)
    drops = ImpactCost(model=Footprint())
    mixed = isinstance(impact.model, Footprint) and impact.model.components != drops.components
    if mixed or impact.consequence != "contact":
        return Objective(impact=drops, w=objective.w).bind(objective.scene, objective.paces)
    return None
