"""Demo: one task, planned with w = 0 and with the default safety weight."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import graceful_plan as gp
from graceful_plan.costs.objective import DEFAULT_WEIGHT
from graceful_plan.result import TracePoint

SCENE = "tabletop"
WEIGHTS = {"w = 0 (shortest)": 0.0, f"w = {DEFAULT_WEIGHT:g} (fails gracefully)": DEFAULT_WEIGHT}
SPEED = 0.3
"""Fraction of the velocity limits, a usual speed near people."""


@dataclass(frozen=True, kw_only=True)
class DemoResults:
    """Planning results by label, and the written files."""

    results: Mapping[str, gp.PlanResult]
    files: tuple[Path, ...]

    @property
    def solved(self) -> bool:
        """Whether there are two motions to compare."""
        return all(result.status is gp.PlanStatus.SOLVED for result in self.results.values())

    def comparison(self) -> str:
        """Compare motion, impact and duration of the two motions of this run."""
        shortest, graceful = (result.cost for result in self.results.values())
        before, after = (result.unwrap().duration for result in self.results.values())
        return (
            f"Compared with the shortest motion, the one planned with w = {graceful.w:g} has"
            f" {_change(shortest.motion, graceful.motion, 'joint motion', ' rad')} and"
            f" {_change(shortest.impact, graceful.impact, 'impact')}; it takes {after:.3g} s for {before:.3g} s."
        )


def _change(before: float, after: float, what: str, unit: str = "") -> str:
    """Format a change, such as 83 % more joint motion (7.7 rad for 4.2 rad)."""
    figures = f"({after:.3g}{unit} for {before:.3g}{unit})"
    if not before > 0.0:
        return f"another {what} {figures}"
    return f"{100.0 * abs(after / before - 1.0):.0f} % {'more' if after > before else 'less'} {what} {figures}"


def run(output: Path, *, callback: Callable[[TracePoint], None] | None = None, **budget: Any) -> DemoResults:
    """Plan the first task of `tabletop` with w = 0 and the default w; write trajectories and pictures into `output`.

    Args:
        output: Folder; created if missing.
        callback: Called with every improvement.
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
            name = f"trajectory_w{WEIGHTS[label]:g}"
            files += [output / f"{name}.json", output / f"{name}.csv"]
            result.trajectory.to_json(files[-2])
            result.trajectory.to_csv(files[-1])
    paths = {label: result.path for label, result in results.items() if result.path is not None}
    if len(paths) == len(results):
        files.append(output / "demo.png")
        figures.compare_paths(task.scene, paths, files[-1], speed=SPEED)
        if render.render_paths(task.scene, paths, output / "view.png"):
            files.append(output / "view.png")
    return DemoResults(results=results, files=tuple(files))
