"""When to go and how fast along a curve among those who move: dynamic programming over places, times and speeds.

The curve is divided into pieces. On each the base drives at a share of the fastest speed there; a state is a place, the
time at which it gets there and the share before. A piece costs its time and w times the impact of its middle at that
time; driving into somebody costs a great deal. Of all states in one interval of time the cheapest goes on, with its own
time. Shares follow each other as the base can speed up and brake.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from graceful_plan.array_types import Bool, Float, Int
from graceful_plan.judge.passing_by import is_moving
from graceful_plan.mobile.among.walkers import KEPT, Walkers
from graceful_plan.mobile.motions.drive_curve import Drive
from graceful_plan.mobile.motions.slowing import capped
from graceful_plan.timing.topp import Restraint
from graceful_plan.timing.trajectory import Trajectory

Array = np.ndarray

SHARES = np.array([1.0, 0.85, 0.7, 0.55, 0.4, 0.25, 0.12])
"""Of the fastest speed."""
_LOOKED_AT = np.array([0.12, 0.55, 1.0])
"""Shares at which impact is looked at; between them it is interpolated."""
_PIECE, _FEWEST, _MOST = 0.25, 6, 36
"""Length of a piece [m], and how many there are."""
_TICK = 0.1
"""Width of an interval of time [s]."""
_SEEN = 0.4
"""Between the times at which impact is looked at [s]."""
_LATER = 1.5
"""Times the fastest duration, and so many seconds: when a base has arrived that dawdles [s]."""
_MORE = 6.0
_INTO = 1e4
"""What a second costs in which the base drives into somebody."""


@dataclass(frozen=True, eq=False)
class Pieces:
    """The pieces of a curve as they are driven as fast as can be.

    | field   | meaning                                    | unit       | shape    |
    |---------|--------------------------------------------|------------|----------|
    | q       | configurations in their middles            | rad or m   | piece nq |
    | qd      | velocities there                           | rad/s, m/s | piece nq |
    | seconds | how long they take                         | s          | piece    |
    | begin   | sample of the motion at which each begins  |            | piece    |
    """

    q: Float[Array, "piece nq"]
    qd: Float[Array, "piece nq"]
    seconds: Float[Array, " piece"]
    begin: Int[Array, " piece"]


def paced(
    drive: Drive,
    fast: Trajectory,
    walkers: Walkers,
    time_price: float,
    max_wait: float = 0.0,
    cancelled: Callable[[], bool] = lambda: False,
) -> tuple[Restraint | None, float]:
    """Return limits on the path speed of the cheapest law of time, None if there are none, and the wait before [s].

    Args:
        drive: The curve.
        fast: As fast along it as the limits allow.
        walkers: Who moves.
        time_price: What a second costs besides.
        max_wait: Longest wait before it goes [s].
        cancelled: Once it says so, impact is looked at less closely.
    """
    grid = next((g for g in map(drive.grid, (1, 2, 4)) if len(g.q) == len(fast)), None)
    if grid is None:
        return None, 0.0
    pieces = pieces_of(fast)
    charge = Charges.of(pieces, walkers, time_price, max_wait, cancelled)
    base = walkers.objective.scene.base
    assert base is not None
    share, wait = cheapest_law(pieces, charge, max_wait, base.a_max)
    whole = np.repeat(share, np.diff(np.append(pieces.begin, len(fast))))
    return capped(grid, fast, whole), wait


def pieces_of(fast: Trajectory) -> Pieces:
    """Divide a motion evenly by the length of its joints' motion."""
    done = np.append(0.0, np.cumsum(fast.path.segment_lengths))
    n = int(np.clip(np.ceil(done[-1] / _PIECE), _FEWEST, _MOST))
    begin = np.unique(np.searchsorted(done, done[-1] * np.arange(n) / n))
    begin = begin[begin < len(fast) - 1]
    t = fast.t[np.append(begin, len(fast) - 1)]
    state = fast.at(0.5 * (t[1:] + t[:-1]))
    return Pieces(state.q, state.qd, np.diff(t), begin)


