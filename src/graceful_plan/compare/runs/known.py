"""Files of best-known total costs, written by one comparison and read by another."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path

from graceful_plan.compare.runs.best_motions import BestMotions
from graceful_plan.exceptions import SettingError, names_file
from graceful_plan.regular_file import path_of
from graceful_plan.yaml_file import read_yaml

NAME = "best_known.yaml"
_VERSION = 1


@names_file
def read_known(file: str | Path, w: float | None = None) -> dict[str, float]:
    """Read best-known total costs by problem.

    Args:
        file: YAML with `version`, `w` and `best_known`, a mapping from problems to costs; or a folder of best
            motions, each of which is verified (see `best_motions`).
        w: Expected safety weight, or None to accept any.

    Raises:
        SceneError: If the file is malformed; with the line.
        SettingError: If the costs are for another weight.
        StaleBestMotion: If a motion in a folder is invalid or for another weight.
    """
    place = path_of(file)
    if place.is_dir():
        return (BestMotions.in_folder(place) if w is None else BestMotions(place, w)).totals()
    top = read_yaml(place)
    top.only("version", "w", "best_known")
    if top["version"].number() != _VERSION:
        raise top["version"].error(f"version {top['version'].value}; this version reads {_VERSION}")
    if w is not None and top["w"].number() != w:
        raise SettingError("w", w, f"{top['w'].number():g}: {file} is for that weight")
    return {name: block.number() for name, block in top["best_known"].items()}


def write_known(best: Mapping[str, float], w: float, folder: Path) -> Path:
    """Write the finite best-known total costs."""
    file = folder / NAME
    # JSON strings are valid YAML for any name of a problem.
    lines = [f"  {json.dumps(name)}: {total!r}" for name, total in best.items() if math.isfinite(total)]
    text = "\n".join([f"version: {_VERSION}", f"w: {w!r}", "best_known:" + ("" if lines else " {}"), *lines])
    partial = file.with_suffix(".partial")
    partial.write_text(text + "\n", encoding="utf-8")
    partial.replace(file)
    return file


def known_costs(*sources: Mapping[str, float]) -> dict[str, float]:
    """Return the least cost over all sources, by problem."""
    found: dict[str, float] = {}
    for source in sources:
        for name, total in source.items():
            found[name] = min(total, found.get(name, math.inf))
    return found
