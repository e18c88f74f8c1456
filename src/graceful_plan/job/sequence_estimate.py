"""Estimate of the cost of a sequence from the actions that were planned already.

The harm that an action does to an object depends on whether that object stands at its place at the start or elsewhere.
So the harm of each action is kept for each object and for both cases, as the least that was seen; a case that was not
seen yet counts as no harm, so orders with it are tried. The rest of the cost of an action above its lower bound is kept
by its choice, and by protection, such as closed lids.

Of two objects that are both still to be moved, one passes the other first: the better order counts. The sum over pairs
is a lower bound of the linear ordering problem [1].

References:
    [1] R. Marti and G. Reinelt, "The Linear Ordering Problem", Springer, 2011.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations

_RATIO = 2.0
"""Ratio of motion cost to lower bound that is assumed at first; it counts as one observation."""


@dataclass(eq=False)
class KnownCosts:
    """Costs of planned actions, each named by the object that it moves."""

    _above: dict[Hashable, float] = field(default_factory=dict)
    """Least cost above the lower bound, without harm to objects that move, by object and key."""
    _motion: dict[str, float] = field(default_factory=dict)
    """Least motion cost."""
    _harm: dict[tuple[str, str, bool], float] = field(default_factory=dict)
    """Least harm to another object, by whether that one is elsewhere than at the start."""
    _ratio: tuple[float, int] = (_RATIO, 1)
    """Sum and number of ratios of motion cost to lower bound."""

    def learn(
        self,
        name: str,
        *,
        keys: Sequence[Hashable],
        bound: float,
        cost: float,
        motion: float,
        harm: Mapping[tuple[str, bool], float],
    ) -> None:
        """Remember a planned action.

        Args:
            name: The object.
            keys: From the choice to what other choices have in common.
            bound: Lower bound of the cost.
            cost: The cost.
            motion: Its motion part.
            harm: Its harm to other objects, by whether each is elsewhere than at the start.
        """
        above = cost - bound - sum(harm.values())
        for key in keys:
            self._above[name, key] = min(above, self._above.get((name, key), float("inf")))
        self._motion[name] = min(motion, self._motion.get(name, float("inf")))
        for (other, moved), value in harm.items():
            self._harm[name, other, moved] = min(value, self._harm.get((name, other, moved), float("inf")))
        if bound > 0.0:
            total, count = self._ratio
            self._ratio = total + motion / bound, count + 1

    def cost(self, name: str, keys: Sequence[Hashable], bound: float, elsewhere: Mapping[str, bool]) -> float:
        """Return the estimated cost of an action, given which other objects are elsewhere than at the start."""
        for key in keys:
            if (above := self._above.get((name, key))) is not None:
                return max(bound, bound + above + self._passing(name, elsewhere))
        return max(bound, self.motion(name, bound))

    def rest(self, bounds: Mapping[str, float], protection: Hashable, elsewhere: Mapping[str, bool]) -> float:
        """Return the estimated cost of moving some objects, in the best order of each two of them."""
        standing = {name: moved for name, moved in elsewhere.items() if name not in bounds}
        alone = sum(self.cost(name, (protection,), bound, standing) for name, bound in bounds.items())
        return alone + sum(
            min(self._seen(a, b, False) + self._seen(b, a, True), self._seen(b, a, False) + self._seen(a, b, True))
            for a, b in combinations(bounds, 2)
        )

    def motion(self, name: str, bound: float) -> float:
        """Return the estimated motion cost of moving an object."""
        return self._motion.get(name, bound * self._ratio[0] / self._ratio[1])

    def _passing(self, name: str, elsewhere: Mapping[str, bool]) -> float:
        return sum(self._seen(name, other, moved) for other, moved in elsewhere.items())

    def _seen(self, name: str, other: str, moved: bool) -> float:
        return self._harm.get((name, other, moved), 0.0)
