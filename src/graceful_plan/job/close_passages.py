"""Warnings about motions of a planned job that keep too little distance for a healthy arm, which deviates from them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from graceful_plan.job.job_result import Step
from graceful_plan.job.nearness import STANDS_FIRST, nearness
from graceful_plan.query.candidates.descents import TRACKING_CLEARANCE


def close_passages(steps: Sequence[Step]) -> str:
    """Return a sentence about things from which straight motions keep less than `TRACKING_CLEARANCE`; "" if none.

    Args:
        steps: The steps of a job.
    """
    found: dict[tuple[str, str], float] = {}
    for step in steps:
        for name, thing, distance in _close(step):
            found[name, thing] = min(distance, found.get((name, thing), distance))
    told = (f"{1e3 * distance:.2g} mm from {thing!r} with {name!r}" for (name, thing), distance in found.items())
    return f"a healthy arm may touch what it passes: {', '.join(told)}" if found else ""


def _close(step: Step) -> Iterator[tuple[str, str, float]]:
    """Yield the object of a step, a thing that is passed closely, and the distance [m]."""
    held = [piece.scene.carried for piece in step.pieces if piece.label in ("lift", "lower")]
    for piece in step.pieces:
        if piece.label in STANDS_FIRST and held and held[0] is not None:
            name = held[0].body
            near = nearness(
                piece.trajectory,
                piece.scene,
                name,
                margin=TRACKING_CLEARANCE,
                stands_first=STANDS_FIRST[piece.label],
            )
            for distance, thing in ((near.moving, near.passed), (near.standing, near.beside)):
                if thing:
                    yield name, thing, distance
