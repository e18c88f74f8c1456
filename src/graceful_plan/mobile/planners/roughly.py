"""Impact on those who move as searches ask for it: thousands of times, and not to the last percent."""

from __future__ import annotations

from dataclasses import replace

from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.models.mixture.mixture import Footprint
from graceful_plan.mobile.coast.coast import Coast
from graceful_plan.mobile.coast.thinned import thinned

_PLACES = 12
"""Of somebody who moves, where a search drops things on her."""


def roughly(cost: ImpactCost) -> ImpactCost:
    """Return a cost that is close and takes a tenth of the time for a base that fails, and half for drops."""
    model = cost.interaction
    if not isinstance(model, Footprint):
        return cost
    base = Coast() if model.base is None else model.base
    if isinstance(base, Coast):
        base = Coast(thinned(base.settings))
    return replace(cost, model=replace(model, base=base, places=min(_PLACES, model.places)))
