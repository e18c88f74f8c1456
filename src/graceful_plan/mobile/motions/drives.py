"""From stages of a path to drives: smooth curves where these are free, else its edges with rests between them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.mobile.motions.drive_curve import Roll, Straight, Stretch
from graceful_plan.mobile.motions.smoothing import Smoother
from graceful_plan.mobile.motions.stages import DriveStage, Move, stages
from graceful_plan.path import Path
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.resampling import evenly
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.timing.bspline import DEGREE

Array = np.ndarray

_SPACINGS = (0.8, 0.4, 0.2, 0.1)
"""Between control points [m], tried until a curve is free: the wider, the smoother."""
_FEWEST, _MOST = DEGREE + 3, 60
"""Control points."""
_PACE = 0.75
"""Mean share of the fastest speed, to tell when a later stage of a drive begins."""
_JOINED = 0.45 * np.pi
"""Turns at either end up to which a curve may turn instead [rad]."""


def smooth_all(
    parts: Sequence[DriveStage], smoother: Smoother, problem: SceneProblem, budget: Budget
) -> Iterator[Stretch]:
    """Yield what replaces stages, each for about when it begins."""
    begins = smoother.begins
    for stage in parts:
        yield from _smooth(stage, replace(smoother, begins=begins), problem, budget)
        way = np.abs(np.diff(stage.q, axis=0))
        metres, turn = float(np.hypot(way[:, 0], way[:, 1]).sum()), float(way[:, 2].sum())
        speed = _PACE * smoother.speed
        begins += metres / (speed * smoother.base.v_max)
        begins += 0.0 if _rolls(stage) else turn / (speed * smoother.base.omega_max)


def joined_ends(parts: Sequence[DriveStage]) -> Iterator[list[DriveStage]]:
    """Yield the stages with small turns at both ends left to the curves beside them, then as they are."""
    joined = list(parts)
    if len(joined) > 1 and joined[0].kind is Move.TURN and _rolls(joined[1]) and _turn(joined[0]) < _JOINED:
        joined[:2] = [replace(joined[1], q=np.concatenate([joined[0].q[:1], joined[1].q[1:]]))]
    if len(joined) > 1 and joined[-1].kind is Move.TURN and _rolls(joined[-2]) and _turn(joined[-1]) < _JOINED:
        joined[-2:] = [replace(joined[-2], q=np.concatenate([joined[-2].q[:-1], joined[-1].q[-1:]]))]
    if len(joined) < len(parts):
        yield joined
    yield list(parts)


def _rolls(stage: DriveStage) -> bool:
    return stage.kind in (Move.FORWARD, Move.BACKWARD)


def _turn(stage: DriveStage) -> float:
    return float(np.abs(np.diff(stage.q[:, 2])).sum())


def _smooth(stage: DriveStage, smoother: Smoother, problem: SceneProblem, budget: Budget) -> Iterator[Stretch]:
    """Yield what replaces a stage: one smooth curve if one is free, else its edges with rests between them."""
    if not _rolls(stage):
        yield from stopping(stage.q)
        return
    for spacing in _SPACINGS:
        roll = _fitted(stage, spacing)
        for curve in (smoother.descended(roll, budget), roll):
            if problem.states_free(curve.samples(2)[1][0]).all():
                yield curve
                return
    yield from stopping(stage.q)


def stopping(q: Float[Array, "vertex nq"]) -> Iterator[Stretch]:
    """Yield the edges of a path; what is drawn on the way is straight, moves that go on are one."""
    for stage in stages(Path(q)):
        if not _rolls(stage):
            yield from (Straight(a, b) for a, b in zip(stage.q[:-1], stage.q[1:], strict=True))
            continue
        forward, corner = stage.kind is Move.FORWARD, 0
        moves = np.abs(np.diff(stage.q[:, :2], axis=0)).max(axis=1) > 0.0
        for k in range(1, len(stage.q)):
            if k == len(stage.q) - 1 or moves[k] != moves[k - 1]:
                a, b = stage.q[corner], stage.q[k]
                if moves[k - 1]:
                    line = a[:2] + np.linspace(0.0, 1.0, DEGREE + 1)[:, None] * (b[:2] - a[:2])
                    yield Roll(line, a, b, forward)
                else:
                    yield Straight(a, b)
                corner = k


def _fitted(stage: DriveStage, spacing: float) -> Roll:
    """Return the spline whose control points lie evenly along a stage, with the headings that it has at both ends."""
    corners = Path(stage.q[:, :2]).without_duplicates()
    n = int(np.clip(np.ceil(corners.length / spacing) + 1, _FEWEST, _MOST))
    controls = evenly(corners.q, n)
    forward = stage.kind is Move.FORWARD
    step = corners.length / (n - 1) * (1.0 if forward else -1.0)
    for end, beside, away in ((0, 1, step), (-1, -2, -step)):
        heading = stage.q[end, 2]
        controls[beside] = controls[end] + away * np.array([np.cos(heading), np.sin(heading)])
    return Roll(controls, stage.q[0], stage.q[-1], forward)
