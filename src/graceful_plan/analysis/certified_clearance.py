r"""A lower bound of the clearance along a whole motion, between samples included.

This is conservative advancement on the fast checker. Within a stretch whose midpoint has clearance c, the clearance is
at least c - m, where m bounds the displacement of any point of the robot from its position at the midpoint. If joint k
moves by at most h_k,

.. math:: m = \sum_k L_k h_k, \qquad L_k = l_k + \sum_{j\ \mathrm{beyond}\ k} L_j h_j

where l_k is the distance of the point from the axis of hinge k at the midpoint; L_k = 1 for a slide. Only stretches
whose bound is not yet good enough are halved, so the effort goes to the tightest places.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Bool, Float, Int
from graceful_plan.core.arrays import RobotArrays
from graceful_plan.core.kernels import Kernels
from graceful_plan.judge.motion_samples import at_places, joint_travel
from graceful_plan.path import Path
from graceful_plan.timing.trajectory import Trajectory

ROUNDING = 2e-5
"""Largest error of a clearance from single precision [m]: arm lengths to seven digits, summed along the arm."""
TOLERANCE = 0.002
"""Refinement stops once the bound is this close to the least sampled clearance [m], or to half of it if less."""
_FINEST, _FINEST_BLOCKED = 2e-5, 5e-4
"""Least motion of a stretch that is still halved [m], for midpoints that are free and for those in collision."""
_FIRST = 48
"""Number of initial stretches."""


@final
@dataclass(frozen=True, eq=False)
class ClearanceBound:
    """Bounds of the clearance along a motion.

    | field       | meaning                                                                       | unit     |
    |-------------|-------------------------------------------------------------------------------|----------|
    | bound       | lower bound of the clearance along the whole motion, by the fast checker      | m        |
    | sampled     | least sampled clearance                                                       | m        |
    | uncertified | stretches not proven to have a clearance of at least 0                        | s or rad |
    | evaluations | number of evaluated configurations                                            |          |
    """

    bound: float
    sampled: float
    uncertified: tuple[tuple[float, float], ...]
    evaluations: int


def certified_clearance(
    motion: Path | Trajectory, kernels: Kernels, *, tolerance: float = TOLERANCE, most: int = 20_000
) -> ClearanceBound:
    """Bound the clearance along a motion from below.

    Args:
        motion: A path, straight between its vertices, or a trajectory.
        kernels: The kernels of the scene.
        tolerance: Stop when the bound is this close to the least sampled clearance [m].
        most: Number of evaluated configurations after which refinement stops.
    """
    way = _Way(motion, kernels)
    known = way.beginning()
    spent = len(known.lo)
    while spent < most:
        split = known.wanting(tolerance)
        if not split.any():
            break
        halves = way.halves(known.part(split))
        known = known.part(~split) + halves
        spent += len(halves.lo)
    bound = known.bound
    return ClearanceBound(
        bound=float(bound.min()),
        sampled=float(known.clearance.min()),
        uncertified=way.merged(known.lo[bound < 0.0], known.hi[bound < 0.0]),
        evaluations=spent,
    )


@final
@dataclass(frozen=True, eq=False)
class _Stretches:
    """Stretches of a motion, with the clearance and the greatest displacement of any point from their midpoints [m]."""

    lo: Float[Array, " n"]
    hi: Float[Array, " n"]
    first: Int[Array, " n"]
    """Index of the initial stretch that contains each one."""
    clearance: Float[Array, " n"]
    moved: Float[Array, " n"]

    @property
    def bound(self) -> Float[Array, " n"]:
        return self.clearance - self.moved - ROUNDING

    def wanting(self, tolerance: float) -> Bool[Array, " n"]:
        """Select the stretches to halve: those that limit the bound and those that may be free but are unproven."""
        least = float(self.clearance.min())
        wanted = least - min(tolerance, 0.5 * least if least > 0.0 else tolerance) - ROUNDING
        may_be_free = (self.bound < 0.0) & (self.clearance > -self.moved)
        finest = np.where(self.clearance > 0.0, _FINEST, _FINEST_BLOCKED)
        return ((self.bound < wanted) | may_be_free) & (self.moved > finest)

    def part(self, which: Bool[Array, " n"]) -> _Stretches:
        return _Stretches(self.lo[which], self.hi[which], self.first[which], self.clearance[which], self.moved[which])

    def __add__(self, other: _Stretches) -> _Stretches:
        names = "lo", "hi", "first", "clearance", "moved"
        return _Stretches(*(np.concatenate([getattr(self, name), getattr(other, name)]) for name in names))


@final
class _Way:
    """A motion parametrised by its progress: joint travel weighted with rough levers [m]."""

    def __init__(self, motion: Path | Trajectory, kernels: Kernels) -> None:
        self.motion, self.kernels = motion, kernels
        self._bounds = _Levers(kernels.robot)
        travel = joint_travel(motion)
        self._place = np.arange(len(motion), dtype=np.float64)
        self._travel = np.concatenate([np.zeros((1, travel.shape[1])), np.cumsum(travel, axis=0)])
        some = kernels.link_poses(motion.q[:: max(1, len(motion) // 8)])
        self._come = self._travel @ self._bounds.of(some, np.zeros(travel.shape[1])).max(axis=(0, 2), initial=0.05)
        ends = np.linspace(0.0, self._come[-1], _FIRST + 1 if self._come[-1] > 0.0 else 2)
        self._lo, self._hi = ends[:-1], ends[1:]
        q, turns = self._middle(self._lo, self._hi)
        self._levers = self._bounds.of(kernels.link_poses(q), turns)

    def beginning(self) -> _Stretches:
        """Return the initial stretches, which cover the whole motion."""
        return self._stretches(self._lo, self._hi, np.arange(len(self._lo)))

    def halves(self, whole: _Stretches) -> _Stretches:
        """Evaluate both halves of some stretches."""
        middle = 0.5 * (whole.lo + whole.hi)
        lo, hi = np.concatenate([whole.lo, middle]), np.concatenate([middle, whole.hi])
        return self._stretches(lo, hi, np.tile(whole.first, 2))

    def merged(self, lo: Float[Array, " n"], hi: Float[Array, " n"]) -> tuple[tuple[float, float], ...]:
        """Join adjacent stretches and return their bounds in seconds (trajectory) or radians (path)."""
        found: list[list[float]] = []
        for i in np.argsort(lo):
            if found and lo[i] <= found[-1][1] + 1e-12:
                found[-1][1] = max(found[-1][1], float(hi[i]))
            else:
                found.append([float(lo[i]), float(hi[i])])
        at = at_places(self.motion, self._places(np.array(found).ravel())).at.reshape(-1, 2) if found else []
        return tuple((float(first), float(last)) for first, last in at)

    def _stretches(self, lo: Float[Array, " n"], hi: Float[Array, " n"], first: Int[Array, " n"]) -> _Stretches:
        q, turns = self._middle(lo, hi)
        # The levers of an initial stretch hold in all of its parts.
        moved = self._bounds.relative(np.matmul(turns[:, None, :], self._levers[first])[:, 0])
        return _Stretches(lo, hi, first, self.kernels.clearance(q), moved)

    def _middle(
        self, lo: Float[Array, " n"], hi: Float[Array, " n"]
    ) -> tuple[Float[Array, "n nq"], Float[Array, "n nq"]]:
        """Return the configurations at the midpoints, and the greatest displacement of each joint from there."""
        middle = self._places(0.5 * (lo + hi))
        before, here, after = (self._travel_at(place) for place in (self._places(lo), middle, self._places(hi)))
        return at_places(self.motion, middle).q, np.maximum(here - before, after - here)

    def _places(self, come: Float[Array, " n"]) -> Float[Array, " n"]:
        return np.interp(come, self._come, self._place)

    def _travel_at(self, place: Float[Array, " n"]) -> Float[Array, "n nq"]:
        index = np.minimum(place.astype(int), max(len(self._travel) - 2, 0))
        share = (place - index)[:, None]
        return (1.0 - share) * self._travel[index] + share * self._travel[np.minimum(index + 1, len(self._travel) - 1)]


@final
class _Levers:
    """Bounds on the motion of each link, with everything attached to it, per unit of joint motion."""

    def __init__(self, robot: RobotArrays) -> None:
        parents, joints = robot.parent.tolist(), robot.joint.tolist()
        above: list[list[int]] = []
        for link, parent in enumerate(parents):  # parents precede their children
            above.append([link, *(above[parent] if parent >= 0 else [])])
        self._link = np.array([link for link in range(len(joints)) if joints[link] >= 0], dtype=int)
        self._joint = robot.joint[self._link]
        self._slide = robot.slide[self._link].astype(bool)
        self._group = np.flatnonzero(robot.bound[:, 3] >= 0.0)
        self._ball = robot.bound[self._group]
        carries = [[link in above[group] for group in self._group] for link in self._link]
        self._carries = np.array(carries, dtype=bool).reshape(len(self._link), len(self._group))
        self._is_chain = bool((robot.parent[self._link[1:]] == self._link[:-1]).all())

    def relative(self, moved: Float[Array, "n group"]) -> Float[Array, " n"]:
        """Bound how much the motion of links by given distances changes the distance of any pair, or to an obstacle.

        In a chain, the bound of the farther link of a pair bounds their relative motion, too. Links of two arms may
        move towards each other.
        """
        if self._is_chain or moved.shape[1] < 2:
            return moved.max(axis=1, initial=0.0)
        return np.partition(moved, -2, axis=1)[:, -2:].sum(axis=1)

    def of(self, X_WL: Float[Array, "n link 4 4"], turns: Float[Array, "*n nq"]) -> Float[Array, "n nq group"]:
        """Bound each link's motion per unit of each joint, if joint k moves by at most `turns[k]` from here."""
        turns = np.broadcast_to(turns, (len(X_WL), turns.shape[-1]))
        X_WG = X_WL[:, self._group]
        p_WG = np.einsum("ngab,gb->nga", X_WG[..., :3, :3], self._ball[:, :3]) + X_WG[..., :3, 3]
        levers = np.zeros((len(X_WL), turns.shape[1], len(self._group)))
        moved = np.zeros((len(X_WL), len(self._group)))
        for i in range(len(self._link) - 1, -1, -1):  # from the tip to the base
            lever = np.ones_like(moved) if self._slide[i] else self._distance(p_WG, X_WL[:, self._link[i]]) + moved
            levers[:, self._joint[i]] = lever = np.where(self._carries[i], lever, 0.0)
            moved = moved + lever * turns[:, self._joint[i], None]
        return levers

    def _distance(self, p_WG: Float[Array, "n group 3"], X_WJ: Float[Array, "n 4 4"]) -> Float[Array, "n group"]:
        """Bound the distance of any point of each link's bounding sphere from a joint axis, the z axis of its link."""
        r = p_WG - X_WJ[:, None, :3, 3]
        along = np.einsum("nga,na->ng", r, X_WJ[:, :3, 2])
        return np.sqrt(np.maximum(np.einsum("nga,nga->ng", r, r) - along**2, 0.0)) + self._ball[:, 3]
