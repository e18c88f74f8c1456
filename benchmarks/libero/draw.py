"""The tasks of LIBERO that are measured: transports, drawn by a seed before anything is planned."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

SUITES = ("libero_spatial", "libero_object", "libero_goal", "libero_90", "libero_10")
"""The suites with the 130 original tasks."""
SEED = 2026


def drawn(bddl: Path) -> list[str]:
    """Return the tasks that carry something somewhere, "SUITE/TASK", in a random order.

    Args:
        bddl: Folder of the package with the task descriptions.
    """
    files = [file for suite in SUITES for file in sorted((bddl / suite).glob("*.bddl"))]
    order = np.random.default_rng(SEED).permutation(len(files))
    return [f"{files[i].parent.name}/{files[i].stem}" for i in order if _carries(files[i].read_text(encoding="utf-8"))]


def _carries(text: str) -> bool:
    """Whether a goal of a task description is to put an object somewhere."""
    objects = set(re.findall(r"\S+", text.split("(:objects", 1)[1].split("(:obj_of_interest", 1)[0]))
    goal = text.split("(:goal", 1)[1]
    return any(name in objects for name in re.findall(r"\((?:on|in)\s+(\S+)", goal, flags=re.IGNORECASE))
