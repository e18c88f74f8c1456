"""Merging of the parts of a finely divided carried object, since the drop model tests each part in every state."""

from __future__ import annotations

import numpy as np

from graceful_plan.array_types import Array, Float, Int


def groups(
    centre: Float[Array, "part 3"], around: Float[Array, "part 3"], most: int
) -> tuple[Int[Array, " part"], float]:
    """Group parts such that boxes around the groups are small.

    Pairs whose common box has the least additional volume are joined first.

    Args:
        centre: Centres of the parts in one frame.
        around: Half sizes of their boxes along the axes of that frame.
        most: Largest number of groups.

    Returns:
        The group of each part, numbered without gaps, and how far a corner of a group's box is from the nearest part of
        the group, at most [m].
    """
    low, high = centre - around, centre + around
    group = np.arange(len(centre))
    least, largest = low.copy(), high.copy()
    while len(least) > most:
        box = np.maximum(largest[:, None], largest) - np.minimum(least[:, None], least)
        own = (largest - least).prod(axis=1)
        added = box.prod(axis=2) - own[:, None] - own
        np.fill_diagonal(added, np.inf)
        a, b = sorted(divmod(int(added.argmin()), len(least)))
        least[a], largest[a] = np.minimum(least[a], least[b]), np.maximum(largest[a], largest[b])
        least, largest = np.delete(least, b, axis=0), np.delete(largest, b, axis=0)
        group = np.where(group == b, a, group - (group > b))
    excess = 0.0
    for k, (lower, upper) in enumerate(zip(least, largest, strict=True)):
        corner = np.stack(np.meshgrid(*zip(lower, upper, strict=True)), axis=-1).reshape(-1, 1, 3)
        beyond = np.maximum(np.maximum(low[group == k] - corner, corner - high[group == k]), 0.0)
        excess = max(excess, float(np.linalg.norm(beyond, axis=2).min(axis=1).max()))
    return group, excess
