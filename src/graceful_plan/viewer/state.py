"""State of the viewer, independent of its display: request, answer, time, replay and user actions."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import final

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SettingError
from graceful_plan.scene.scene import Scene
from graceful_plan.viewer.failing import Failure, FailureBench, Replay, recorded_replay
from graceful_plan.viewer.fall import Coasting, Fall, coasting_at, fall_at
from graceful_plan.viewer.question import PlanAnswer, Question, answered
from graceful_plan.viewer.recorded import RecordedRollouts
from graceful_plan.viewer.risk_layer import RiskLayer, risk_layer
from graceful_plan.viewer.shapes import parts
from graceful_plan.viewer.shown import ShownMotion
from graceful_plan.viewer.worker import LatestRequestWorker

MOST_KEPT = 4
"""Maximum number of kept motions."""


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class ShownMoment:
    """Displayed data at one time.

    | field    | meaning                                                                    | unit | shape  |
    |----------|----------------------------------------------------------------------------|------|--------|
    | t        | time after the start                                                       | s    |        |
    | position | position of each part, in the chosen motion or the replay                  | m    | part 3 |
    | turned   | quaternion wxyz of each part                                               |      | part 4 |
    | beside   | position and quaternion of each part, for each of the other motions        |      |        |
    | impact   | impact of a failure now, by entity, the worst first                        |      |        |
    | fall     | footprint of a drop now; None during a failure                             |      |        |
    | going_on | coasting of the base if it fails now; None during a failure                |      |        |
    | failed   | whether the failure of the replay has begun                                |      |        |
    """

    t: float
    position: Float[Array, "part 3"]
    turned: Float[Array, "part 4"]
    beside: tuple[tuple[Array, Array], ...]
    impact: Mapping[str, float]
    fall: Fall | None
    going_on: Coasting | None
    failed: bool


@final
class ViewerState:
    """Request, answer, replay and time. A worker plans for the latest request only.

    Threads share the state: hold its `lock` to change it, or to read several values consistently.

    Args:
        question: Initial request.
        changed: Called after a new answer, in the worker's thread, with the lock held.
        failed: Called with the exception of a failed request, in the same thread.
        answer: Known answer; nothing is planned until the next request.
    """

    def __init__(
        self,
        question: Question,
        changed: Callable[[], None] = lambda: None,
        failed: Callable[[Exception], None] = lambda error: None,
        answer: PlanAnswer | None = None,
    ) -> None:
        self.lock = threading.RLock()
        self.question, self.answer, self.replay = question, answer, None
        self.kept: tuple[ShownMotion, ...] = ()
        self._changed, self._bench = changed, FailureBench()
        self.worker: LatestRequestWorker[Question, PlanAnswer] = LatestRequestWorker(self._work, self._done, failed)

    # --- requests -----------------------------------------------------------------------------------------------------

    def ask(self, question: Question) -> None:
        """Submit a request; its answer arrives later, unless a newer request replaces it.

        In a changed scene, known motions remain until then with their impact in that scene; a replay is removed.
        """
        if self.answer is not None and question.scene is not self.question.scene:
            self._take(self.answer.among(question))
        self.question = question
        self.worker.ask(question)

    def fail(self, failure: Failure) -> Replay:
        """Simulate a failure of the chosen motion, shown until `forget`.

        Raises:
            SettingError: If there is no motion.
            GracefulPlanError: If FailBench cannot simulate it.
        """
        motion = self.motion
        if motion is None:
            raise SettingError("motion", None, "one that was found: there is nothing to fail along yet")
        self.replay = self._bench.replay(failure, motion)
        return self.replay

    def happen_again(self, rollouts: RecordedRollouts, number: int) -> Replay:
        """Simulate and show a rollout of a dataset on its motion; plan the ordinary motion if the motion changed.

        Raises:
            SettingError: If the rollout does not exist, or its fault is defined in a custom file.
            UnknownNameError: If its scene or task does not exist.
        """
        replay, (question, answer) = recorded_replay(rollouts, number), rollouts.shown(number)
        if question is not self.question:
            self.question, self.answer = question, answer
            self.kept = tuple(one for one in self.kept if _same_parts(one.scene, question.scene))
            self.ask(question)
        self.replay = replay
        return replay

    def forget(self) -> None:
        """Show the healthy motion again."""
        self.replay = None

    def keep(self) -> ShownMotion:
        """Keep the chosen motion on display while others are planned.

        Raises:
            SettingError: If there is no motion, it is already kept, or the number of kept motions is `MOST_KEPT`.
        """
        motion = self.motion
        if motion is None or any(one.trajectory is motion.trajectory for one in self.kept):
            raise SettingError("motion", None, "one that was found and is not kept already")
        if len(self.kept) == MOST_KEPT:
            raise SettingError("motion", len(self.kept) + 1, f"at most {MOST_KEPT} that are kept; let go of them first")
        kept = replace(motion, label=f"{'ABCD'[len(self.kept)]}: w = {self._weight:g}")
        self.kept = (*self.kept, kept)
        return kept

    def let_go(self) -> None:
        """Remove all kept motions."""
        self.kept = ()

    @property
    def _weight(self) -> float:
        return 0.0 if self.answer is None else self.answer.question.w

    def _work(self, question: Question, cancelled: Callable[[], bool]) -> PlanAnswer:
        return answered(question, self.answer, cancelled)

    def _done(self, answer: PlanAnswer) -> None:
        with self.lock:
            if answer.question is self.question:  # no newer request has arrived
                self._take(answer)
                self._changed()

    def _take(self, answer: PlanAnswer) -> None:
        before, self.answer = self.motion, answer
        if self.motion is not before:
            self.replay = None

    # --- display ------------------------------------------------------------------------------------------------------

    @property
    def motion(self) -> ShownMotion | None:
        """The chosen motion, or else the ordinary one."""
        motions = () if self.answer is None else self.answer.motions
        return motions[0] if motions else None

    @property
    def others(self) -> tuple[ShownMotion, ...]:
        """The ordinary motion, if different, and the kept ones."""
        motion, ordinary = self.motion, None if self.answer is None else self.answer.ordinary
        return tuple(one for one in (ordinary, *self.kept) if one is not None and one is not motion)

    @property
    def duration(self) -> float:
        """Time of the last displayed frame [s], of the longest motion or of the replay."""
        if self.replay is not None:
            return self.replay.duration
        shown = (*(self.answer.motions if self.answer else ()), *self.kept)
        return max((motion.duration for motion in shown), default=0.0)

    def at(self, t: float) -> ShownMoment | None:
        """Return the displayed data at a time [s]; None before the first answer."""
        motion, replay = self.motion, self.replay
        if motion is None:
            return None
        shown = motion if replay is None else replay
        frame, failed = shown.frame(t), replay is not None and t >= replay.onset
        frames = [(other, other.frame(t)) for other in self.others]
        within = min(max(t, 0.0), motion.duration)
        return ShownMoment(
            t=t,
            position=shown.poses.position[frame],
            turned=shown.poses.quaternion[frame],
            beside=tuple((other.poses.position[k], other.poses.quaternion[k]) for other, k in frames),
            impact={} if failed else motion.impact_at(within),
            fall=None if failed else fall_at(motion.trajectory, motion.scene, within),
            going_on=None if failed else coasting_at(motion.trajectory, motion.scene, within),
            failed=failed,
        )

    def layer(self, t: float) -> RiskLayer | None:
        """Return the risk map for the speed and height of a time [s], if there is one."""
        motion = self.motion
        if motion is None:
            return None
        return risk_layer(motion.trajectory, motion.scene, min(max(t, 0.0), motion.duration), self.question.impact)

    def close(self) -> None:
        """End the worker."""
        self.worker.close()


def _same_parts(first: Scene, second: Scene) -> bool:
    """Return whether motions in two scenes can be shown side by side."""
    return [part.name for part in parts(first)] == [part.name for part in parts(second)]
