"""Sweeps under SIGKILL: is anything lost, is anything done twice? The work is done by `benchmarks/kill_sweep.py`."""

from __future__ import annotations

import tempfile
from pathlib import Path

from benchmarks import report, suite
from benchmarks.kill_sweep import Trial

TITLE = "FailBench: sweeps under kill -9"
MEASURED = """\
A sweep of four faults on one motion, 96 rollouts each, two workers. SIGKILL strikes the driver or a worker at a random
moment; a killed driver is followed by another one, half of the time by `failbench resume`. When the sweep is complete,
its dataset is compared with that of an undisturbed run, byte by byte; then another sweep begins, until there were
enough kills.
"""
KILLS, KILLS_IN_A_QUICK_RUN = 50, 3


def run(options: suite.Options) -> str:
    """Kill processes, and return Markdown."""
    kills = KILLS_IN_A_QUICK_RUN if options.quick else KILLS
    with tempfile.TemporaryDirectory() as folder:
        trial = Trial(Path(folder), rollouts=32 if options.quick else 96, workers=2, seed=0)
        trial.run(kills)
    done = trial.kills
    struck = f"{done['driver']} of drivers, {done['worker']} of workers"
    lost = trial.sweeps * trial.total - trial.rows
    rows = [
        report.Target(what="kills", wanted=str(kills), measured=struck, met=done.total() >= kills),
        report.Target(
            what="rollouts lost or duplicated",
            wanted="0",
            measured=f"{abs(lost)} of {trial.rows}, in {trial.sweeps} sweeps",
            met=lost == 0,
        ),
        report.Target(
            what="datasets unlike the undisturbed one",
            wanted="0",
            measured=f"{trial.wrong} of {trial.sweeps}",
            met=trial.wrong == 0,
        ),
    ]
    return f"{MEASURED}\n{report.targets(rows)}"
