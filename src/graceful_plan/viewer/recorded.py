"""Rollouts of a FailBench dataset, with the motion and failure of each.

FailBench depends on this library, so it is imported only when a dataset is opened.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from pathlib import Path as FilePath
from typing import Any, NamedTuple, final

import numpy as np

from graceful_plan.array_types import Array, Float, Int
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.objective import DEFAULT_WEIGHT, Objective, evaluate
from graceful_plan.exceptions import SettingError, UnknownNameError
from graceful_plan.viewer.question import CHOSEN, PlanAnswer, Question
from graceful_plan.viewer.shown import shown_motion

_READ = ("motion", "fault", "degree", "onset", "status", "observed_impact", "dropped", "spilled", "contacts")
"""Columns that are read, without the poses, which would take most of the memory."""


class Recorded(NamedTuple):
    """Record of a rollout in a dataset."""

    number: int
    motion: str
    fault: str
    degree: str
    onset: float
    """Failure onset after the start of the motion [s]."""
    diverged: bool
    impact: float | None
    """Observed harm; None if the simulation diverged."""
    dropped: bool
    spilled: float
    contacts: int


@final
class RecordedRollouts:
    """The rollouts of a dataset, with a request and answer for each of its motions.

    Args:
        folder: Folder of the dataset.
        time_limit: Time limit for planning the ordinary motion shown with one of the dataset [s].

    Raises:
        FormatError: If the dataset is unfinished or damaged; the message names the file.
        GracefulPlanError: If pyarrow is not installed; it is in the extra "data".
    """

    def __init__(self, folder: FilePath, time_limit: float) -> None:
        found = importlib.import_module("failbench").read_dataset(folder)
        self.sweep: Any = found.sweep
        self._time_limit = time_limit
        self._columns: dict[str, list[Any]] = {name: found.rollouts[name].to_pylist() for name in _READ}
        self._impact: Float[Array, " row"] = np.array(
            [np.nan if x is None else x for x in self._columns["observed_impact"]], dtype=float
        )
        self._shown: dict[int, tuple[Question, PlanAnswer]] = {}

    def __len__(self) -> int:
        return len(self._impact)

    @property
    def faults(self) -> tuple[str, ...]:
        """Names of the faults in the dataset."""
        return tuple(sorted(set(self._columns["fault"])))

    @property
    def motions(self) -> tuple[str, ...]:
        """Names of the motions in the dataset."""
        return tuple(motion.name for motion in self.sweep.motions)

    def __getitem__(self, number: int) -> Recorded:
        if not 0 <= number < len(self):
            raise SettingError("rollout", number, f"between 0 and {len(self) - 1}")
        row = {name: values[number] for name, values in self._columns.items()}
        return Recorded(
            number=number,
            motion=row["motion"],
            fault=row["fault"],
            degree=row["degree"],
            onset=row["onset"],
            diverged=row["status"] != "completed",
            impact=row["observed_impact"],
            dropped=bool(row["dropped"]),
            spilled=row["spilled"] or 0.0,
            contacts=row["contacts"],
        )

    def worst_first(self, motions: Sequence[str] = (), faults: Sequence[str] = ()) -> Int[Array, " n"]:
        """Return the numbers of rollouts, the most harmful first and diverged ones last.

        Args:
            motions: Motions to include; all by default.
            faults: Faults to include; all by default.

        Raises:
            UnknownNameError: If a motion or fault does not exist.
        """
        wanted = np.ones(len(self), dtype=bool)
        for kind, names, valid in (("motion", motions, self.motions), ("fault", faults, self.faults)):
            for name in names:
                if name not in valid:
                    raise UnknownNameError(f"{kind} of the dataset", name, valid)
            if names:
                wanted &= np.isin(self._columns[kind], list(names))
        order = np.argsort(-np.nan_to_num(self._impact, nan=-1.0), kind="stable")
        return order[wanted[order]]

    def shown(self, number: int) -> tuple[Question, PlanAnswer]:
        """Return the motion of a rollout as an answer, the same object for rollouts of the same motion.

        Raises:
            UnknownNameError: If its scene or task does not exist.
        """
        index = self.sweep.place(number)[0]
        if index not in self._shown:
            self._shown[index] = self._answer(self.sweep.motions[index])
        return self._shown[index]

    def _answer(self, motion: Any) -> tuple[Question, PlanAnswer]:
        scene = importlib.import_module("failbench.sweeps.definition").scene_of(motion.scene, motion.task)
        w = DEFAULT_WEIGHT if motion.plan is None else float(motion.plan.w)
        question = Question(
            scene=scene,
            start=np.array(motion.trajectory.q[0]),
            goal=np.array(motion.trajectory.q[-1]),
            w=w,
            impact=ImpactCost(),
            time_limit=self._time_limit,
        )
        cost = evaluate(motion.trajectory, scene, Objective(w=w))
        chosen = shown_motion(CHOSEN, motion.trajectory, scene, question.impact, cost)
        return question, PlanAnswer(question=question, chosen=chosen, ordinary=None, said=("", "not planned yet"))
