"""What a plan for a costly objective can have for little: motions for a cheaper one, which compete by the full J.

Where failing arms count or what a hit does, a state costs many times what a drop does, so that a search in the same
time sees little. A plan for drops alone is often better by the full objective than what that search finds. It is
planned first, in a part of the time. Its motions descend along the full objective, or, if that has no descents, a
search for it begins with them.

The same holds where next to nothing may slop over a rim: how long a motion takes, and so what it costs, is decided by
that, of which a search by paths knows nothing. What is planned first is then the shortest motion.
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
from graceful_plan.query.search import Search

_SHARE = 0.65
"""Of the budget for motions of the cheaper objective."""
_OWN_SHARE = 0.1
"""The same where the full objective has no descents, so that all else is up to its search."""
_CALM_SHARE = 0.3
"""The same where next to nothing may slop over a rim. In place of a search by J, at 1 s it took J of two soups, a plate
and a frying pan from 107, 89, 3.6 and 11.7 to 80, 49, 3.2 and 9.6; the w = 0 motion of the first had 83."""
_CALM_LEAST, _CALM_AND_SEARCHED = 0.7, 2.0
"""Time limits of a call from which on there is room for that, for timing four motions there takes 0.1 s, and for a
search by J besides, which took J of the first soup from 81 to 72 at 4 s [s]."""
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


def is_enough(request: Request) -> bool:
    """Whether motions for the cheaper objective lie where good ones lie, and need but to descend along this one."""
    if cheaper(request.objective) is not None:
        return _descends(request.objective)
    return _is_calm(request) and request.clock.limit < _CALM_AND_SEARCHED


def _descends(objective: SceneObjective) -> bool:
    return objective.descended() is not None and isinstance(objective.objective.impact, ImpactCost)


def _is_calm(request: Request) -> bool:
    """Whether what is carried decides how long motions take, and there is time to begin with the shortest."""
    calm = request.constraints.calm and request.clock.limit >= _CALM_LEAST
    return calm and request.objective.w > 0.0 and _descends(request.objective)


def _first(request: Request) -> tuple[SceneObjective, float] | None:
    """Return what to plan for first, and its share of the budget; None if nothing is worth it."""
    objective = request.objective
    related = cheaper(objective)
    if related is not None:
        return related, _SHARE if _descends(objective) else _OWN_SHARE
    if _is_calm(request):
        return Objective(w=0.0).bind(objective.scene, objective.paces), _CALM_SHARE
    return None


def known_motions(
    request: Request, problem: SceneProblem, ends: Ends, budget: Budget, rng: np.random.Generator
) -> list[Motion]:
    """Plan for a cheaper objective in a share of the budget; return motions charged by the full one, the best first."""
    first = _first(request)
    if first is None:
        return []
    objective, share = first
    asked = replace(request, objective=objective, preference=None, callback=None)
    with budget.share(share * budget.remaining_seconds, share * budget.remaining_iterations) as part:
        known = known_motions(asked, problem, ends, part, rng)
        found = Search() if known and is_enough(asked) else search_for_motions(asked, problem, part, rng)
        cheap = motions(found, asked, ends, problem, (part, rng), known)[0]
    return sorted((recharged(one, request) for one in cheap[:_KEPT]), key=lambda one: one.ranking)


def beginning_with(known: list[Motion], request: Request) -> Planner:
    """Return a planner that begins with the best motion for a related objective, if it can."""
    planner, related = request.planner, cheaper(request.objective) is not None
    if not known or not related or not isinstance(planner, Auto) or planner.initial is not None:
        return planner
    return replace(planner, initial=known[0].path)
