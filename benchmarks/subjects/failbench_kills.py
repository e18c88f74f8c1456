"""Sweeps under SIGKILL: is anything lost, is anything done twice? The work is done by `benchmarks/kill_sweep.py`."""

from __future__ import annotations

import contextlib
import importlib.util
import tempfile
from collections.abc import Iterator
from pathlib import Path

from benchmarks import report, suite
from benchmarks.kill_sweep import Trial
from benchmarks.ray_nodes import RayNodes

TITLE = "FailBench: sweeps under kill -9"
MEASURED = """\
A sweep of four faults on one motion, 96 rollouts each, two workers. SIGKILL strikes the driver or a worker at a random
moment; a killed driver is followed by another one, half of the time by `failbench resume`. When the sweep is complete,
its dataset is compared with that of an undisturbed run, byte by byte; then another sweep begins, until there were
enough kills. "Ray": the workers are those of two nodes of a Ray cluster on this machine, with a head that does no work;
SIGKILL also strikes whole nodes, and others join. Its datasets are compared with that of local processes. A chunk whose
worker was killed three times counts as failed; its driver says so at the end, and the next one tries again. The head is
never killed: without it a cluster of Ray ends, and `failbench resume` goes on with another one.
"""
KILLS, KILLS_IN_A_QUICK_RUN = 50, 3


def run(options: suite.Options) -> str:
    """Kill processes, and return Markdown."""
    kills = KILLS_IN_A_QUICK_RUN if options.quick else KILLS
    places = {"local processes": False} | ({"Ray": True} if importlib.util.find_spec("ray") else {})
    rows = [row for name, on_ray in places.items() for row in _rows(name, on_ray, kills, options)]
    missing = "" if len(places) == 2 else "\nRay is not installed here: not measured.\n"
    return f"{MEASURED}{missing}\n{report.targets(rows)}"


def _rows(name: str, on_ray: bool, kills: int, options: suite.Options) -> Iterator[report.Target]:
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        nodes = stack.enter_context(RayNodes(2)) if on_ray else None
        trial = Trial(folder, rollouts=32 if options.quick else 96, workers=2, seed=0, nodes=nodes)
        trial.run(kills)
    struck = ", ".join(f"{trial.kills[who]} of {who}s" for who in trial.victims)
    struck += f"; {trial.gave_up} drivers gave a chunk up" if trial.gave_up else ""
    lost = trial.sweeps * trial.total - trial.rows
    yield report.Target(what=f"{name}: kills", wanted=str(kills), measured=struck, met=trial.kills.total() >= kills)
    yield report.Target(
        what=f"{name}: rollouts lost or duplicated",
        wanted="0",
        measured=f"{abs(lost)} of {trial.rows}, in {trial.sweeps} sweeps",
        met=lost == 0,
    )
    yield report.Target(
        what=f"{name}: datasets unlike the undisturbed one",
        wanted="0",
        measured=f"{trial.wrong} of {trial.sweeps}",
        met=trial.wrong == 0,
    )
