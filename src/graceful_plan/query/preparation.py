"""Compile a scene for calls of `plan`: covers and kernels of the robot, impact, constraints, judge."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from graceful_plan.constraints.constraint import Constraint
from graceful_plan.constraints.scene_constraints import SceneConstraints, default_constraints
from graceful_plan.core.compile import compile_scene
from graceful_plan.costs.objective import Objective, SceneObjective, search_paces
from graceful_plan.judge.verification import verify
from graceful_plan.path import Path
from graceful_plan.query.arguments import checked_objective, checked_speed
from graceful_plan.scene.scene import Scene, checked_scene

_COMPILED_SOON = 0.1
"""Compile times below this are not reported [s]; several times that of bundled scenes."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Preparation:
    """A compiled scene with its objective and constraints, and the seconds that each step took."""

    objective: SceneObjective
    constraints: SceneConstraints
    seconds: dict[str, float]

    @property
    def total(self) -> float:
        """Seconds of all steps."""
        return sum(self.seconds.values())

    def notes(self, limit: float) -> list[str]:
        """Return a note with the compile times, if they are a large part of a time limit [s]."""
        if self.total <= max(_COMPILED_SOON, min(limit / 10.0, 1.0)):
            return []
        steps = ", ".join(f"{name} {took:.2g} s" for name, took in self.seconds.items() if took >= 0.1 * self.total)
        return [f"compiled for {self.total:.1f} s ({steps})"]


def prepared(
    scene: Scene, objective: Objective, constraints: Iterable[Constraint] | None, speed: float = 1.0
) -> Preparation:
    """Compile a scene for calls with this objective and these constraints; everything is cached with the scene."""
    began = time.perf_counter()
    compile_scene(scene)
    robot = time.perf_counter()
    bound = objective.bind(scene, search_paces(speed))
    _ = bound.kernel
    impact = time.perf_counter()
    asked = SceneConstraints(scene, default_constraints(scene) if constraints is None else constraints)
    seconds = {"robot": robot - began, "impact": impact - robot, "constraints": time.perf_counter() - impact}
    return Preparation(objective=bound, constraints=asked, seconds=seconds)


def prepare(
    scene: Scene,
    *,
    objective: Objective | None = None,
    constraints: Iterable[Constraint] | None = None,
    speed: float = 1.0,
) -> dict[str, float]:
    """Compile a scene ahead of the first call of `plan`, so that this call takes as long as the later ones.

    The results are cached with the scene, and shared with scenes that `edit(move=)` makes from it. Another object in
    the gripper makes another scene: prepare that one, too. Without this function, the first call compiles.

    Args:
        scene: The scene, with the carried object in the gripper.
        objective: Objective of later calls; default: that of `plan`.
        constraints: Constraints of later calls; default: those of `plan`.
        speed: Speed of later calls.

    Returns:
        Seconds by step: "robot" (covers of links, kernels), "impact", "constraints", "judge".

    Raises:
        GracefulPlanError: For misuse, and for scenes that the kernels do not support.
    """
    ready = prepared(checked_scene(scene), checked_objective(objective, None), constraints, checked_speed(speed))
    began = time.perf_counter()
    middle = np.clip(np.zeros(len(scene.joints)), *scene.limits.position.T)
    verify(Path(np.stack([middle, middle])), scene)
    return {**ready.seconds, "judge": time.perf_counter() - began}
