"""What a plan for a costly objective can have for little: motions for a cheaper one, which compete by the full J.

Where failing arms count or what a hit does, a state costs many times what a drop does, so that a search in the same
time sees little. A plan for drops alone is often better by the full objective than what that search finds. It is
planned first, in a part of the time. Its motions descend along the full objective, or, if that has no descents, a
search for it begins with them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.models.mixture.mixture import Footprint
from graceful_plan.costs.objective import Objective, SceneObjective
from graceful_plan.planners.anytime.auto import Auto
from graceful_plan.planners.planner import Budget, Planner
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.query.ends import Ends
from graceful_plan.query.motions import Motion, motions, recharged
from graceful_plan.query.request import Request
from graceful_plan.query.restarts import search_for_motions

_SHARE = 0.65
"""Of the budget for motions of the cheaper objective."""
_OWN_SHARE = 0.1
"""The same where the full objective has no descents, so that all else is up to its search."""
_KEPT = 2
"""Of these motions; to charge one takes as long as many steps of a descent."""


def cheaper(objective: SceneObjective) -> SceneObjective | None:
    """Return an objective that is much cheaper to plan for and related; None if this one is cheap.

    Of a mixture with failing arms and of damage by energy it is the contacts of drops; of a cost of one's own, length.
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


def is_enough(objective: SceneObjective) -> bool:
    """Whether motions for the cheaper objective lie where good ones lie, and need but to descend along this one."""
    return objective.descended() is not None and isinstance(objective.objective.impact, ImpactCost)


def known_motions(
    request: Request, problem: SceneProblem, ends: Ends, budget: Budget, rng: np.random.Generator
) -> list[Motion]:
    """Plan for a cheaper objective in a share of the budget; return motions charged by the full one, the best first."""
    objective = cheaper(request.objective)
    if objective is None:
        return []
    asked = replace(request, objective=objective, preference=None, callback=None)
    share = _SHARE if is_enough(request.objective) else _OWN_SHARE
    with budget.share(share * budget.remaining_seconds, share * budget.remaining_iterations) as part:
        found = search_for_motions(asked, problem, part, rng)
        cheap = motions(found, asked, ends, problem, (part, rng))[0]
    return sorted((recharged(one, request) for one in cheap[:_KEPT]), key=lambda one: one.ranking)


def beginning_with(known: list[Motion], planner: Planner) -> Planner:
    """Return a planner that begins with the best of some motions, if it can."""
    if not known or not isinstance(planner, Auto) or planner.initial is not None:
        return planner
    return replace(planner, initial=known[0].path)
