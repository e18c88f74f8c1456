"""Result files: tables, targets, the head of a file, and the index of all files."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

RESULTS = Path(__file__).with_name("results")
INDEX = RESULTS / "README.md"
INDEX_HEAD = """# Results

One file per benchmark, written by `python benchmarks/run.py SUBJECT --write`. Each file names its commit, date, machine
and command. "Figure" is one target of the benchmark; "all targets" counts those that are reached. Targets that are
missed stay in the tables. "Long" links results of larger sizes (`--long`), "bound" what the best of many motions
attains (`--bound`); both take hours and may be of an older commit. `make bench-stale` lists the results that are older
than the code they measure.
"""
_COLUMNS = ("benchmark", "question", "figure", "target", "reached", "all targets", "commit")
_TARGETS = ("target", "wanted", "measured", "met")


class NotMeasured(Exception):
    """Raised by a subject that cannot run here, for example because a package is missing; nothing is written."""


@dataclass(frozen=True, kw_only=True)
class Target:
    """A target and the measured value."""

    what: str
    wanted: str
    measured: str
    met: bool | None
    """None if it could not be measured."""


@dataclass(frozen=True, kw_only=True)
class Head:
    """How a result was made."""

    commit: str
    """Abbreviated hash, with a plus if measured files had uncommitted changes; "unknown" without a repository."""
    date: str
    command: str
    duration: str
    machine: str


def table(header: Sequence[str], rows: Iterable[Sequence[object]], *, numbers: bool = True) -> str:
    """Format a Markdown table; columns of numbers, all but the first, are aligned to the right."""
    lines = [_line(header), _line(["---", *["---:" if numbers else "---"] * (len(header) - 1)])]
    return "\n".join([*lines, *(_line(row) for row in rows)]) + "\n"


def targets(rows: Iterable[Target]) -> str:
    """Format a table of targets."""
    words = {True: "yes", False: "**no**", None: "**not measured**"}
    return table(_TARGETS, [(t.what, t.wanted, t.measured, words[t.met]) for t in rows])


def all_done(what: str, done: int, of: int, wanted: str = "all") -> Target:
    """Return the target that something is done in all cases."""
    return Target(what=what, wanted=wanted, measured=f"{done} of {of}", met=done == of)


def none_of(what: str, found: int, wanted: str = "0") -> Target:
    """Return the target that something never happens."""
    return Target(what=what, wanted=wanted, measured=str(found), met=found == 0)


def quantity(value: float, unit: str = "", digits: int = 3) -> str:
    """Format a number to some significant digits; "none" for infinity and NaN."""
    if not math.isfinite(value):
        return "none"
    text = f"{value:.{digits}g}"
    return f"{float(text):g}{unit}" if "e" in text else f"{text}{unit}"


def percent(share: float, digits: int = 1) -> str:
    """Format a share as a percentage; "none" for infinity and NaN."""
    return f"{100.0 * share:.{digits}f} %" if math.isfinite(share) else "none"


# --- files ------------------------------------------------------------------------------------------------------------


def file_of(name: str) -> Path:
    """Return the result file of a subject."""
    return RESULTS / f"{name}.md"


def document(title: str, question: str, head: Head, body: str) -> str:
    """Return the text of a result file."""
    return "\n".join(
        [
            f"# {title}\n",
            f"**{question}**\n",
            f"- Commit: `{head.commit}`",
            f"- Date: {head.date}",
            f"- Command: `{head.command}`",
            f"- Duration: {head.duration}",
            f"- Machine: {head.machine}",
            "",
            body.strip(),
            "",
        ]
    )


def commit_of(text: str) -> str:
    """Return the commit that a result file names; "unknown" if it names none."""
    found = re.search(r"^- Commit: `?([0-9a-f]{7,40}\+?)", text, flags=re.MULTILINE)
    return found[1] if found else "unknown"


def measured_targets(text: str) -> list[tuple[str, str, str, str]]:
    """Return the rows of all target tables of a result file: what, wanted, measured, met."""
    rows, inside = [], False
    for line in text.splitlines():
        cells = tuple(cell.strip().replace("\\|", "|") for cell in re.split(r"(?<!\\)\|", line)[1:-1])
        if cells == _TARGETS:
            inside = True
        elif len(cells) != len(_TARGETS):
            inside = False
        elif inside and not cells[0].startswith("---"):
            rows.append(cells)
    return rows


def index_row(name: str, question: str, headline: str, text: str) -> tuple[str, ...]:
    """Return the row of a result file in the index.

    Args:
        name: Subject.
        question: The question it answers.
        headline: First words of the target to show, or of a line "headline: figure" where there are no targets.
        text: The result file.

    Raises:
        ValueError: If neither a target nor a line begins with the headline.
    """
    rows = measured_targets(text)
    shown = next((row for row in rows if row[0].startswith(headline)), None)
    if shown is None:
        line = re.search(rf"^{re.escape(headline)}.*: \S.*$", text, flags=re.MULTILINE)
        if line is None:
            raise ValueError(f"{name}: no target and no figure begins with {headline!r}")
        figure, wanted, met = line[0].rstrip("."), "-", "-"
    else:
        what, wanted, measured, met = shown
        figure = f"{what}: {measured}"
    reached = f"{sum(row[3] == 'yes' for row in rows)} of {len(rows)}" if rows else "-"
    commit = commit_of(text)
    named = commit if commit == "unknown" else f"`{commit}`"
    others = [kind for kind in ("long", "bound") if file_of(f"{name}_{kind}").exists()]
    links = ", ".join([f"[{name}]({name}.md)", *(f"[{kind}]({name}_{kind}.md)" for kind in others)])
    return links, question, figure, wanted, met, reached, named


def index(rows: Mapping[str, Sequence[str]]) -> str:
    """Return the text of the index from its rows."""
    return f"{INDEX_HEAD}\n{table(_COLUMNS, rows.values(), numbers=False)}"


def _line(cells: Sequence[object]) -> str:
    return "| " + " | ".join(str(cell).replace("|", "\\|") for cell in cells) + " |"