@dataclass(frozen=True, eq=False)
class Charges:
    """What a second costs on each piece, at each share, at times.

    | field   | meaning                                                   | shape            |
    |---------|-----------------------------------------------------------|------------------|
    | still   | of those who stand, and of time itself                    | piece share      |
    | moving  | of those who move, at times `_SEEN` apart                 | piece share time |
    | into    | whether the base would drive into somebody                | piece time       |
    """

    still: Float[Array, "piece share"]
    moving: Float[Array, "piece share time"]
    into: Bool[Array, "piece time"]

    @classmethod
    def of(
        cls,
        pieces: Pieces,
        walkers: Walkers,
        time_price: float,
        max_wait: float,
        cancelled: Callable[[], bool] = lambda: False,
    ) -> Charges:
        """Look at all pieces; once it is cancelled, at no further shares: impact is then as at one that was."""
        n, w, still = len(pieces.seconds), walkers.objective.w, walkers.still
        latest = max_wait + _LATER * float(pieces.seconds.sum()) + _MORE
        t = _SEEN * np.arange(int(np.ceil(latest / _SEEN)) + 1)
        q, at = np.repeat(pieces.q, len(t), axis=0), np.tile(t, n)
        qd, soonest = np.repeat(pieces.qd, len(t), axis=0), np.append(0.0, np.cumsum(pieces.seconds)[:-1])
        reached = at > np.repeat(soonest, len(t)) - 2.0 * _SEEN
        looked = np.zeros((len(_LOOKED_AT), n * len(t)))
        for k, a in reversed(list(enumerate(_LOOKED_AT))):
            if k < len(_LOOKED_AT) - 1 and cancelled():
                looked[: k + 1] = looked[k + 1]
                break
            looked[k, reached] = walkers.impact(q[reached], a * qd[reached], at[reached])
        looked = looked.reshape(-1, n, len(t))
        rate = np.zeros((n, len(SHARES)))
        if w > 0.0:
            rate = np.stack([still.quick_states(pieces.q, a * pieces.qd) for a in SHARES], axis=1)
        place = np.interp(SHARES, _LOOKED_AT, np.arange(len(_LOOKED_AT)))
        low = np.minimum(np.floor(place).astype(int), len(_LOOKED_AT) - 2)
        part = (place - low)[:, None, None]
        moving = ((1.0 - part) * looked[low] + part * looked[low + 1]).swapaxes(0, 1)
        moves = is_moving(SHARES.min() * pieces.qd)
        into = (walkers.gap(q, at).reshape(n, len(t)) < KEPT) & moves[:, None]
        return cls(time_price + w * rate, w * moving, into)

    def second(self, piece: int, share: int, t: Float[Array, " n"]) -> Float[Array, " n"]:
        """Return what a second costs at times [s]."""
        at = t / _SEEN
        low = np.clip(at.astype(int), 0, self.into.shape[1] - 2)
        part = np.clip(at - low, 0.0, 1.0)
        row, into = self.moving[piece, share], self.into[piece]
        return (
            self.still[piece, share] + (1 - part) * row[low] + part * row[low + 1] + _INTO * (into[low] | into[low + 1])
        )


def cheapest_law(
    pieces: Pieces, charges: Charges, max_wait: float, acceleration: float
) -> tuple[Float[Array, " piece"], float]:
    """Return the share of the fastest speed on each piece, and the wait before [s], of least cost.

    Args:
        pieces: Of the curve.
        charges: What seconds cost.
        max_wait: Longest wait [s]; waiting costs what a second does besides impact.
        acceleration: Of the base, along its heading [m/s^2].
    """
    ticks, speed = charges.into.shape[1] * round(_SEEN / _TICK), np.linalg.norm(pieces.qd[:, :2], axis=1)
    waits = np.arange(0.0, max_wait + 1e-9, _TICK)
    cost = np.full((ticks, len(SHARES) + 1), np.inf)  # the last column: nothing was driven yet
    time = np.zeros_like(cost)
    cost[np.rint(waits / _TICK).astype(int), -1] = float(charges.still.min()) * waits
    time[np.rint(waits / _TICK).astype(int), -1] = waits
    came: list[tuple[Int[Array, "tick share"], Int[Array, "tick share"]]] = []
    for k, seconds in enumerate(pieces.seconds):
        follows = _follows(speed, pieces.seconds, k, acceleration)
        after, later = np.full_like(cost, np.inf), np.zeros_like(time)
        tick_before, share_before = np.zeros(cost.shape, dtype=int), np.zeros(cost.shape, dtype=int)
        for a, share in enumerate(SHARES):
            some = np.isfinite(cost) & follows[:, a]
            if not some.any():
                continue
            tick, before = np.nonzero(some)
            takes = seconds / share
            value = cost[some] + takes * charges.second(k, a, time[some] + 0.5 * takes)
            arrives = time[some] + takes
            at = np.minimum((arrives / _TICK).astype(int), ticks - 1)
            order = np.argsort(-value, kind="stable")  # the cheapest is written last
            after[at[order], a], later[at[order], a] = value[order], arrives[order]
            tick_before[at[order], a], share_before[at[order], a] = tick[order], before[order]
        cost, time = after, later
        came.append((tick_before, share_before))
    return _traced(cost, came)


def _follows(
    speed: Float[Array, " piece"], seconds: Float[Array, " piece"], k: int, acceleration: float
) -> Bool[Array, "before share"]:
    """Tell which shares may follow which: as the base speeds up and brakes from the middle of a piece to the next."""
    follows = np.ones((len(SHARES) + 1, len(SHARES)), dtype=bool)
    if k == 0:
        return follows
    v0, v1 = SHARES[:, None] * speed[k - 1], SHARES * speed[k]
    way = 0.5 * (speed[k - 1] * seconds[k - 1] + speed[k] * seconds[k])
    # What the fastest motion does is possible; and so is each share of it throughout.
    most = max(2.0 * acceleration * way, abs(speed[k] ** 2 - speed[k - 1] ** 2)) + 1e-9
    follows[:-1] = (np.abs(v1**2 - v0**2) <= most) | (SHARES[:, None] == SHARES)
    follows[-1] = False
    return follows


def _traced(
    cost: Float[Array, "tick share"], came: list[tuple[Int[Array, "tick share"], Int[Array, "tick share"]]]
) -> tuple[Float[Array, " piece"], float]:
    tick, a = np.unravel_index(int(np.argmin(cost)), cost.shape)
    shares: list[int] = []
    for tick_before, share_before in reversed(came):
        shares.append(int(a))
        tick, a = tick_before[tick, a], share_before[tick, a]
    return SHARES[shares[::-1]], float(_TICK * tick)
