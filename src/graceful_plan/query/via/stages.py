"""Stages of a motion: configurations for each intermediate pose, and the selection of one for each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.exceptions import SettingError
from graceful_plan.path import finite_array
from graceful_plan.query.endpoints.configurations import Configuration
from graceful_plan.query.endpoints.goals import Goal, resolve_goal, resolve_start
from graceful_plan.query.endpoints.travel import Travel
from graceful_plan.result import PlanResult, PlanStatus
from graceful_plan.scene.pose_goal import PoseGoal
from graceful_plan.scene.scene import Scene
from graceful_plan.scene.tasks import named_configuration

Via = Configuration | PoseGoal
"""A configuration [nq], the name of a keyframe, or a pose of the tool."""


@dataclass(frozen=True, eq=False)
class Stages:
    """Stages of a motion from the start to the goal.

    Args:
        objective: Objective whose motion cost counts.
        usable: Configurations of each stage that are free and inside the limits; one at the start.
        wanted: Intermediate stops that the user gave: configurations, or poses of the tool.
        goal: The goal that the user gave.
        notes: Descriptions of adjustments.
    """

    objective: SceneObjective
    usable: tuple[Float[Array, "_ nq"], ...]
    wanted: tuple[Float[Array, " nq"] | PoseGoal, ...]
    goal: Goal
    notes: tuple[str, ...]

    def chosen(self) -> tuple[Float[Array, " nq"], ...]:
        """Return one configuration of each stage, with the least total cost of straight moves between them."""
        length, steps = np.zeros(1), []
        for before, after in pairwise(self.usable):
            total = length[:, None] + np.stack([Travel(one, self.objective).cost(after) for one in before])
            steps.append(total.argmin(axis=0))
            length = total.min(axis=0)
        index = [int(length.argmin())]
        for step in reversed(steps):
            index.append(int(step[index[-1]]))
        return tuple(q[i] for q, i in zip(self.usable, reversed(index), strict=True))


def checked_via(via: object, scene: Scene) -> tuple[Float[Array, " nq"] | PoseGoal, ...]:
    """Return the intermediate stops, with keyframes replaced by their configurations.

    Raises:
        GracefulPlanError: For wrong shapes, NaN and unknown names.
    """
    if isinstance(via, str | PoseGoal) or not isinstance(via, Sequence | np.ndarray):
        raise SettingError("via", via, "a list of configurations, keyframes and PoseGoals, such as [pose]")
    return tuple(_checked(k, one, scene) for k, one in enumerate(via))


def _checked(k: int, one: Via, scene: Scene) -> Float[Array, " nq"] | PoseGoal:
    if isinstance(one, PoseGoal):
        return one
    if not isinstance(one, str):
        return finite_array(f"via[{k}]", one, ndim=1, last=len(scene.joints))
    return named_configuration(one, scene)


def find_stages(
    start: Configuration,
    via: Sequence[Float[Array, " nq"] | PoseGoal],
    goal: Goal,
    objective: SceneObjective,
    seed: int,
) -> Stages | PlanResult:
    """Return the stages of a motion, or a result that names the stage that has no usable configuration."""
    scene = objective.scene
    starts = resolve_start(start, scene)
    if not len(starts.q):
        return PlanResult(status=PlanStatus.INVALID_START, detail=starts.detail)
    usable, notes, wanted = [starts.q], list(starts.notes), list(via)
    for k, one in enumerate([*via, goal]):
        word = "" if k == len(via) else f"via {k}: "
        found = resolve_goal(one, scene, starts.q[0], objective=objective, seed=seed)
        told = word + found.detail.replace("goal: ", "") if word else found.detail
        if not len(found.q):
            return PlanResult(status=PlanStatus.INVALID_GOAL, detail=told)
        notes += [told] if found.notes else []
        usable.append(found.q)
        if word and not isinstance(one, PoseGoal):
            wanted[k] = found.q[0]  # clamped to the limits
    return Stages(objective, tuple(usable), tuple(wanted), goal, tuple(notes))
