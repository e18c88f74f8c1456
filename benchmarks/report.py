"""Sections of RESULTS.md: tables, targets, and replacing one section without touching the others."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

HEADER = """# Results

Written by `python benchmarks/run.py --write`, a section at a time; each names the machine, the date and the command.
Failures stay in the tables. A target that is not met says so.
"""


@dataclass(frozen=True, kw_only=True)
class Target:
    """One thing that has to hold, and what was measured."""

    what: str
    wanted: str
    measured: str
    met: bool | None
    """None if it could not be measured."""


def table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Format a Markdown table; all but the first column are aligned to the right."""
    lines = [_line(header), _line(["---", *["---:"] * (len(header) - 1)])]
    return "\n".join([*lines, *(_line(row) for row in rows)]) + "\n"


def targets(rows: Iterable[Target]) -> str:
    """Format a table of targets."""
    words = {True: "yes", False: "**no**", None: "**not measured**"}
    return table(("target", "wanted", "measured", "met"), [(t.what, t.wanted, t.measured, words[t.met]) for t in rows])


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


def replace_section(document: str, name: str, body: str, order: Sequence[str]) -> str:
    """Return the document with the section called `name` replaced or added, sections in the given order."""
    found = dict(re.findall(r"<!-- begin (\w+) -->\n(.*?)\n<!-- end \1 -->", document, flags=re.DOTALL))
    found[name] = body.strip()
    sections = [f"<!-- begin {key} -->\n{found[key]}\n<!-- end {key} -->\n" for key in order if key in found]
    return "\n".join([HEADER, *sections])


def write_section(file: Path, name: str, body: str, order: Sequence[str]) -> None:
    """Replace a section in a file, which is made if there is none."""
    document = file.read_text() if file.exists() else ""
    file.write_text(replace_section(document, name, body, order))


def _line(cells: Sequence[object]) -> str:
    return "| " + " | ".join(str(cell).replace("|", "\\|") for cell in cells) + " |"
