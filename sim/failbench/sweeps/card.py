"""The card of a dataset: a `README.md` for readers, and for Hugging Face's `datasets` to find the tables."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from failbench.basics.tables import TABLES
from failbench.sweeps.definition import Sweep

CARD = "README.md"
_MARK = "<!-- made by failbench generate -->"
_SHOWN = 40
"""Greatest number of names in a list."""

_TEXT = """\
---
license: cc0-1.0
task_categories: [robotics]
tags: [robot-failures, mujoco, failbench]
configs:
{configs}
---
{mark}

# Failures of a robot

{rollouts} rollouts in which a simulated robot or its surroundings fail, with {contacts} contact events, made with
FailBench {graceful_plan} and MuJoCo {mujoco}. Each is simulated for {horizon:g} s from the onset on; every fault
strikes every motion {each} times, at onsets spread evenly over the motion (seed {seed}).

No value is measured on a real robot: severities, and the strength and probability of faults, are stated assumptions;
spills come from a model, not from a fluid simulation. Diverged rollouts are rows, too: exclude them from means by
their `status`, and report their number. Not for: rating people's safety, or real robots' rates of failure.

```python
rollouts = pandas.read_parquet("FOLDER/rollouts")
rollouts = polars.read_parquet("FOLDER/rollouts/*.parquet")
rollouts = datasets.load_dataset("FOLDER", "rollouts", split="train")  # Hugging Face
```

`manifest.json` holds the SHA-256 of every file, and the sweep that reproduces the rows; `failbench.read_dataset`
checks the files.

Motions: {motions}. Faults: {faults}.

{tables}"""


def write_card(folder: Path, sweep: Sweep, manifest: Mapping[str, Any]) -> None:
    """Write the card of a dataset, unless there is a README.md from another source."""
    text = _TEXT.format(
        # Hugging Face refuses files without rows.
        configs="\n".join(f"- config_name: {t}\n  data_files: {t}/*.parquet" for t in TABLES if manifest["rows"][t]),
        mark=_MARK,
        rollouts=manifest["rows"]["rollouts"],
        contacts=manifest["rows"]["contacts"],
        graceful_plan=manifest["versions"]["graceful_plan"],
        mujoco=manifest["versions"]["mujoco"],
        horizon=sweep.horizon,
        each=sweep.rollouts,
        seed=sweep.seed,
        motions=_listed([motion.name for motion in sweep.motions]),
        faults=_listed([f"{fault.get('fault')} ({fault.get('degree', 'severe')})" for fault in sweep.faults]),
        tables="\n".join(_table(table) for table in TABLES),
    )
    write_own(folder / CARD, text, _MARK)


def write_own(file: Path, text: str, mark: str) -> None:
    """Write a text that contains a mark, unless the file exists without that mark."""
    if file.exists() and not (file.is_file() and mark in file.read_text(encoding="utf-8", errors="replace")):
        return
    file.write_text(text, encoding="utf-8")


def _listed(names: list[str]) -> str:
    more = len(names) - _SHOWN
    return ", ".join(names[:_SHOWN]) + (f" and {more} more" if more > 0 else "")


def _table(table: str) -> str:
    rows = [f"| `{c.name}` | {c.type} | {c.unit} | {c.meaning} |" for c in TABLES[table]]
    return "\n".join([f"## {table}", "", "| column | type | unit | meaning |", "|---|---|---|---|", *rows, ""])
