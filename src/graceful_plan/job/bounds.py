"""A lower bound of the cost of all sequences, with the harm that is certain.

A* search over the states that sequences lead to, without planning: each action costs at least the straight motions of
its choice, which are known exactly in the state in which they are made, and the straight lines in joint space between
them. Approaching, gripping, lifting, lowering and releasing an object are the unavoidable part of its transport.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable

from graceful_plan.job.actions import Outlook
from graceful_plan.job.motions import Refusal
from graceful_plan.job.search import Edge, Node, SequenceSearch


def sequence_bound(search: SequenceSearch, over: Callable[[int], bool]) -> float:
    """Return a lower bound of the cost of every sequence over the choices of a search.

    Args:
        search: The search; its choices and motions are shared.
        over: Tells whether to stop, given the number of actions looked at; the bound is then lower, but still valid.
    """
    number = looked = 0
    waiting: list[tuple[float, int, Node | Edge]] = [(0.0, 0, Node(state=search.start))]
    least = 0.0
    best: dict[object, float] = {}
    while waiting:
        least, _, item = heapq.heappop(waiting)
        if over(looked) or (search.best is not None and least >= search.best.cost):
            break
        found: list[tuple[float, Node | Edge]] = []
        if isinstance(item, Node):
            if search.is_complete(item.state):
                break
            if item.cost < best.get(item.state.key, float("inf")):
                best[item.state.key] = item.cost
                found = [(search.least(edge), edge) for edge in search.edges(item)]
        else:
            looked += 1
            ahead = item.action.outlook(item.node.state, item.choice, search.motions)
            if ahead is None:  # what follows is unknown, and may be the cheapest
                break
            if isinstance(ahead, Outlook):
                child = Node(state=ahead.state, cost=item.node.cost + ahead.cost)
                found = [(child.cost + search.remaining(child), child)]
            elif isinstance(ahead, Refusal):
                found = [(search.least(edge), edge) for edge in search.instead(item, ahead)]
        for value, one in found:
            number += 1
            heapq.heappush(waiting, (max(value, least), number, one))
    return least
