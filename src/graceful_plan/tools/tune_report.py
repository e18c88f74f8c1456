"""Report of `graceful-plan tune`: the front of a task, a choice from it, files, and the validation by FailBench."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import graceful_plan as gp
from graceful_plan import documents
from graceful_plan.tools.validation import check_failures, validate_front
from graceful_plan.tuning.fronts import Choice, ChoiceStatus, FrontProgress
from graceful_plan.viewer.report_view import report_view


@dataclass(frozen=True, kw_only=True)
class TuneReport:
    """Front, choice, validation and written files.

    Args:
        front: The front.
        choice: The choice from it.
        validation: Document of `failbench validate-front`; None without a validation.
        files: Written files.
    """

    front: gp.ParetoFront
    choice: Choice
    validation: Mapping[str, Any] | None = None
    files: tuple[Path, ...] = ()

    def to_document(self) -> dict[str, Any]:
        """Return the report as a dictionary for JSON; the motions are in front.json."""
        points = [
            {
                "motion": point.motion,
                "impact": point.impact,
                "made_by": point.made_by,
                "weights": None if point.weights is None else list(point.weights),
            }
            for point in self.front.points
        ]
        chosen, knee = self.choice.point, self.front.knee
        return {
            "schema": "graceful_plan.tune",
            "version": 1,
            "status": self.front.status.name,
            "detail": self.front.detail,
            "hypervolume": self.front.hypervolume(),
            "points": points,
            "knee": None if knee is None else {"motion": knee.motion, "impact": knee.impact},
            "choice": {
                "status": self.choice.status.name,
                "motion": None if chosen is None else chosen.motion,
                "impact": None if chosen is None else chosen.impact,
                "w": self.choice.w,
                "detail": self.choice.detail,
            },
            "stats": dict(self.front.stats),
            "validation": self.validation,
            "files": [str(file) for file in self.files],
        }

    def __str__(self) -> str:
        front, choice = self.front, self.choice
        head = f"{front.status.name}: {front.status.value}" + (f" ({front.detail})" if front.detail else "")
        if not len(front):
            return head
        seconds = front.stats["total_time"]
        head += f"\n{len(front)} motions after {seconds:.1f} s, hypervolume {front.hypervolume():.3f}"
        rows = [self._row(i) for i in range(len(front))]
        columns = [
            "motion V",
            "impact S",
            "detour",
            "w from",
            "to",
            *(["predicted", "observed"] if self._seen else []),
            "",
        ]
        lines = [head, "", documents.table(columns, rows), "", f"choice: {choice.status.value} {choice.detail}"]
        lines += [f"w = {choice.w:.4g}"] if choice.w is not None else []
        lines += [f"cannot be executed: {why}" for why in dict.fromkeys(e["refused"] for e in self._seen) if why]
        return "\n".join([*lines, "", *(f"wrote {file}" for file in self.files)])

    @property
    def _seen(self) -> Sequence[Mapping[str, Any]]:
        return () if self.validation is None else self.validation["points"]

    def _row(self, i: int) -> list[object]:
        front, point = self.front, self.front.points[i]
        shortest = front.points[0].motion
        detour = f"{100.0 * (point.motion / shortest - 1.0):.1f} %" if shortest else "-"
        weights = ["-", "-"] if point.weights is None else [f"{w:.3g}" for w in point.weights]
        seen = [self._seen[i]] if self._seen else []
        marks = [name for name, p in (("knee", front.knee), ("chosen", self.choice.point)) if p is point]
        observed = [cell for entry in seen for cell in _cells(entry)]
        return [point.motion, point.impact, detour, *weights, *observed, ", ".join(marks)]


def run(
    scene_name: str,
    task: gp.Task,
    output: Path,
    *,
    target_impact: float | None = None,
    max_detour: float | None = None,
    failures: int = 0,
    grasp: str = "fingers",
    callback: Callable[[FrontProgress], bool | None] | None = None,
    told: Callable[[str], None] = lambda stage: None,
    **settings: Any,
) -> TuneReport:
    """Find the front of a task, choose from it, and write front.json, front.png, front.html and chosen.json.

    Args:
        scene_name: Bundled scene or scene file, for FailBench.
        task: The task.
        output: Folder; created if missing.
        target_impact: As in `ParetoFront.choose`.
        max_detour: As in `ParetoFront.choose`.
        failures: Number of simulated failures along each motion; 0 disables the validation.
        grasp: How the object is held in the validation: "fingers" or "weld".
        callback: Called with the progress of the search.
        told: Called with the text of each later stage.
        settings: Arguments of `gp.pareto`.

    Raises:
        ValidationError: If FailBench is not installed, or cannot judge the front.
    """
    check_failures(failures)
    gp.ParetoFront(status=gp.PlanStatus.TIMEOUT).choose(target_impact=target_impact, max_detour=max_detour)
    front = gp.pareto(task.start, task.goal, task.scene, callback=callback, **settings)
    choice = front.choose(target_impact=target_impact, max_detour=max_detour)
    output.mkdir(parents=True, exist_ok=True)
    files = [output / "front.json"]
    front.save(files[0])
    if not len(front):
        return TuneReport(front=front, choice=choice, files=tuple(files))
    from graceful_plan.viz.front import draw_front
    from graceful_plan.viz.front_page import write_front_page

    if choice.status is ChoiceStatus.MET and choice.point is not None:
        files.append(output / "chosen.json")
        choice.point.trajectory.to_json(files[-1])
    told(f"FailBench: {failures} failures along each of {len(front)} motions" if failures else "drawing")
    validation = validate_front(files[0], scene_name, task.name, failures, grasp=grasp) if failures else None
    files += [output / "front.png", output / "front.html"]
    draw_front(front, files[-2], choice)
    observed = () if validation is None else validation["points"]
    title = f"{front.scene}, {task.name}"
    space = _in_space(front, choice, task.scene)
    seen = [_seen(entry, failures) for entry in observed]
    write_front_page(front, task.scene, files[-1], choice, seen, title=title, space=space)
    return TuneReport(front=front, choice=choice, validation=validation, files=tuple(files))


def _in_space(front: gp.ParetoFront, choice: Choice, scene: gp.Scene) -> Mapping[str, str]:
    """Return a 3-D view of the chosen motion, or else of the knee."""
    point = choice.point or front.knee or front.points[0]
    document, why = report_view(point.trajectory, scene, front.points[0].trajectory, "shortest")
    name = "the chosen motion" if choice.point is not None else "the motion at the knee"
    return {"of": f"{name}, motion {point.motion:.4g} rad, impact {point.impact:.3g}", "page": document, "why": why}


def _cells(entry: Mapping[str, Any]) -> list[str]:
    seen = entry["observed"]
    if seen is None:
        return ["-", "cannot be executed"]
    return [f"{entry['predicted']:.3g}", f"{seen['mean']:.3g} [{seen['low']:.3g}, {seen['high']:.3g}]"]


def _seen(entry: Mapping[str, Any], failures: int) -> Mapping[str, Any]:
    """Return predicted and observed impact of a point and its difference to the shortest, or why it is not executed."""
    seen = entry["observed"]
    if seen is None:
        return {"refused": entry["refused"]}
    difference = entry.get("against_shortest")
    return {
        "predicted": entry["predicted"],
        "observed": seen["mean"],
        "low": seen["low"],
        "high": seen["high"],
        "difference": None if difference is None else [difference[name] for name in ("mean", "low", "high")],
        "failures": failures,
    }
