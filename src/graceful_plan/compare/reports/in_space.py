"""3-D view on the page of a comparison: the best and the worst result on the problem with the largest difference."""

from __future__ import annotations

import html
import json
from collections.abc import Iterator, Mapping, Sequence

from graceful_plan.compare.problems.suite import ProblemSpec
from graceful_plan.compare.reports.summary import Summary
from graceful_plan.compare.runs.records import Run
from graceful_plan.compare.runs.runner import SceneQuery, loaded_problem
from graceful_plan.exceptions import GracefulPlanError
from graceful_plan.viewer.report_view import report_view

_SCRIPT = """<script>
(() => {
  const page = %s, dark = matchMedia("(prefers-color-scheme: dark)").matches;
  document.getElementById("space").srcdoc = dark ? page.replace("{darkMode:false}", "{darkMode:true}") : page;
})();
</script>"""


def in_space(summary: Summary, problems: Sequence[ProblemSpec] = ()) -> Mapping[str, str] | None:
    """Return the 3-D view for a page: its motions (`of`), the document (`page`), and `why` there is none.

    Args:
        summary: Summary of the comparison.
        problems: Problems of the suite. Without them, only problems of bundled scenes are found, because a journal does
            not contain the location of files.

    Returns:
        The view; None if no planner has a timed motion, as on analytic problems.
    """
    found = _most_different(summary)
    if found is None:
        return None
    best, worst = found
    note = {note.name: note for note in (*_bundled(summary), *problems)}.get(best.problem)
    of = f"{best.problem}, on which totals differ most: {_told(best)}"
    if worst is not best:
        of += f"; as a ghost {_told(worst)}"
    if note is None:
        return {"of": of, "page": "", "why": "its scene is in a file; run the comparison again without --report-only"}
    try:
        problem = loaded_problem(note)
        assert isinstance(problem, SceneQuery), "timed motions have a scene"
        motion, other = (run.trajectory(problem.scene.joints) for run in found)
    except (GracefulPlanError, KeyError) as error:  # a task that no longer exists
        return {"of": of, "page": "", "why": f"its scene cannot be shown: {error}"}
    assert motion is not None
    page, why = report_view(motion, problem.scene, None if worst is best else other, worst.planner)
    return {"of": of, "page": page, "why": why}


def section(space: Mapping[str, str] | None) -> Iterator[str]:
    """Yield the section of the page with the 3-D view."""
    if space is None:
        return
    yield "<h2>In 3-D</h2>"
    yield f'<p class="note">{html.escape(space["of"])}. Drag to turn. Blue: little harm by a failure, red: most.</p>'
    if not space["page"]:
        yield f"<p>{html.escape(space['why'])}</p>"
        return
    yield '<iframe id="space" title="Two motions in 3-D" sandbox="allow-scripts"></iframe>'
    # The document must not end the script element that contains it.
    yield _SCRIPT % json.dumps(space["page"]).replace("<", "\\u003c")


def _most_different(summary: Summary) -> tuple[Run, Run] | None:
    """Return the best runs of the best and worst planner, on the problem with the largest difference."""
    found: list[tuple[float, Run, Run]] = []
    for problem in summary.comparison.problems:
        solved = [run for run in summary.comparison.of(problem=problem) if run.solved and run.times]
        bests = [
            min((run for run in solved if run.planner == planner), key=lambda run: run.total)
            for planner in dict.fromkeys(run.planner for run in solved)
        ]
        if bests:
            best, worst = (choose(bests, key=lambda run: run.total) for choose in (min, max))
            found.append((worst.total / max(best.total, 1e-9), best, worst))
    return max(found, key=lambda one: one[0])[1:] if found else None


def _bundled(summary: Summary) -> Iterator[ProblemSpec]:
    """Yield the problems of the journal whose scenes are bundled."""
    for document in summary.comparison.settings.get("problems", ()):
        if not document.get("digest") and document["kind"] in ("task", "motion"):
            start, goal = (tuple(end) if isinstance(end, list) else end for end in document["ends"])
            yield ProblemSpec(
                name=document["name"],
                kind=document["kind"],
                source=document["source"],
                item=document["item"],
                group=document["group"],
                start=start,
                goal=goal,
            )


def _told(run: Run) -> str:
    return f"{run.planner}, seed {run.seed}, total {run.total:.4g} in {run.duration:.2f} s"
