"""Report of a comparison: one self-contained HTML page with inline figures and scripts only for the 3-D view."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from pathlib import Path

from graceful_plan.compare.reports import figures
from graceful_plan.compare.reports.calls import CallSummary
from graceful_plan.compare.reports.in_space import section
from graceful_plan.compare.reports.statistics import CONFIDENCE, TIE, Paired
from graceful_plan.compare.reports.summary import PlannerSummary, Summary, gap, median
from graceful_plan.compare.runs.records import EARLY
from graceful_plan.viz.html_page import counted, document, figure_of, note, number, p_value, percent, table_of, td

NAME = "report.html"
_SIGNIFICANT = 0.05
_DETAILS = 40
"""Maximum number of listed outcomes other than SOLVED."""
_OVERVIEW_NOTE = (
    "Medians over problems and seeds, with the worse of two middle values. Unsolved runs count as infinite (∞) in "
    "times and gaps, and are left out of the columns to the right. The best of each column is bold. Motion and "
    "impact are in units of the best-known total. Jerk in rad/s³. Closest: least clearance of all runs."
)
_GAP_NOTE = (
    "Median over problems and seeds of the relative excess of the best cost found over the best-known cost. The last "
    "value of a run is the cost of its motion. Earlier values are costs of paths as estimated by the search; estimates "
    "below the cost of the motion are left out. A line begins once half of the runs have a value."
)
_BAND_NOTE = "The band lies between the quartiles."
_SHARE_NOTE = (
    "Composition of the results: each dot is a problem, with motion and weighted impact in units of the best-known "
    "total. Dots on the same grey line have the same cost. Costs above four times the best-known one are outside of "
    "the figure."
)
_SPREAD_NOTE = (
    "Solved runs, one dot each unless there are many; bars between the quartiles, with the median. Jerk: third "
    "difference of positions every 20 ms of the timed trajectory. Clearance: least exact distance of robot and "
    "carried object to the surroundings, except for the supports of the object at the ends."
)
_CALLS_NOTE = (
    "First path: time from the call to the first path of its search. Motion, CPU, 95 %: time of a separate call, which "
    "ends with its first path, until the verified motion; wall time, and processor time of all threads. Over: delay "
    "of the return after the time limit. Path at: motion cost of the best path at that time, as estimated by the "
    "search. Refused: calls with an invalid start or goal."
)
_PAIRS_NOTE = (
    "For each problem, the median over its seeds of the total cost of the result; infinite if most seeds were not "
    f"solved. A ratio below 1 and wins favour the planner; differences below {100 * TIE:g} % are ties. p: Wilcoxon's "
    "signed-rank test over the problems, two-sided; corrected by Holm's method for all tested pairs, "
    f"bold below {_SIGNIFICANT:g}. The interval is a bootstrap over problems."
)


def write_report(summary: Summary, folder: Path, space: Mapping[str, str] | None = None) -> Path:
    """Write the page, with a view from `in_space`; an existing file is replaced once the new one is complete."""
    file = folder / NAME
    partial = file.with_suffix(".partial")
    partial.write_text(page(summary, space), encoding="utf-8")
    partial.replace(file)
    return file


def page(summary: Summary, space: Mapping[str, str] | None = None) -> str:
    """Return the page as text."""
    comparison = summary.comparison
    title = f"Planners on {comparison.suite}"
    parts = [
        f"<h1>{escape(title)}</h1>",
        f'<p class="lead">{escape(_lead(summary))}</p>',
        *_headline(summary),
        *_warnings(summary),
        *(_sections(summary) if comparison.runs else ["<p>No run is done yet.</p>"]),
        *section(space),
        *_machine(summary),
    ]
    return document(title, parts)


def _lead(summary: Summary) -> str:
    c = summary.comparison
    counts = (
        f"{counted(len(c.problems), 'problem')}, {counted(len(c.planners), 'planner')}, {counted(len(c.seeds), 'seed')}"
    )
    return f"{counts}; every call with time_limit = {c.seconds:g} s and w = {c.w:g}; begun {c.begun}"


def _headline(summary: Summary) -> Iterator[str]:
    """Say which planner is best at what, and whether the difference in cost may be luck."""
    ran = [planner for planner in summary.planners if planner.runs]
    if len(ran) < 2:
        return
    told = []
    best, second = sorted(ran, key=lambda planner: planner.gap)[:2]
    if math.isfinite(best.gap):
        told.append(f"Least cost: {best.planner}{_against(summary, best.planner, second.planner)}.")
    most = max(planner.solved / planner.runs for planner in ran)
    solvers = [planner.planner for planner in ran if planner.solved / planner.runs == most]
    many = "all planners" if len(solvers) == len(ran) else ", ".join(solvers)
    told.append(f"Most problems solved: {many} ({percent(most)}).")
    quickest = min(ran, key=lambda planner: planner.first)
    if math.isfinite(quickest.first):
        told.append(f"First path the soonest: {quickest.planner} ({number(1e3 * quickest.first)} ms).")
    yield f'<p class="lead"><strong>{escape(" ".join(told))}</strong></p>'


def _against(summary: Summary, best: str, second: str) -> str:
    """Return how the cost of the best planner compares with that of the next one, problem by problem."""
    pair = next((p for p in summary.pairs if {p.first, p.second} == {best, second}), None)
    if pair is None or not math.isfinite(pair.ratio):
        return ""
    mine, other = (pair.wins, pair.losses) if pair.second == best else (pair.losses, pair.wins)
    p = pair.p if math.isnan(pair.p_holm) else pair.p_holm
    luck = "not luck" if p < _SIGNIFICANT else "which may be luck"
    return f", better than {second} on {mine} of {pair.n} problems and worse on {other}, {luck} (p {p_value(p)})"


def _warnings(summary: Summary) -> Iterator[str]:
    c = summary.comparison
    if len(c.runs) < c.expected:
        yield f'<p class="warn">{len(c.runs)} of {c.expected} runs are done; all figures are of these.</p>'
    late = [f"{planner.planner} {planner.late} of {planner.runs}" for planner in summary.planners if planner.late]
    if late:
        yield (
            f'<p class="warn">Calls that returned long after their time limit: {escape(", ".join(late))}. '
            "Their results had more time than the others.</p>"
        )
    unsolved = [problem for problem in c.problems if not math.isfinite(summary.best[problem])]
    if c.runs and unsolved:
        yield f'<p class="warn">Solved by no run, so without a gap: {escape(", ".join(unsolved))}.</p>'
    if c.runs and len(c.problems) < 6:
        yield (
            f'<p class="warn">With {counted(len(c.problems), "problem")}, no test on pairs can reach p &lt; 0.05; '
            "differences may be due to chance. Use at least six problems, better 20.</p>"
        )


def _sections(summary: Summary) -> Iterator[str]:
    yield "<h2>Overview</h2>"
    yield from _overview(summary)
    yield from _calls(summary.calls)
    yield "<h2>Success and time to first path</h2>"
    yield figure_of(
        figures.solved_figure(summary),
        "Share of runs with a path at that time. Runs without a verified result never count.",
    )
    yield "<h2>Gap to best known over time</h2>"
    many = len(summary.comparison.planners) > figures.BANDS
    yield figure_of(
        figures.gap_figure(summary),
        f"{_GAP_NOTE} {'' if many else _BAND_NOTE}",
    )
    if many:
        yield figure_of(
            figures.gap_panels(summary),
            f"The same gap for each planner, with the others in grey. {_BAND_NOTE}",
        )
    if summary.comparison.w > 0.0:
        yield "<h2>Motion and impact</h2>"
        yield figure_of(
            figures.share_figure(summary),
            _SHARE_NOTE,
        )
    yield "<h2>Jerk, clearance, duration</h2>"
    yield figure_of(
        figures.spread_figure(summary),
        _SPREAD_NOTE,
    )
    yield "<h2>Pair by pair</h2>"
    yield from _pairs(summary.pairs)
    yield "<h2>Problem by problem</h2>"
    yield from _problems(summary)
    yield from _outcomes(summary)


def _overview(summary: Summary) -> Iterator[str]:
    planners = summary.planners
    at = list(planners[0].gap_at)
    header = [
        "planner",
        "solved",
        "first path [ms]",
        *(f"gap at {t} s" for t in at),
        "gap of result",
        "verified at [s]",
        "slowest [s]",
    ]
    header += ["motion / best", "w impact / best", "peak jerk", "rms jerk", "clearance [cm]", "closest [cm]"]
    columns: list[list[float]] = [
        [-p.solved / p.runs if p.runs else math.inf for p in planners],
        [p.first for p in planners],
        *([p.gap_at[t] for p in planners] for t in at),
        [p.gap for p in planners],
    ]
    best = [min((value for value in column if math.isfinite(value)), default=math.nan) for column in columns]
    rows = []
    for i, planner in enumerate(planners):
        cells = [
            f"{planner.solved} / {planner.runs}",
            number(1e3 * planner.first),
            *(percent(planner.gap_at[t]) for t in at),
            percent(planner.gap),
        ]
        marked = [
            td(cell, "best" if math.isclose(column[i], b, rel_tol=1e-3, abs_tol=1e-9) else "")
            for cell, column, b in zip(cells, columns, best, strict=True)
        ]
        rest = [planner.seconds, planner.slowest, planner.motion, planner.impact, planner.jerk_peak, planner.jerk_rms]
        rest += [100.0 * planner.clearance, 100.0 * planner.closest]
        rows.append([td(_swatch(i) + escape(planner.planner)), *marked, *(td(number(value)) for value in rest)])
    yield table_of(header, rows)
    yield note(_OVERVIEW_NOTE)


def _calls(calls: Sequence[CallSummary]) -> Iterator[str]:
    if not calls:
        return
    header = ["kind", "planner", "solved", "refused", "first path [ms]", "motion [ms]", "CPU [ms]", "95 % [ms]"]
    header += ["over p99 [ms]", "over most [ms]", *(f"path at {1e3 * at:g} ms" for at in EARLY)]
    rows = [
        [
            td(escape(row.group)),
            td(escape(row.planner), "text"),
            td(f"{row.solved} / {row.runs}"),
            td(str(row.refused) if row.refused else "–"),
            *(td(number(1e3 * t)) for t in (row.search, row.motion_wall, row.motion_cpu, row.slow)),
            *(td(number(1e3 * max(t, 0.0))) for t in (row.over, row.most_over)),
            *(td(number(value)) for value in row.early or [math.nan] * len(EARLY)),
        ]
        for row in calls
    ]
    yield "<h2>Calls by kind of problem</h2>"
    yield table_of(header, rows)
    yield note(_CALLS_NOTE)


def _pairs(pairs: Sequence[Paired]) -> Iterator[str]:
    if not pairs:
        yield "<p>There is only one planner.</p>"
        return
    header = ["reference", "planner", "wins", "ties", "losses", "median cost ratio"]
    header += [f"{100 * CONFIDENCE:g} % interval", "p", "p (Holm)", "problems"]
    rows = [
        [
            td(escape(pair.first)),
            td(escape(pair.second), "text"),
            *(td(str(count)) for count in (pair.wins, pair.ties, pair.losses)),
            td(number(pair.ratio, 4)),
            td(f"{number(pair.low, 4)} – {number(pair.high, 4)}"),
            td(p_value(pair.p)),
            td(p_value(pair.p_holm), "best" if pair.p_holm < _SIGNIFICANT else ""),
            td(str(pair.n)),
        ]
        for pair in pairs
    ]
    reference = [row for row, pair in zip(rows, pairs, strict=True) if pair.first == pairs[0].first]
    yield table_of(header, reference)
    if len(rows) > len(reference):
        yield f"<details><summary>All {len(rows)} pairs</summary>{table_of(header, rows)}</details>"
    yield note(_PAIRS_NOTE)


def _problems(summary: Summary) -> Iterator[str]:
    comparison = summary.comparison
    rows = []
    for problem in comparison.problems:
        best = summary.best[problem]
        cells = []
        for planner in comparison.planners:
            runs = comparison.of(planner=planner, problem=problem)
            cells.append(median([gap(run.total if run.solved else math.inf, best) for run in runs]))
        least = min((value for value in cells if math.isfinite(value)), default=math.nan)
        marked = [td(percent(v), "best" if v <= least + 1e-3 else "" if math.isfinite(v) else "bad") for v in cells]
        rows.append([td(escape(problem)), td(number(best, 5)), *marked])
    yield table_of(["problem", "best known", *comparison.planners], rows)
    yield note("Median gap of the result over seeds. Best known: from all these runs and from earlier knowledge.")


def _outcomes(summary: Summary) -> Iterator[str]:
    other = [run for run in summary.comparison.runs if not run.solved]
    if not other:
        return
    yield "<h2>Runs without a verified result</h2>"
    statuses = sorted({run.status for run in other})
    yield table_of(["planner", *statuses], [_outcome_row(i, p, statuses) for i, p in enumerate(summary.planners)])
    rows = [
        [
            td(escape(run.problem)),
            *(td(escape(str(x)), "text") for x in (run.planner, run.seed, run.status, run.detail)),
        ]
        for run in other[:_DETAILS]
    ]
    more = f" (the first {_DETAILS} of {len(other)})" if len(other) > _DETAILS else ""
    table = table_of(["problem", "planner", "seed", "status", "detail"], rows)
    yield f"<details><summary>One by one{more}</summary>{table}</details>"


def _outcome_row(index: int, planner: PlannerSummary, statuses: Sequence[str]) -> list[str]:
    counts = (planner.outcomes.get(status, 0) for status in statuses)
    return [td(_swatch(index) + escape(planner.planner)), *(td(str(count) if count else "–") for count in counts)]


def _machine(summary: Summary) -> Iterator[str]:
    c = summary.comparison
    processes = c.settings.get("processes", 1)
    rows = [*c.machine.items(), ("runs at a time", str(max(1, int(processes))))]
    yield "<h2>Made on</h2>"
    yield table_of(["", ""], [[td(escape(key)), td(escape(value), "text")] for key, value in rows])


def _swatch(index: int) -> str:
    return f'<span class="swatch" style="background:{figures.COLOURS[index % len(figures.COLOURS)]}"></span>'
