"""Kill the driver and workers of a sweep at random moments, and compare the dataset with an undisturbed run.

Every kill is a SIGKILL. A killed driver is followed by another one, half of the time by `failbench resume`. The workers
are local processes, or those of a Ray cluster on this machine whose nodes are killed, too. When the sweep is complete,
its dataset must be bitwise equal to the undisturbed one; then another sweep begins, until there were enough kills.
"""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

from failbench.fault.registry import faults, to_document
from failbench.sweeps.dataset import read_dataset
from failbench.sweeps.definition import PlanSettings, Sweep, SweepMotion
from failbench.sweeps.journal import SweepJournal
from failbench.sweeps.sweep import JOURNAL
from support.sweeps.ray_nodes import RayNodes

FAULTS = ("gripper_failure", "loose_joint", "noise", "power_loss")
"""One fault of each category."""


class Trial:
    """A sweep that runs once undisturbed, and then repeatedly with kills."""

    def __init__(
        self,
        folder: Path,
        *,
        rollouts: int,
        workers: int,
        seed: int,
        horizon: float = 0.5,
        nodes: RayNodes | None = None,
    ) -> None:
        self.folder, self.workers, self.random = folder, workers, random.Random(seed)
        self.nodes: RayNodes | None = None
        self.kills: Counter[str] = Counter()
        self.sweeps = self.wrong = self.rows = self.gave_up = 0
        motion = SweepMotion(name="lift", scene="tabletop", task="lift_to_goal", plan=PlanSettings(iterations=100))
        documents = tuple(to_document(faults()[name]()) for name in FAULTS)
        sweep = Sweep(motions=(motion,), faults=documents, rollouts=rollouts, horizon=horizon)
        self.total = rollouts * len(FAULTS)
        self.file = folder / "sweep.json"
        # Planned here, because planning is not under test.
        self.file.write_text(json.dumps(sweep.planned().to_document()))
        started = time.monotonic()
        assert self._start("peace").wait() == 0
        self.seconds = time.monotonic() - started
        self.expected = _content(folder / "peace")
        self.nodes = nodes
        self.victims = ("driver", "worker") if nodes is None else ("driver", "worker", "node")
        if nodes is not None:
            started = time.monotonic()
            assert self._start("ray_in_peace").wait() == 0
            self.seconds = time.monotonic() - started
            assert _content(folder / "ray_in_peace") == self.expected, "Ray makes other bytes than local processes"

    def run(self, kills: int) -> None:
        """Kill a number of processes, over as many sweeps as needed."""
        while self.kills.total() < kills:
            self._sweep(kills)
            self.sweeps += 1
            rollouts = read_dataset(self.folder / "fire").rollouts["rollout"].to_pylist()
            self.rows += len(rollouts)
            if rollouts != list(range(self.total)) or _content(self.folder / "fire") != self.expected:
                self.wrong += 1
            shutil.rmtree(self.folder / "fire")

    def report(self) -> str:
        """Return the result as a table."""
        return "\n".join(
            [
                "| " + " | ".join(f"kills of {who}s" for who in self.victims) + " | drivers that gave a chunk up |"
                " sweeps | rollouts | datasets unlike the undisturbed one |",
                "|---:" * len(self.victims) + "|---:|---:|---:|---:|",
                "| " + " | ".join(str(self.kills[who]) for who in self.victims) + f" | {self.gave_up} | {self.sweeps} |"
                f" {self.rows} | {self.wrong} |",
            ]
        )

    def _sweep(self, kills: int) -> None:
        """Complete one sweep despite kills."""
        while True:
            driver = self._start("fire")
            while driver.poll() is None:
                if self.kills.total() < kills:
                    self._kill_someone(driver)
                else:
                    driver.wait()
            if driver.returncode == 0:
                return
            # A chunk whose worker was killed three times counts as failed, and the driver reports it; resuming tries it
            # again.
            assert driver.returncode in (-signal.SIGKILL, 1), f"the driver failed: {driver.returncode}"
            self.gave_up += driver.returncode == 1

    def _kill_someone(self, driver: subprocess.Popen[bytes]) -> None:
        """Kill the driver, a worker or a node at a random moment, unless the driver ends first."""
        who = self.random.choice(self.victims)
        until = time.monotonic() + self.random.uniform(0.0, 0.6 * self.seconds)
        victims: list[int] = []
        while not victims or time.monotonic() < until:
            if driver.poll() is not None:
                return
            time.sleep(0.002)
            victims = [driver.pid] if who == "driver" else self._working(driver)
        if who == "node" and self.nodes is not None:
            self.nodes.kill_node(self.random)
        else:
            try:
                os.kill(self.random.choice(victims), signal.SIGKILL)
            except ProcessLookupError:
                return
        self.kills[who] += 1
        if who == "driver":
            driver.wait()

    def _working(self, driver: subprocess.Popen[bytes]) -> list[int]:
        return _workers(driver.pid) if self.nodes is None else self.nodes.busy()

    def _start(self, name: str) -> subprocess.Popen[bytes]:
        resumes = self.random.random() < 0.5 and _begun(self.folder / name / JOURNAL)
        what = ["resume", name] if resumes else ["generate", name, "--sweep", str(self.file)]
        how = ["--workers", str(self.workers)]
        if self.nodes is not None:
            how = ["--executor", "ray", "--address", self.nodes.address]
        command = [sys.executable, "-m", "failbench.cli", *what, *how]
        return subprocess.Popen(command, cwd=self.folder, stdout=subprocess.DEVNULL)


def _begun(journal: Path) -> bool:
    if not journal.exists():
        return False
    with SweepJournal(journal) as opened:
        return opened.begun


def _content(folder: Path) -> dict[str, bytes]:
    files = (file for part in ("rollouts", "contacts") for file in (folder / part).iterdir())
    return {str(file.relative_to(folder)): file.read_bytes() for file in [*files, folder / "manifest.json"]}


def _workers(driver: int) -> list[int]:
    """Return the processes that work on chunks for a driver."""
    found = []
    children = Path(f"/proc/{driver}/task/{driver}/children")
    for child in children.read_text().split() if children.exists() else ():
        try:
            command = Path(f"/proc/{child}/cmdline").read_bytes()
        except OSError:
            continue
        if b"spawn_main" in command:
            found.append(int(child))
    return found
