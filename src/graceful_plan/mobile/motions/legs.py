"""Split paths of straight stretches and turns in place into legs: parts that a base drives in one gear.

Turns at either end of a leg are free: a curve may turn instead, partly or entirely.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.mobile.motions.drive import nearest, with_heading
from graceful_plan.mobile.motions.stages import DriveStage, Move, stages
from graceful_plan.path import Path

_SHARP = 1.2
"""Heading change above which the base should first turn in place [rad]."""
_BACKWARD = 0.1
"""Length that driving backward must save to be tried before forward [m]."""
_SMALL = 0.3
"""Turns in place below this are always made by the curve, as the alternatives hardly differ [rad]."""


@dataclass(frozen=True, eq=False)
class RollingLeg:
    """A part of a route in one gear, with turns in place before and after where the route has them.

    | field        | meaning                                                        | unit     | shape     |
    |--------------|----------------------------------------------------------------|----------|-----------|
    | q            | vertices; first heading before the turn, last heading after it | rad or m | vertex nq |
    | forward      | whether it drives forward                                      |          |           |
    | turns_before | whether it may turn in place first                             |          |           |
    | turns_after  | whether it may turn in place at the end                        |          |           |
    """

    q: Float[Array, "vertex nq"]
    forward: bool
    turns_before: bool = False
    turns_after: bool = False


ArmMove = Float[Array, "2 nq"]
Route = tuple[RollingLeg | ArmMove, ...]
"""Legs, and arm motions while the base stands."""


def routes(path: Path, *, moves_arm: bool = True) -> Iterator[Route]:
    """Yield routes along a path: first those that turn and move the arm while driving, then those that stop for it.

    Args:
        path: Straight stretches, turns in place and arm motions.
        moves_arm: Whether the arm may move while the base does.
    """
    parts = stages(path)
    route = tuple(_parts(parts))
    if moves_arm:
        yield from _turning(_arm_moved_on_the_way(route))
    if not moves_arm or any(not isinstance(part, RollingLeg) for part in route):
        yield from _turning(route)


def along_ways(
    over: Sequence[Float[Array, "_ 2"]],
    start: Float[Array, " nq"],
    goal: Float[Array, " nq"],
    reverse: bool,
    *,
    moves_arm: bool = True,
) -> Iterator[Route]:
    """Yield routes along floor paths: forward and backward, each with and without turns in place at the ends.

    Shorter routes with less turning, and without needless turns in place, come first.

    Args:
        over: Floor paths.
        start: Start configuration, with heading and arm.
        goal: Goal configuration.
        reverse: Whether the base may drive backwards.
        moves_arm: Whether the arm may move while the base does; otherwise it moves at the end.
    """
    found: list[tuple[float, Route]] = []
    for way in over:
        for forward in (True, False) if reverse else (True,):
            off = [_off(way[1] - way[0], start[2], forward), _off(way[-1] - way[-2], goal[2], forward)]
            done = _done(way)
            share = done[:, None] / max(done[-1], 1e-9)
            q = np.column_stack([way, np.zeros(len(way)), start[3:] + share * (goal[3:] - start[3:])])
            q[0], q[-1] = start, goal
            moves: tuple[ArmMove, ...] = ()
            if not moves_arm and (start[3:] != goal[3:]).any():
                q[:, 3:] = start[3:]
                moves = (np.stack([q[-1], goal]),)
            sharp = [angle > _SHARP for angle in off]
            for before in (False, True) if off[0] > _SMALL else (False,):
                for after in (False, True) if off[1] > _SMALL else (False,):
                    needless = sum(turns != wanted for turns, wanted in zip((before, after), sharp, strict=True))
                    rank = done[-1] + sum(off) + 0.5 * needless + _BACKWARD * (not forward)
                    found.append((rank, (RollingLeg(q, forward, before, after), *moves)))
    yield from (route for _, route in sorted(found, key=lambda one: one[0]))


def _off(direction: Float[Array, "2"], heading: float, forward: bool) -> float:
    """Return the angle between a heading and that of driving in a direction [rad]."""
    wanted = float(np.arctan2(direction[1], direction[0])) + (0.0 if forward else np.pi)
    return abs(nearest(wanted, heading) - heading)


def _done(xy: Float[Array, "point 2"]) -> Float[Array, " point"]:
    """Return the length of a polyline up to each of its points [m]."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(xy, axis=0), axis=1))])


def _parts(parts: list[DriveStage]) -> Iterator[RollingLeg | ArmMove]:
    """Yield legs and arm motions; turns in place belong to the adjacent legs."""
    before: Float[Array, " nq"] | None = None
    leg: RollingLeg | None = None
    for stage in parts:
        if stage.kind is Move.TURN:
            if leg is not None:
                leg = replace(leg, q=np.concatenate([leg.q[:-1], stage.q[-1:]]), turns_after=True)
            before = stage.q[0] if before is None else before
            continue
        if leg is not None:
            yield leg
            leg = None
        if stage.kind is Move.ARM:
            yield stage.q[[0, -1]]
            continue
        q = stage.q if before is None else np.concatenate([with_heading(stage.q[0], before[2])[None], stage.q[1:]])
        leg = RollingLeg(q, stage.kind is Move.FORWARD, turns_before=before is not None)
        before = None
    if leg is not None:
        yield leg
    elif before is not None and all(stage.kind is Move.TURN for stage in parts):  # the path only turns in place
        yield np.stack([before, parts[-1].q[-1]])


def _turning(route: Route) -> Iterator[Route]:
    """Yield variants of a route in which the first and last curve make the turns at its ends, where it has any."""
    legs = [k for k, part in enumerate(route) if isinstance(part, RollingLeg)]
    if not legs:
        yield route
        return
    first, last = route[legs[0]], route[legs[-1]]
    assert isinstance(first, RollingLeg)
    assert isinstance(last, RollingLeg)
    for before in (False, True) if first.turns_before else (False,):
        for after in (False, True) if last.turns_after else (False,):
            changed = list(route)
            changed[legs[0]] = replace(first, turns_before=before)
            of = changed[legs[-1]]
            assert isinstance(of, RollingLeg)
            changed[legs[-1]] = replace(of, turns_after=after)
            yield tuple(changed)


def _arm_moved_on_the_way(route: Route) -> Route:
    """Return a route whose arm moves along its longest leg, from its posture at the start to that at the end."""
    legs = [k for k, part in enumerate(route) if isinstance(part, RollingLeg)]
    if not legs:
        return route
    arms = [part.q if isinstance(part, RollingLeg) else part for part in route]
    first, last = arms[0][0, 3:], arms[-1][-1, 3:]
    longest = max(legs, key=lambda k: float(_done(arms[k][:, :2])[-1]))
    changed: list[RollingLeg | ArmMove] = []
    for k in legs:
        leg = route[k]
        assert isinstance(leg, RollingLeg)
        q = leg.q.copy()
        done = _done(q[:, :2])
        share = done[:, None] / max(done[-1], 1e-9) if k == longest else float(k > longest)
        q[:, 3:] = first + share * (last - first)
        changed.append(replace(leg, q=q))
    return tuple(changed)
