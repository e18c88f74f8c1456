"""HTML page of a planned job: a timeline with the harm of each step, and the rejected alternatives."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from html import escape
from itertools import accumulate
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any

import numpy as np

from graceful_plan.exceptions import SettingError
from graceful_plan.job.job_result import JobResult, Step
from graceful_plan.job.rejected import Reason, Rejected
from graceful_plan.viz.html_page import counted, document, figure_of, note, number, svg, table_of, td
from graceful_plan.viz.style import ENTITY_COLOURS, OTHERS_COLOUR

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LEAST = 0.005
"""Share of the impact above which an entity has a separate colour."""
_ALTERNATIVES = 25
"""Number of rejected alternatives that are listed at once; the others are folded."""
_JOBS = 1e6
"""Number of executed jobs to which observed harm is scaled."""
_LABEL = 0.09
"""Share of the duration from which the time of a motion is wide enough for its label."""
_REASONS: Mapping[Reason, str] = {
    Reason.COSTLIER: "costs more",
    Reason.BOUNDED: "lower bound",
    Reason.SAME_STATE: "same state",
    Reason.REFUSED: "not possible",
    Reason.DEAD_END: "dead end",
    Reason.UNFINISHED: "not completed",
}
_NEGLIGIBLE = 1e-3
"""Share of the whole below which a value is not worth its digits."""
_TIMELINE_NOTE = (
    "Above: the motions of each step. Below: the predicted impact of a failure during each motion, by entity; the "
    "areas add up to the impact in the cost."
)
_OBSERVED_NOTE = (
    "At the bottom: harm of failures in simulation, with its interval, and the prediction for the same failures, as "
    "the expected severity in a million executed jobs."
)
_STEPS_NOTE = "cost = motion + w · impact. Impact: expected severity of a failure at each moment, summed over the time."
_ENTITIES_NOTE = "Predicted impact of each step, by entity."
_REJECTED_NOTE = (
    "Each line stands for all grasps and placements of these actions. Sequences are compared by the costs of their "
    "first motions; only the motions of the cheapest ones, at most three, are improved. A difference is that of "
    "motions planned with the same effort. A line that ends with … is not a complete sequence: its last action decided."
)


def write_job_page(
    result: JobResult, file: str | FilePath, *, observed: Mapping[str, Any] | None = None, title: str = "Job"
) -> None:
    """Write the page.

    Args:
        result: Result of `plan_job`; without a solution, the page tells why there is none.
        file: HTML file to write.
        observed: Document of a validation of the result: `failbench.validate_job(result).to_document()`.
        title: Title of the page.

    Raises:
        SettingError: If the validation is of a job with another number of steps.
    """
    if observed is not None and len(observed["by_step"]) != len(result.steps):
        raise SettingError("observed", len(observed["by_step"]), f"a validation of {len(result.steps)} steps")
    FilePath(file).write_text(document(title, _parts(result, observed, title)), encoding="utf-8")


def _parts(result: JobResult, observed: Mapping[str, Any] | None, title: str) -> Iterator[str]:
    yield f"<h1>{escape(title)}</h1>"
    yield f'<p class="lead">{escape(_lead(result))}</p>'
    if result.steps:
        yield _wide(figure_of(_timeline(result, observed), f"{_TIMELINE_NOTE} {_OBSERVED_NOTE if observed else ''}"))
        yield "<h2>Steps</h2>"
        yield _steps(result, observed)
        yield note(_STEPS_NOTE)
        yield "<h2>Harm by entity</h2>"
        yield _entities(result, observed)
        yield note(_ENTITIES_NOTE)
    yield "<h2>Rejected alternatives</h2>"
    yield from _rejected(result)


def _lead(result: JobResult) -> str:
    if not result.steps:
        return f"{result.status.value} {result.detail}".strip()
    cost = result.cost
    head = (
        f"{counted(len(result.steps), 'step')}, {result.duration:.1f} s; cost {number(cost.total, 4)} = motion "
        f"{number(cost.motion, 4)} + {cost.w:g} · impact {number(cost.impact, 4)}"
    )
    if result.exhaustive:
        return f"{head}. All sequences over the sampled grasps and placements were compared."
    return (
        f"{head}. Every sequence over the sampled grasps and placements costs at least {number(result.lower_bound, 4)}."
    )


def _starts(result: JobResult) -> list[float]:
    return [0.0, *accumulate(step.duration for step in result.steps)][:-1]


def _name(step: Step) -> str:
    return step.kind if step.kind == step.name else f"{step.kind} {step.name}"


def _wide(content: str) -> str:
    return f'<div class="wide">{content}</div>'


def _timeline(result: JobResult, observed: Mapping[str, Any] | None) -> str:
    """Draw the steps over time, above the predicted harm, and the observed harm if it is known."""
    rows = len(result.steps)

    def draw(figure: Figure) -> None:
        heights = [0.35 + 0.26 * rows, 1.9, *([1.4] if observed else [])]
        steps, impact, *harm = figure.subplots(
            len(heights), 1, sharex=True, squeeze=False, gridspec_kw={"height_ratios": heights}
        ).ravel()
        _draw_steps(steps, result)
        _draw_impact(impact, result)
        for axes in harm:
            _draw_observed(axes, result, observed or {})
        for axes in (impact, *harm):
            for start in _starts(result)[1:]:
                axes.axvline(start, color="#d0d0d0", linewidth=0.6, zorder=0)
        (impact, *harm)[-1].set_xlabel("time [s]")
        steps.set_xlim(0.0, result.duration)

    return svg(draw, "timeline", 2.8 + 0.26 * rows + (1.5 if observed else 0.0))


def _draw_steps(axes: Axes, result: JobResult) -> None:
    for row, (step, start) in enumerate(zip(result.steps, _starts(result), strict=True)):
        begin = start
        for piece in step.pieces:
            seconds = piece.trajectory.duration
            fill = "#9db9d6" if piece.scene.carried is not None else "#dfe4ea"
            axes.barh(row, seconds, left=begin, height=0.72, color=fill, edgecolor="white", linewidth=0.8)
            if seconds > _LABEL * result.duration:
                axes.text(begin + 0.5 * seconds, row, piece.label, ha="center", va="center", fontsize=6.5)
            begin += seconds
    axes.set_yticks(range(len(result.steps)), [_name(step) for step in result.steps])
    axes.set_ylim(len(result.steps) - 0.5, -0.5)
    axes.tick_params(axis="y", length=0)
    axes.set_title("Steps; darker while an object is held")


def _shown(result: JobResult) -> list[str]:
    """Return the entities with the largest impact, at most one per colour."""
    parts, least = result.cost.impact_by_entity, _LEAST * result.cost.impact
    return sorted((name for name in parts if parts[name] > least), key=lambda name: -parts[name])[: len(ENTITY_COLOURS)]


def _draw_impact(axes: Axes, result: JobResult) -> None:
    names, pieces = _shown(result), [piece for step in result.steps for piece in step.pieces]
    seconds = np.array([piece.trajectory.duration for piece in pieces])
    begin = np.concatenate([[0.0], np.cumsum(seconds)[:-1]])
    lasts = seconds > 0.0
    base = np.zeros(len(pieces))
    layers = [(name, ENTITY_COLOURS[k]) for k, name in enumerate(names)]
    layers += [("others", OTHERS_COLOUR)] if result.cost.impact > 0.0 else []
    for name, colour in layers:
        if name == "others":
            parts = [
                piece.cost.impact - sum(piece.cost.impact_by_entity.get(n, 0.0) for n in names) for piece in pieces
            ]
        else:
            parts = [piece.cost.impact_by_entity.get(name, 0.0) for piece in pieces]
        share = sum(parts) / result.cost.impact
        if name == "others" and share < _LEAST:
            continue
        rate = np.divide(parts, seconds, out=np.zeros(len(pieces)), where=lasts)
        axes.bar(
            begin[lasts], rate[lasts], seconds[lasts], base[lasts], align="edge", color=colour, linewidth=0.0,
            label=f"{name} {share:.0%}",
        )  # fmt: skip
        base = base + rate
    axes.set(title=f"Predicted impact, {number(result.cost.impact)} in all", ylabel="impact per second")
    axes.set_ylim(0.0, 1.05 * max(float(base.max(initial=0.0)), 1e-300) if base.any() else 1.0)
    if layers:
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), reverse=True)


def _draw_observed(axes: Axes, result: JobResult, observed: Mapping[str, Any]) -> None:
    middle = [start + 0.5 * step.duration for start, step in zip(_starts(result), result.steps, strict=True)]
    mean, low, high = (_JOBS * np.array([step[key] for step in observed["by_step"]]) for key in ("mean", "low", "high"))
    bars: Any = np.maximum([mean - low, high - mean], 0.0)
    axes.errorbar(middle, mean, yerr=bars, fmt="o", color="#111111", markersize=4, capsize=3, label="observed")
    predicted = _JOBS * np.array(observed["predicted_by_step"])
    axes.plot(middle, predicted, "D", color="#d55e00", markersize=4, fillstyle="none", label="predicted")
    axes.set(title="Observed harm of each step", ylabel="per 10⁶ jobs")
    axes.set_ylim(bottom=0.0)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))


def _steps(result: JobResult, observed: Mapping[str, Any] | None) -> str:
    header = ["step", "from [s]", "duration [s]", "cost", "motion [rad]", "impact", "share of impact", "most to"]
    header += ["observed per 10⁶ jobs", "interval", "predicted per 10⁶ jobs"] if observed else []
    rows = []
    for k, (step, start) in enumerate(zip(result.steps, _starts(result), strict=True)):
        cost = step.cost
        worst = sorted(cost.impact_by_entity.items(), key=lambda item: -item[1])[:2]
        least = _NEGLIGIBLE * result.cost.impact
        most = ", ".join(f"{name} {number(value)}" for name, value in worst if value > least)
        seen = _seen(observed, observed["by_step"][k], observed["predicted_by_step"][k]) if observed else []
        rows.append(
            [
                td(escape(_name(step))),
                td(f"{start:.1f}"),
                td(f"{step.duration:.1f}"),
                td(number(cost.total)),
                td(number(cost.motion)),
                td(_part(cost.impact, result.cost.impact)),
                td(_share(cost.impact, result.cost.impact)),
                td(escape(most) or "–", "text long"),
                *seen,
            ]
        )
    whole = result.cost
    seen = _seen(observed, observed["observed"], sum(observed["predicted_by_step"])) if observed else []
    values = (whole.total, whole.motion, whole.impact)
    rows.append(
        [td("all"), td("0.0"), td(f"{result.duration:.1f}"), *(td(number(value)) for value in values)]
        + [td(_share(whole.impact, whole.impact)), td("", "text"), *seen]
    )
    return table_of(header, rows)


def _seen(observed: Mapping[str, Any], part: Mapping[str, Any], predicted: float) -> list[str]:
    """Return the cells of a part of the observed harm, its interval, and the predicted part."""
    whole = _JOBS * max(observed["observed"]["mean"], observed["observed"]["high"])
    mean, low, high = (_part(_JOBS * part[key], whole) for key in ("mean", "low", "high"))
    return [td(mean), td(f"{low} to {high}"), td(_part(_JOBS * predicted, whole))]


def _part(value: float, whole: float) -> str:
    """Format a part of a whole."""
    return "≈ 0" if 0.0 < value < _NEGLIGIBLE * whole else number(value)


def _share(part: float, whole: float) -> str:
    return f"{100.0 * part / whole:.0f} %" if whole > 0.0 else "–"


def _entities(result: JobResult, observed: Mapping[str, Any] | None) -> str:
    """Return a table of the impact of each step by entity; the largest value of each entity is bold."""
    harmed = {name: value for name, value in result.cost.impact_by_entity.items() if value > 0.0}
    seen = observed["by_entity"] if observed else {}
    names = sorted({*harmed, *(name for name, part in seen.items() if part["mean"] > 0.0)})
    names.sort(key=lambda name: -harmed.get(name, 0.0))
    if not names:
        return "<p>No entity is harmed.</p>"
    colours = dict(zip(_shown(result), ENTITY_COLOURS, strict=False))
    header = ["entity", "all steps", *(_name(step) for step in result.steps)]
    header += ["observed per 10⁶ jobs", "interval"] if observed else []
    rows = []
    for name in names:
        swatch = f'<span class="swatch" style="background:{colours.get(name, OTHERS_COLOUR)}"></span>'
        parts = [step.cost.impact_by_entity.get(name, 0.0) for step in result.steps]
        most = max(parts)
        is_most = [value == most > _NEGLIGIBLE * result.cost.impact for value in parts]
        cells = [
            td(_part(value, result.cost.impact), "best" if best else "")
            for value, best in zip(parts, is_most, strict=True)
        ]
        part = seen.get(name)
        last = [] if not observed else [td("–"), td("–")] if part is None else _seen(observed, part, 0.0)[:2]
        rows.append([td(swatch + escape(name)), td(_part(harmed.get(name, 0.0), result.cost.impact)), *cells, *last])
    return table_of(header, rows)


def _rejected(result: JobResult) -> Iterator[str]:
    if not result.rejected:
        yield "<p>The search met no other order and no other actions.</p>"
        return
    header = ["alternative", "rejected", "why", "cost", "difference", "at least"]
    rows = [_alternative(one) for one in result.rejected]
    yield table_of(header, rows[:_ALTERNATIVES])
    if more := rows[_ALTERNATIVES:]:
        yield f"<details><summary>{len(more)} more</summary>{table_of(header, more)}</details>"
    against = (one.against.total for one in result.rejected if one.against is not None)
    first = next((total for total in against if total != result.cost.total), None)
    told = "" if first is None else f" The chosen sequence costs {number(first, 4)} with its first motions."
    yield note(_REJECTED_NOTE + told)


def _alternative(one: Rejected) -> list[str]:
    name = one.name + ("" if one.is_complete else ", …")
    difference = "–" if np.isnan(one.difference) else f"{one.difference:+.3g}"
    return [
        td(escape(name), "text long"),
        td(escape(_REASONS[one.reason]), "text word"),
        td(escape(one.why), "text long"),
        td("–" if one.cost is None else number(one.cost.total)),
        td(difference),
        td(number(one.lower_bound) if one.lower_bound > 0.0 else "–"),
    ]
