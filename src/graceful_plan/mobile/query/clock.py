"""What is left of the time of a call, and whether its last steps still fit: they take what they took lately.

A motion is timed and charged, then judged. How long that takes depends on the scene, on what is asked and on the
machine, so it is learnt: a step is begun only if it would hardly be late when it takes as long as the longest of its
last runs in this scene.
"""

from __future__ import annotations

import statistics
import time
from collections import deque
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Literal, final

import numpy as np

from graceful_plan.scene.per_scene import per_layout
from graceful_plan.scene.scene import Scene

Step = Literal["ending", "timing", "judging"]
"""Descents end, once they should have; one motion is timed and charged; one is judged."""

_FIRST: dict[Step, float] = {"ending": 0.005, "timing": 0.01, "judging": 0.04}
"""What is kept before there are any runs [s]: what they take where contents are carried."""
_LATELY = 16
"""Runs of a step that count."""
_FORGOTTEN, _SLOWLY_FORGOTTEN = 0.95, 0.995
"""What is left of these times whenever a step is not begun for their sake, until the next run: a single long run is
forgotten soon. So are a few milliseconds of what a step mostly takes; the rest of it slowly, since whoever tries it
then is late by as much."""
_SOON_FORGOTTEN = 0.008
"""Of what a step mostly takes [s]: 99 of 100 calls are to be late by 10 ms at most."""
_LATE, _LATE_SHARE = 0.003, 0.01
"""By how much a call may be late if a step takes as long as it ever did lately [s], or by which share of its limit."""
_SPARE, _SPARE_SHARE = 0.1, 0.08
"""At least so much is kept for the last steps [s], but no more than this share of a time limit: machines get busy."""
_TIMED = 3
"""Motions that are to be timed within the time that is kept for the last steps."""
_INSURANCE = 0.2
"""Share of the time left that a motion may take which is there should those that follow come too late."""
_TIMES, _INSURED_TIMES = 2.0, 1.25
"""Of what steps take at most, for there to be plenty of time."""
_MOST_KEPT = 0.7
"""Share of a time limit that is kept for them at most."""


@final
class Paces:
    """How long steps took lately."""

    def __init__(self) -> None:
        self._lately: dict[Step, deque[float]] = {step: deque(maxlen=_LATELY) for step in _FIRST}
        self._doubts: dict[Step, int] = dict.fromkeys(_FIRST, 0)

    def longest(self, step: Step) -> float:
        """Return the longest of the last runs [s]; 0 before there are any."""
        return max(_FORGOTTEN ** self._doubts[step] * max(self._lately[step], default=0.0), self.typical(step))

    def typical(self, step: Step) -> float:
        """Return the median of the last runs [s]; 0 before there are any."""
        median, doubts = statistics.median(self._lately[step] or (0.0,)), self._doubts[step]
        slowly = min(_SLOWLY_FORGOTTEN**doubts * median, median - _SOON_FORGOTTEN)
        return max(_FORGOTTEN**doubts * median, slowly)

    def knows(self, step: Step) -> bool:
        """Whether there were any runs."""
        return bool(self._lately[step])

    def kept_for(self, step: Step) -> float:
        """Return what to keep for a run [s]."""
        return self.longest(step) if self.knows(step) else _FIRST[step]

    def took(self, step: Step, seconds: float) -> None:
        """Take note of a run."""
        self._lately[step].append(seconds)
        self._doubts[step] = 0

    def doubt(self, step: Step) -> None:
        """Forget a little of how long the last runs took."""
        self._doubts[step] += 1


@per_layout
def paces_of(_scene: Scene) -> Paces:
    """Return what is known of the steps in a scene; calls add to it."""
    return Paces()


@final
@dataclass(frozen=True, eq=False)
class Clock:
    """The time that a call has.

    | field    | meaning                                  | unit |
    |----------|------------------------------------------|------|
    | deadline | reading of `time.perf_counter`           | s    |
    | paces    | how long steps take                      |      |
    | limit    | what the call had when its search began  | s    |
    """

    deadline: float = np.inf
    paces: Paces = field(default_factory=Paces)
    limit: float = 0.0

    @property
    def left(self) -> float:
        """Seconds until the deadline, negative after it."""
        return self.deadline - time.perf_counter()

    @property
    def last_steps(self) -> float:
        """Reading of the clock from which on there is time for the last steps only [s]; infinite without a limit."""
        return self.deadline - self.reserve(self.limit) if np.isfinite(self.deadline) else self.deadline

    def reserve(self, limit: float, *, insured: bool = False) -> float:
        """Return what to keep of a time limit for the last steps [s], less if there is a motion already."""
        kept_for = self.paces.kept_for
        learnt = kept_for("ending") + (1 if insured else _TIMED) * kept_for("timing") + kept_for("judging")
        return min(max(learnt, min(_SPARE, _SPARE_SHARE * limit)), _MOST_KEPT * limit)

    def ended(self, late: float) -> None:
        """Take note of how late descents were [s]."""
        if self.deadline < np.inf:
            self.paces.took("ending", max(0.0, late))

    def has_room(self, *steps: Step) -> bool:
        """Whether these steps would end in time, or hardly late; of one that is not known somebody has to try it."""
        left = self.left
        if not all(self.paces.knows(step) for step in steps):
            return True
        late = max(_LATE, _LATE_SHARE * self.limit)
        if left > 0.0 and left >= sum(self.paces.longest(step) for step in steps) - late:
            return True
        for step in steps:
            self.paces.doubt(step)
        return False

    def may_do(self, *steps: Step) -> bool:
        """Whether these steps would end in time if they take what they mostly take.

        For steps without which a call ends with nothing, where `has_room` is for those that it can do without: on a
        machine that was busy for a moment, the longest of the last runs says little of the next.
        """
        return self.has_room(*steps) or self.left >= sum(self.paces.typical(step) for step in steps)

    @property
    def can_insure(self) -> bool:
        """Whether there is a deadline, and so much time before it that a first motion hardly counts."""
        needed = self.paces.kept_for("timing") + self.paces.kept_for("judging")
        return self.deadline < np.inf and _INSURANCE * self.left >= needed

    def has_plenty(self, *steps: Step, insured: bool = False) -> bool:
        """Whether there is room for more than what has to be done: these steps, as long as they ever took, twice.

        Once and a bit if there is a motion already that passes the judge.
        """
        return self.left >= (_INSURED_TIMES if insured else _TIMES) * sum(self.paces.longest(step) for step in steps)

    @contextmanager
    def measured(self, step: Step) -> Generator[None]:
        """Take note of how long a `with` block takes."""
        started = time.perf_counter()
        try:
            yield
        finally:
            self.paces.took(step, time.perf_counter() - started)
