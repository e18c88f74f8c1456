"""Alternatives that the search over sequences rejected: other orders, other actions, and why.

Alternatives are told apart by kinds of actions and objects. One alternative stands for all its grasps and placements.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum

from graceful_plan.job.motions import Refusal
from graceful_plan.result import CostBreakdown

_WORST = 3
"""Largest number of entities that a sentence names."""
Actions = tuple[tuple[str, str], ...]
"""Kind and object of each action, one after the other."""


class Reason(Enum):
    """Why an alternative was rejected; each value is a sentence."""

    COSTLIER = "It costs more."
    BOUNDED = "It cannot cost less: its lower bound exceeds the cost of the best sequence."
    SAME_STATE = "Other actions lead to the same state at less cost."
    REFUSED = "Its last action is not possible."
    DEAD_END = "The goals are not met after it, and no further action is possible."
    UNFINISHED = "The search ended before it was complete."


@dataclass(frozen=True, kw_only=True, eq=False)
class Rejected:
    """An alternative that is not the result, and why.

    | field       | meaning                                                                                           |
    |-------------|---------------------------------------------------------------------------------------------------|
    | actions     | kind and object of each action, up to the one that decided; a whole sequence if it `is_complete`  |
    | reason      | why it was rejected                                                                               |
    | is_complete | whether the actions meet all goals                                                                |
    | cost        | cost of the actions; None if they were not all planned                                            |
    | against     | cost of the chosen sequence with motions planned with the same effort; None if not comparable     |
    | lower_bound | lower bound of the cost of all sequences that begin with these actions                            |
    | refusal     | of the last action: a sentence, and the bodies in the way; None if it was not refused             |
    | refused     | number of grasps and placements that were refused                                                 |
    """

    actions: Actions
    reason: Reason
    is_complete: bool = False
    cost: CostBreakdown | None = None
    against: CostBreakdown | None = None
    lower_bound: float = 0.0
    refusal: Refusal | None = None
    refused: int = 0

    @property
    def difference(self) -> float:
        """How much more it costs than the chosen sequence; NaN if that is not known."""
        return math.nan if self.cost is None or self.against is None else self.cost.total - self.against.total

    @property
    def name(self) -> str:
        """The actions as text."""
        return ", ".join(f"{kind} {name}" if kind != name else kind for kind, name in self.actions)

    @property
    def why(self) -> str:
        """The reason as text, with its values."""
        if self.reason is Reason.COSTLIER and self.cost is not None and self.against is not None:
            return f"costs {self.difference:.3g} more at w = {self.cost.w:g}: {change(self.cost, self.against)}"
        if self.reason is Reason.BOUNDED:
            return f"costs at least {self.lower_bound:.3g}, more than the best sequence"
        if self.reason is Reason.REFUSED and self.refusal is not None:
            tried = f" ({self.refused} choices)" if self.refused > 1 else ""
            return f"refused{tried}: {self.refusal.why}"
        if self.reason is Reason.UNFINISHED:
            told = f": {self.refusal.why}" if self.refusal is not None else ""
            return f"not completed before the search ended{told}; costs at least {self.lower_bound:.3g}"
        return self.reason.value

    def __str__(self) -> str:
        return f"{self.name}: {self.why}"


def change(cost: CostBreakdown, against: CostBreakdown) -> str:
    """Return the differences of two costs as text, with the entities whose harm differs most."""
    more, less = cost.impact_by_entity, against.impact_by_entity
    by_entity = {name: more.get(name, 0.0) - less.get(name, 0.0) for name in {*more, *less}}
    worst = sorted(by_entity, key=lambda name: (-abs(by_entity[name]), name))[:_WORST]
    told = ", ".join(f"{name} {by_entity[name]:+.3g}" for name in worst if abs(by_entity[name]) > 1e-3)
    motion, impact = cost.motion - against.motion, cost.impact - against.impact
    return f"motion {motion:+.3g} rad, impact {impact:+.3g}{f' ({told})' if told else ''}"


@dataclass(eq=False)
class _Tried:
    """What became of the choices of an alternative."""

    complete: CostBreakdown | None = None
    """Least cost with which all goals were met."""
    repeated: CostBreakdown | None = None
    """Least cost of reaching a state that other actions had reached at less cost."""
    is_expanded: bool = False
    bound: float = math.inf
    """Least lower bound of the choices that were discarded for it."""
    refusal: Refusal | None = None
    refused: int = 0
    refused_bound: float = math.inf
    unsure: Refusal | None = None


@dataclass(eq=False)
class SearchRecord:
    """What became of each alternative of a search; kept during the search."""

    _outcomes: dict[Actions, _Tried] = field(default_factory=dict)

    def _of(self, actions: Actions) -> _Tried:
        return self._outcomes.setdefault(actions, _Tried())

    def reached(self, actions: Actions, cost: CostBreakdown, *, is_complete: bool, is_new: bool) -> None:
        """Note that some choices were planned; `is_new` tells that their state was not reached at less cost before."""
        outcome = self._of(actions)
        if is_complete:
            outcome.complete = _cheaper(cost, outcome.complete)
        elif is_new:
            outcome.is_expanded = True
        else:
            outcome.repeated = _cheaper(cost, outcome.repeated)

    def bounded(self, actions: Actions, bound: float) -> None:
        """Note that a choice was discarded for its lower bound."""
        outcome = self._of(actions)
        outcome.bound = min(outcome.bound, bound)

    def refused(self, actions: Actions, refusal: Refusal, bound: float) -> None:
        """Note that a choice is not possible, or that no motion was found in time."""
        outcome = self._of(actions)
        outcome.refused_bound = min(outcome.refused_bound, bound)
        if refusal.unsure:
            outcome.unsure = refusal
            return
        outcome.refused += 1
        if outcome.refusal is None or (refusal.by_any_grasp and not outcome.refusal.by_any_grasp):
            outcome.refusal = refusal

    def rejected(
        self,
        left: Iterable[tuple[Actions, float]],
        chosen: ChosenSequence | None,
        improved: Mapping[Actions, CostBreakdown],
    ) -> tuple[Rejected, ...]:
        """Return the alternatives other than the chosen sequence.

        Args:
            left: Choices that were not planned, with lower bounds.
            chosen: The chosen sequence; None if there is none.
            improved: Costs of the sequences whose motions were improved.
        """
        least: dict[Actions, float] = {}
        for actions, bound in left:
            least[actions] = min(bound, least.get(actions, math.inf))
        known = {*self._outcomes, *least}
        longer = {actions[:n] for actions in known for n in range(len(actions))}
        found = []
        for actions in known - {() if chosen is None else chosen.actions, ()}:
            outcome = self._outcomes.get(actions, _Tried())
            if outcome.complete is not None:
                assert chosen is not None
                cost, against = outcome.complete, chosen.first
                if actions in improved:
                    cost, against = improved[actions], chosen.cost
                found.append(
                    Rejected(actions=actions, reason=Reason.COSTLIER, is_complete=True, cost=cost, against=against)
                )
            elif actions not in longer:
                most = math.inf if chosen is None else chosen.best
                found.append(_of_leaf(actions, outcome, least.get(actions, math.inf), most))
        return tuple(sorted(found, key=_place))


@dataclass(frozen=True, kw_only=True, eq=False)
class ChosenSequence:
    """The result: its actions, its cost, that of its first motions, and the least cost before motions were improved."""

    actions: Actions
    cost: CostBreakdown
    first: CostBreakdown
    best: float


def _of_leaf(actions: Actions, outcome: _Tried, left: float, most: float) -> Rejected:
    """Return why a sequence of actions was not continued; `left` is the least lower bound of its open choices."""
    one = Rejected(actions=actions, reason=Reason.REFUSED, refusal=outcome.refusal, refused=outcome.refused)
    if left < most:
        return replace(one, reason=Reason.UNFINISHED, lower_bound=left, refusal=outcome.unsure)
    if (bound := min(left, outcome.bound)) < math.inf:
        return replace(one, reason=Reason.BOUNDED, lower_bound=bound)
    if outcome.unsure is not None:
        return replace(one, reason=Reason.UNFINISHED, lower_bound=outcome.refused_bound, refusal=outcome.unsure)
    if outcome.is_expanded:
        return replace(one, reason=Reason.DEAD_END)
    if outcome.repeated is not None:
        return replace(one, reason=Reason.SAME_STATE, cost=outcome.repeated)
    return one


def _cheaper(cost: CostBreakdown, other: CostBreakdown | None) -> CostBreakdown:
    return cost if other is None or cost.total < other.total else other


def _place(one: Rejected) -> tuple[int, float, str]:
    """Return the place of an alternative in their order."""
    value = one.lower_bound if math.isnan(one.difference) else one.difference
    return list(Reason).index(one.reason), value, one.name
