"""A related objective that is much cheaper to evaluate; its motions are starts of descents along the full objective.

With arm failures in the objective, or impact energies and another model than the mixture, a state takes many times
longer to evaluate than with drops alone, so a search explores little in the same time. A plan for drops alone often has
a lower full cost than the result of that search.
"""

from __future__ import annotations

from graceful_plan.costs.consequence import Damage
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.models.mixture.mixture import FailureMixture
from graceful_plan.costs.objective import Objective, SceneObjective


def proxy_objective(objective: SceneObjective) -> SceneObjective | None:
    """Return a related objective that is much cheaper to evaluate; None if this one is cheap itself.

    It is the contacts of drops for a mixture with arm failures or a model without native kernel of its damage, and the
    length for a custom cost.
    """
    impact = objective.objective.impact
    if objective.w == 0.0 or not objective.motion_is_length:
        return None
    if not isinstance(impact, ImpactCost):
        return Objective(w=0.0).bind(objective.scene, objective.paces)
    drops, model = ImpactCost(model=FailureMixture()), impact.interaction
    mixed = isinstance(model, FailureMixture) and model.components != drops.components
    if mixed or isinstance(model, Damage):
        return Objective(impact=drops, w=objective.w).bind(objective.scene, objective.paces)
    return None
