"""Texts of the page as HTML; names from scene files are escaped."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

from graceful_plan.viewer.browser.marks import RISK, greatest_risk
from graceful_plan.viewer.failing import Replay
from graceful_plan.viewer.question import PlanAnswer
from graceful_plan.viewer.recorded import Recorded
from graceful_plan.viewer.shown import ShownMotion

_STYLE = "font-size:0.85em;line-height:1.35;padding:0.2em 0.75em"
_SHOWN = 6


def plan_words(answer: PlanAnswer | None, kept: Sequence[ShownMotion] = (), *, busy: bool) -> str:
    """Return a table of the costs of both motions and the kept ones, or the reason why a motion is missing."""
    if answer is None:
        return _page("planning …" if busy else "no plan yet")
    columns: list[tuple[str, ShownMotion | None]] = [
        (f"w = {answer.question.w:g}", answer.chosen),
        ("w = 0", answer.ordinary),
        *((motion.label, motion) for motion in kept),
    ]
    rows: list[tuple[str, list[str]]] = [
        ("duration [s]", [_number(motion and motion.duration) for _, motion in columns]),
        ("motion [rad]", [_number(motion and motion.cost.motion) for _, motion in columns]),
        ("impact", [_number(motion and motion.cost.impact) for _, motion in columns]),
    ]
    text = _table(["", *(escape(label) for label, _ in columns)], rows) + _legend((*answer.motions, *kept))
    troubles = [said for said, (_, motion) in zip(answer.said, columns[:2], strict=True) if motion is None]
    text += "".join(f"<p>{escape(said)}</p>" for said in dict.fromkeys(troubles))
    return _page(text + ("<p><em>planning …</em></p>" if busy else ""))


def _legend(motions: tuple[ShownMotion, ...]) -> str:
    """Return the legend of the path colours."""
    if not motions:
        return ""
    colours = ",".join(RISK)
    bar = f'<span style="flex:1;height:.5em;margin:0 .5em;background:linear-gradient(90deg,{colours})"></span>'
    greatest = f"{greatest_risk(motions):.3g}"
    return f'<div style="display:flex;align-items:center">impact along the paths: 0{bar}{greatest}</div>'


def now_words(impact: Mapping[str, float], *, failed: bool) -> str:
    """Return the impact of a failure at this moment by entity, with bars."""
    if failed:
        return _page("<b>The robot has failed.</b>")
    total = sum(impact.values())
    greatest = max([*impact.values(), 1e-9])
    rows = "".join(
        f'<tr><td style="white-space:nowrap">{escape(name)}</td><td style="text-align:right;padding:0 .5em">{value:.2f}'
        f'</td><td style="width:45%"><div style="height:.6em;background:#ef6548;width:{100 * value / greatest:.0f}%">'
        "</div></td></tr>"
        for name, value in list(impact.items())[:_SHOWN]
        if value >= 0.005
    )
    return _page(f'Impact of a failure now: <b>{total:.2f}</b><table style="width:100%">{rows}</table>')


def failure_words(replay: Replay | None, motion: ShownMotion | None) -> str:
    """Return predicted and observed harm of a failure."""
    if replay is None:
        return _page("Choose what fails and when, then let it fail." if motion else "There is no motion yet.")
    names = sorted({*replay.predicted, *replay.observed}, key=lambda name: -_larger(replay, name))
    shown = [name for name in names if _larger(replay, name) >= 0.005][:_SHOWN]
    rows = [(escape(n), [f"{values.get(n, 0.0):.2f}" for values in (replay.predicted, replay.observed)]) for n in shown]
    total = [f"<b>{sum(values.values()):.2f}</b>" for values in (replay.predicted, replay.observed)]
    failure = replay.failure
    title = f"{escape(failure.fault)}, {escape(failure.degree)}, at {failure.moment:.0%} ({replay.onset:.2f} s)"
    text = f"<b>{title}</b>" + _table(["harm", "predicted", "observed"], [("all", total), *rows])
    hits = [f"{escape(striker)} → {escape(name)} after {time:.2f} s" for striker, name, time, _ in replay.hits[:_SHOWN]]
    text += f"<p>{'<br>'.join(hits) or 'Nothing was touched that the healthy robot leaves alone.'}</p>"
    text += "".join(f"<p>{escape(note)}</p>" for note in replay.notes)
    text += "<p>Predicted: expected harm of this fault at this moment. Observed: one simulated failure.</p>"
    return _page(text)


def recorded_words(row: Recorded | None, count: int) -> str:
    """Return the record of a rollout in a dataset.

    Args:
        row: The rollout; None if none matches the filters.
        count: Number of matching rollouts.
    """
    if row is None:
        return _page("There is no such rollout.")
    impact = "the simulation blew up" if row.diverged else _number(row.impact)
    cells: list[tuple[str, list[str]]] = [
        ("rollout", [f"{row.number}, of {count}"]),
        ("motion", [escape(row.motion)]),
        ("fault", [f"{escape(row.fault)}, {escape(row.degree)}"]),
        ("onset [s]", [_number(row.onset)]),
        ("observed harm", [impact]),
        ("touches", [str(row.contacts)]),
        ("object dropped", ["yes" if row.dropped else "no"]),
        ("spilt", [f"{row.spilled:.0%}"]),
    ]
    return _page(_table(["", "in the dataset"], cells))


def _larger(replay: Replay, name: str) -> float:
    return max(replay.predicted.get(name, 0.0), replay.observed.get(name, 0.0))


def _table(header: Sequence[str], rows: Sequence[tuple[str, Sequence[str]]]) -> str:
    def cells(tag: str, values: Sequence[str]) -> str:
        sides = ["left", *["right"] * (len(values) - 1)]
        return "".join(
            f'<{tag} style="text-align:{side};font-weight:{600 if tag == "th" else "inherit"}">{value}</{tag}>'
            for side, value in zip(sides, values, strict=True)
        )

    body = "".join(f"<tr>{cells('td', [name, *values])}</tr>" for name, values in rows)
    return f'<table style="width:100%"><tr>{cells("th", header)}</tr>{body}</table>'


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.3g}"


def _page(text: str) -> str:
    return f'<div style="{_STYLE}">{text}</div>'
