"""Reasons why a job is impossible: the object, the obstacle and the remedy."""

from __future__ import annotations

from collections.abc import Iterator

from graceful_plan.job.actions import Transport
from graceful_plan.job.job_state import pose_key, pose_of
from graceful_plan.job.motions import Refusal
from graceful_plan.job.opening import Open, shut_in
from graceful_plan.job.placing import occupant, overlapping
from graceful_plan.job.rejected import Reason, Rejected
from graceful_plan.job.search import SequenceSearch
from graceful_plan.scene.elements import AllowedContact


def reasons(search: SequenceSearch) -> str:
    """Return why the goals of a search without a result cannot be met, and why other actions failed."""
    told = [why for goal in search.goals if not goal.is_done(search.start) and (why := _reason(goal, search))]
    goals = {goal.name for goal in search.goals}
    others = [refusal.why for name, refusal in search.refusals.items() if name not in goals]
    return "; ".join([*told, *_cycle(search), *others])


def conflict(search: SequenceSearch) -> str:
    """Return why the goals exclude each other: two objects that each have one place, and overlap there; or nothing."""
    arrived, names = search.start, []
    for goal in search.goals:
        if goal.onto is None and len(goal.to) == 1:
            arrived, names = arrived.moved(goal.name, pose_of(goal.to[0])), [*names, goal.name]
    supports = search.motions.supports
    on = [AllowedContact(name, other, "ends") for name in names for other in supports.get(name, ()) if other in names]
    pair = overlapping(arrived.scene().with_allowed_contacts(*on), names)
    return "" if pair is None else f"{pair[0]!r} and {pair[1]!r} overlap at their places"


def unreachable(search: SequenceSearch) -> Iterator[Rejected]:
    """Yield the goals that cannot be met by the first action, as alternatives; none if an order is given."""
    for goal in search.goals if not search.order else ():
        if goal.is_done(search.start) or next(goal.candidates(search.start, search.motions), None) is not None:
            continue
        if why := _reason(goal, search):
            refusal = Refusal(name=goal.name, why=why)
            yield Rejected(actions=((goal.kind, goal.name),), reason=Reason.REFUSED, refusal=refusal)


def _reason(goal: Transport, search: SequenceSearch) -> str | None:
    state, motions, name = search.start, search.motions, goal.name
    if next(motions.sampled(state, name), None) is None:
        return f"{name!r}: the gripper has no grasp of it"
    to = goal.poses(state)
    if not to:
        return f"{name!r}: there is no free placement"
    here = pose_key(state.pose(name))
    if all(motions.configuration(state, name, grasp, here) is None for grasp in motions.sampled(state, name)):
        if (other := occupant(state.scene(), name, pose_of(here))) is not None:
            return f"{name!r}: it overlaps {other!r} where it stands"
        return f"{name!r}: the arm reaches no grasp of it where it stands{_shut(name, search)}"
    others = state.parked(tuple(body for body in motions.movable if body != name)).scene()
    taken = [occupant(others, name, pose_of(X)) for X in to]
    if all(taken):
        return f"{name!r}: its place is taken by {taken[0]!r}; allow Clear({taken[0]!r})"
    if not any(True for _ in goal.candidates(state, motions)):
        grasps = motions.sampled(state, name)
        reached = any(motions.configuration(state, name, g, X) is not None for g in grasps for X in to)
        if not reached:
            return f"{name!r}: the arm reaches no placement of it"
        return f"{name!r}: no grasp reaches both where it stands and a placement; allow Clear({name!r})"
    refusal = search.refusals.get(name)
    return None if refusal is None else f"{refusal.why}{_shut(name, search, is_reached=True)}"


def _shut(name: str, search: SequenceSearch, *, is_reached: bool = False) -> str:
    """Return the end of a sentence about a closed drawer or door in front of an object, and the remedy."""
    found = shut_in(search.start, name, search.motions, is_reached=is_reached)
    if found is None:
        return ""
    allowed = any(isinstance(action, Open) and action.name == found.joint for action in search.actions)
    remedy = f"although {found.remedy} is allowed" if allowed else f"allow {found.remedy}"
    return f", shut in by {found.body!r} with joint {found.joint!r}; {remedy}"


def _cycle(search: SequenceSearch) -> Iterator[str]:
    """Yield a sentence about goals that block each other, if there are some."""
    goals = {goal.name for goal in search.goals}
    blocked = {name: sorted(refusal.blockers & goals) for name, refusal in search.refusals.items()}
    for name in sorted(goals):
        path = [name]
        while following := blocked.get(path[-1]):
            if following[0] == name:
                yield f"{' and '.join(map(repr, path))} block each other; allow Clear({name!r})"
                return
            if following[0] in path:
                break
            path.append(following[0])
