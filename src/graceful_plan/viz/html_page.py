"""Parts of the pages of comparisons and jobs: style sheet, light and dark, tables, figures, and formats of numbers."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Callable, Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING

from graceful_plan.viz.style import STYLE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_DENSE = 12
"""Number of columns above which a table is set more tightly, to fit a page of 1,300 pixels."""
_WIDTH = 7.2
"""Width of a figure [inch]."""
_SHEET = """
:root { color-scheme: light dark; --paper: #fff; --ink: #111; --soft: #555; --rule: #e6e6e6; --line: #999;
  --bad: #a40000; --warn: #fff4d6; }
@media (prefers-color-scheme: dark) { :root { --paper: #16181d; --ink: #eee; --soft: #a8adb5; --rule: #3a3f47;
  --line: #777; --bad: #ff8a80; --warn: #4a3a12; } 
  svg, span.swatch { filter: invert(.93) hue-rotate(180deg); } }
body { font: 14px/1.45 system-ui, sans-serif; color: var(--ink); background: var(--paper); max-width: 76rem;
  margin: 1.2rem auto; padding: 0 1rem; }
h1 { font-size: 1.25rem; margin-bottom: 0; } h2 { font-size: 1.1rem; margin-top: 2rem; }
p.lead { color: var(--soft); margin-top: .2rem; } p.note, figcaption { color: var(--soft); font-size: .87rem;
  max-width: 56rem; }
div.wide { overflow-x: auto; max-width: 100%; } figure { margin: 1rem 0; }
svg { width: 100%; height: auto; max-width: 60rem; box-sizing: border-box; }
table { border-collapse: collapse; font-size: .87rem; font-variant-numeric: tabular-nums; margin: .8rem 0; }
th, td { padding: .22rem .5rem; text-align: right; white-space: nowrap; border-bottom: 1px solid var(--rule); }
th { font-weight: 600; border-bottom: 1px solid var(--line); vertical-align: bottom; white-space: normal; }
table.dense { font-size: .8rem; } table.dense :is(th, td) { padding: .22rem .3rem; }
th:first-child, td:first-child, td.text, th.text { text-align: left; }
iframe { border: 1px solid var(--rule); border-radius: 4px; width: 100%; height: 32rem; display: block; }
td.text { white-space: normal; } td.long { min-width: 13rem; } td.word { white-space: nowrap; }
div.wide svg { min-width: 40rem; } div.wide figure { margin: 0; }
td.best { font-weight: 700; } td.bad { color: var(--bad); }
span.swatch { display: inline-block; width: .7em; height: .7em; border-radius: 2px; margin-right: .45em;
  outline: 1px solid var(--line); }
.warn { background: var(--warn); border-left: 4px solid #e69f00; padding: .5rem .8rem; }
""".strip()


def number(value: float, digits: int = 3) -> str:
    """Format a number for a table; NaN becomes a dash."""
    if math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞"
    return f"{value:.{digits}g}" if abs(value) < 10.0**digits else f"{value:.0f}"


def percent(value: float) -> str:
    """Format a fraction as a percentage; NaN becomes a dash."""
    if not math.isfinite(value):
        return "–" if math.isnan(value) else "∞"
    return f"{100.0 * value:.1f} %" if value < 10.0 else f"{100.0 * value:.0f} %"


def p_value(value: float) -> str:
    """Format a p-value; NaN becomes a dash."""
    return "–" if math.isnan(value) else f"{value:.3f}" if value >= 0.001 else f"{value:.1e}"


def document(title: str, parts: Iterable[str]) -> str:
    """Return a page with a title as text, and a body of HTML parts."""
    head = f'<meta charset="utf-8"><title>{escape(title)}</title><style>{_SHEET}</style>'
    view = '<meta name="viewport" content="width=device-width, initial-scale=1">'
    body = "\n".join(parts)
    return f'<!DOCTYPE html>\n<html lang="en"><head>{head}{view}</head><body>\n{body}\n</body></html>\n'


def table_of(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table with rows of HTML cells; headers may break at underscores."""
    kinds = [' class="text"' if rows and "text" in rows[0][i][:20] else "" for i in range(len(header))]
    names = (escape(name).replace("_", "_<wbr>") for name in header)
    top = "".join(f"<th{kind}>{name}</th>" for kind, name in zip(kinds, names, strict=True)) if any(header) else ""
    lines = "\n".join(f"<tr>{''.join(row)}</tr>" for row in rows)
    dense = ' class="dense"' if len(header) > _DENSE else ""
    return f'<div class="wide"><table{dense}><thead><tr>{top}</tr></thead><tbody>\n{lines}\n</tbody></table></div>'


def td(content: str, kind: str = "") -> str:
    """Return a cell with HTML content."""
    return f'<td class="{kind}">{content}</td>' if kind else f"<td>{content}</td>"


def figure_of(svg: str, caption: str) -> str:
    """Return a figure with a caption as text."""
    return f"<figure>{svg}<figcaption>{escape(caption)}</figcaption></figure>"


def note(text: str) -> str:
    """Return a paragraph of explanation."""
    return f'<p class="note">{escape(text)}</p>'


def counted(number: int, noun: str) -> str:
    """Return a number with its noun."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def svg(draw: Callable[[Figure], None], name: str, height: float) -> str:
    """Return a figure as an SVG element with ids that are unique on the page."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context({**STYLE, "svg.hashsalt": name, "text.parse_math": False}):
        figure = Figure(figsize=(_WIDTH, height), layout="constrained")
        draw(figure)
        out = io.StringIO()
        figure.savefig(
            out, format="svg", transparent=True, metadata=dict.fromkeys(("Date", "Creator", "Format", "Type"))
        )
    text = out.getvalue()
    text = text[text.index("<svg") :]
    used = set(re.findall(r"[\"(]#([\w.-]+)", text))
    text = re.sub(r' id="([\w.-]+)"', lambda found: found[0] if found[1] in used else "", text)
    text = re.sub(r'(id="|["(]#)([\w.-]+)(?=[")])', rf"\1{name}-\2", text)
    # The page sets the width.
    return re.sub(r'^<svg[^>]*?viewBox="([^"]+)"[^>]*>', r'<svg role="img" viewBox="\1">', text, count=1).strip()
