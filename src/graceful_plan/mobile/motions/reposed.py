"""Drives whose arm moves with the base: postures and lateral offsets chosen along the way, then descended from.

What a drive passes stays: where it rests and turns, and which way round things it goes. In between, the base may be
beside its line, and the arm may take whatever postures are worth the way to them; where it had to move while the base
stood, it may now have moved before.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.mobile.motions.drive_curve import Drive, Roll, Straight, Stretch, connected
from graceful_plan.mobile.motions.posture_program import Reposing, Stations, chosen, nearest
from graceful_plan.mobile.motions.postures import BASE, SCALES, Places, posture_set
from graceful_plan.mobile.motions.smoothing import Closeness, Smoother
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.scene_problem import SceneProblem

Array = np.ndarray

OFFSETS = np.array([0.0, -0.2, 0.2, -0.4, 0.4, -0.6, 0.6])
"""Of the base beside its line [m]."""
_PLACES = 6
"""Along a drive, by which postures are chosen."""
_CLOSER = (0.3, 0.2, 0.15, 0.1, 0.07)
"""By how much the joints of further postures differ from those that were chosen before [rad]."""
_WORTH = 2e-3
"""Relative gain below which no further ones are tried."""
_STILL = 1e-9
"""Movements below which a joint stands still [rad or m]."""


def reposed(
    drive: Drive, smoother: Smoother, problem: SceneProblem, budget: Budget, rng: np.random.Generator
) -> Iterator[Drive]:
    """Yield drives with the same ends whose arm moves along the way, that are free by the fast checker.

    Args:
        drive: What to begin with.
        smoother: What is charged.
        problem: What has to be free.
        budget: For descents.
        rng: For postures.
    """
    line = _TakenApart.of(drive)
    if line is None or drive.stretches[0].samples(1)[1].shape[2] <= BASE:
        return
    room = smoother.room(np.stack([line.start, line.end]), moves_arm=True)
    asked = smoother, problem
    for offsets in (OFFSETS, OFFSETS[:1]):
        choice = _refined(line, offsets, room, asked, (budget, rng))
        if choice is None or budget.exhausted:
            return
        found = _freed(line.along(choice), smoother, problem, budget)
        if found is not None:
            yield found
            return


def _refined(
    line: _TakenApart,
    offsets: Float[Array, " offset"],
    room: Closeness,
    asked: tuple[Smoother, SceneProblem],
    means: tuple[Budget, np.random.Generator],
) -> Reposing | None:
    """Choose along a line, then again and again among postures that are closer and closer to those that were chosen."""
    stations, known = line.stations(asked[0]), line.known
    places, best = _places(stations, known[0], room), None
    for scales in ((*SCALES,), *((scale,) for scale in _CLOSER)):
        postures = posture_set(known, places, *asked, means[1], scales)
        ends = nearest(postures, line.known[0]), nearest(postures, line.known[-1])
        choice = chosen(stations, offsets, postures, ends, room, asked)
        if choice is None or (best is not None and choice.value > (1.0 - _WORTH) * best.value):
            break
        best, known = choice, (line.known[0], *np.unique(choice.arm, axis=0), line.known[-1])
        if means[0].exhausted:
            break
    return best


@dataclass(frozen=True, eq=False)
class _TakenApart:
    """A drive as what moves its base, with rests before, between and after.

    Args:
        moves: Curves and turns.
        rests: How many steps the arm may take alone before each of them, and after the last.
        known: Postures that the drive takes, first those that it begins with, at last those that it ends with.
        start: First configuration.
        end: Last configuration.
    """

    moves: tuple[Stretch, ...]
    rests: tuple[int, ...]
    known: tuple[Float[Array, " arm"], ...]
    start: Float[Array, " nq"]
    end: Float[Array, " nq"]

    @classmethod
    def of(cls, drive: Drive) -> _TakenApart | None:
        """Take a drive apart; None if its base stays where it is."""
        moves: list[Stretch] = []
        rests, known = [1], []
        for stretch in drive.stretches:
            q = stretch.samples(1)[1][0]
            known += [q[0, BASE:], q[-1, BASE:]]
            if isinstance(stretch, Roll):
                known += list(stretch.controls[:, 2:] if stretch.controls.shape[1] > 2 else ())
            if np.abs(q[-1, :BASE] - q[0, :BASE]).max() > _STILL or isinstance(stretch, Roll):
                moves.append(stretch)
                rests.append(1)
            else:
                rests[-1] += 1
        if not moves:
            return None
        first, last = (drive.stretches[k].samples(1)[1][0, k] for k in (0, -1))
        known = [first[BASE:], *np.unique(known, axis=0), last[BASE:]]
        return cls(tuple(moves), tuple(rests), tuple(known), first, last)

    def stations(self, smoother: Smoother) -> Stations:
        """Return where to choose: twice or more at each rest, once at each inner control point."""
        rows: list[Array] = []
        for move, rests in zip((*self.moves, None), self.rests, strict=True):
            q = self.end if move is None else move.samples(1)[1][0, 0]
            rows += [np.array([*q[:BASE], 1.0, 0.0, 0.0, 0.0])] * (1 + rests)
            if isinstance(move, Roll):
                rows += list(_inner(move, smoother))
        base, forward, speed, rate, aside = np.split(np.array(rows), [3, 4, 5, 6], axis=1)
        return Stations(base, forward[:, 0], speed[:, 0], rate[:, 0], aside[:, 0] > 0.0)

    def along(self, choice: Reposing) -> list[Stretch]:
        """Return the drive with the arm, and the base beside its line, as chosen."""
        found: list[Stretch] = []
        at = 0
        for move, rests in zip((*self.moves, None), self.rests, strict=True):
            q = self.end if move is None else move.samples(1)[1][0, 0]
            arms = choice.arm[at : at + 1 + rests]
            found += [Straight(_with(q, a), _with(q, b)) for a, b in pairwise(arms)]
            at += 1 + rests
            inner = len(move.controls) - 2 if isinstance(move, Roll) else 0
            if isinstance(move, Roll):
                found.append(_moved(move, choice.offset[at : at + inner], choice.arm[at - 1 : at + inner + 1]))
            elif move is not None:
                to = move.samples(1)[1][0, -1]
                found.append(Straight(_with(q, choice.arm[at - 1]), _with(to, choice.arm[at])))
            at += inner
        return found


def _places(stations: Stations, arm: Float[Array, " arm"], room: Closeness) -> Places:
    """Return some of the stations, each for as long as what is around it takes."""
    moving = np.flatnonzero(stations.speed > 0.0)
    at = moving if len(moving) else np.arange(len(stations))
    some = at[np.unique(np.linspace(0, len(at) - 1, _PLACES).astype(int))]
    base = stations.base
    steps = np.linalg.norm(np.diff(base[:, :2], axis=0), axis=1)
    total = float((steps / np.maximum(0.5 * (stations.speed[1:] + stations.speed[:-1]), 1e-2)).sum())
    q = np.column_stack([base[some], np.tile(arm, (len(some), 1))])
    qd = np.zeros_like(q)
    qd[:, :BASE] = stations.velocity()[some]
    return Places(q, qd, np.full(len(some), total / len(some)), float(steps.sum()), room.clear)


def _inner(roll: Roll, smoother: Smoother) -> Float[Array, "control 7"]:
    """Return x, y, heading, gear, speed, rate of turning and whether it may be moved, of inner control points."""
    C, sign = roll.controls[:, :2], 1.0 if roll.forward else -1.0
    way = sign * (C[2:] - C[:-2])
    heading = np.arctan2(way[:, 1], way[:, 0])
    heading = np.unwrap(np.concatenate([roll.begin[2:3], heading]))[1:]
    steps = np.linalg.norm(np.diff(C, axis=0), axis=1)
    turn = np.gradient(np.concatenate([roll.begin[2:3], heading, heading[-1:]]))[1:-1]
    bend = turn / np.maximum(0.5 * (steps[:-1] + steps[1:]), 1e-9)
    done = np.concatenate([[0.0], np.cumsum(steps)])
    speed = smoother.pace(np.abs(np.concatenate([bend[:1], bend, bend[-1:]])), done, np.asarray(done[-1]))[1:-1]
    aside = np.ones(len(way))
    aside[[0, -1]] = 0.0
    return np.column_stack([C[1:-1], heading, np.full(len(way), sign), speed, bend * speed, aside])


def _moved(roll: Roll, offset: Float[Array, " inner"], arm: Float[Array, "control arm"]) -> Roll:
    """Return a curve with inner control points moved to the left, and an arm at all of them."""
    C, sign = roll.controls[:, :2].copy(), 1.0 if roll.forward else -1.0
    way = sign * (C[2:] - C[:-2])
    left = np.column_stack([-way[:, 1], way[:, 0]]) / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)
    C[1:-1] += offset[:, None] * left
    return Roll(np.column_stack([C, arm]), _with(roll.begin, arm[0]), _with(roll.end, arm[-1]), roll.forward)


def _with(q: Float[Array, " nq"], arm: Float[Array, " arm"]) -> Float[Array, " nq"]:
    return np.concatenate([q[:BASE], arm])


def _freed(stretches: list[Stretch], smoother: Smoother, problem: SceneProblem, budget: Budget) -> Drive | None:
    """Descend from each curve; None if something is not free."""
    found: list[Stretch] = []
    rolls = sum(isinstance(one, Roll) for one in stretches)
    for stretch in stretches:
        options: list[Stretch] = [stretch]
        if isinstance(stretch, Roll):
            with budget.share(budget.remaining_seconds / rolls) as part:
                options = [smoother.descended(stretch, part), stretch]
            rolls -= 1
        free = [one for one in options if _is_free(one, problem)]
        if not free:
            return None
        found.append(free[0])
    return connected(found)


def _is_free(stretch: Stretch, problem: SceneProblem) -> bool:
    if isinstance(stretch, Straight):
        return bool(problem.edges_free(stretch.begin[None], stretch.end[None])[0])
    return bool(problem.states_free(stretch.samples(2)[1][0]).all())
