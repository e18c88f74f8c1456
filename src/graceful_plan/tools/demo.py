"""The demo: one task, planned without and with regard for failures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import graceful_plan as gp

SCENE = "tabletop"
WEIGHTS = {"w = 0 (shortest)": 0.0, "w = 1 (fails gracefully)": 1.0}
SPEED = 0.3
"""Fraction of the velocity limits: as slowly as a robot moves near people."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What was planned, by label, and the files that were written."""

    results: Mapping[str, gp.PlanResult]
    files: tuple[Path, ...]


def run(output: Path, *, callback: Callable[[gp.TracePoint], None] | None = None, **budget: Any) -> Outcome:
    """Plan the first task of `tabletop` with w = 0 and w = 1; write trajectories and pictures into `output`.

    Args:
        output: Folder; made if it does not exist.
        callback: Told of every improvement.
        budget: `time_limit`, `iterations` and `seed` of `plan`.
    """
    from graceful_plan.viz import figures, render

    task = next(iter(gp.load_scene(SCENE).tasks.values()))
    results = {
        label: gp.plan(task.start, task.goal, task.scene, w=w, callback=callback, speed=SPEED, **budget)
        for label, w in WEIGHTS.items()
    }
    output.mkdir(parents=True, exist_ok=True)
    files = []
    for label, result in results.items():
        if result.trajectory is not None:
            stem = output / f"trajectory_w{WEIGHTS[label]:g}"
            files += [stem.with_suffix(".json"), stem.with_suffix(".csv")]
            result.trajectory.to_json(files[-2])
            result.trajectory.to_csv(files[-1])
    paths = {label: result.path for label, result in results.items() if result.path is not None}
    if len(paths) == len(results):
        files.append(output / "demo.png")
        figures.compare_paths(task.scene, paths, files[-1], speed=SPEED)
        if render.render_paths(task.scene, paths, output / "view.png"):
            files.append(output / "view.png")
    return Outcome(results=results, files=tuple(files))
