"""Style of the page of a comparison: its style sheet, light and dark, and the format of numbers."""

from __future__ import annotations

import math

STYLE = """
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
td.text { white-space: normal; } td.best { font-weight: 700; } td.bad { color: var(--bad); }
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
