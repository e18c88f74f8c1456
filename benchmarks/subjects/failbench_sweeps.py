"""What a sweep of a million rollouts takes: CPU time of workers and of the driver, on local processes and on Ray."""

from __future__ import annotations

import importlib.util
import multiprocessing
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from benchmarks import report, suite
from benchmarks.ray_nodes import RayNodes, process_seconds
from failbench.basics.chunks import ChunkOutcome, Rows
from failbench.fault.registry import faults, to_document
from failbench.sweeps.dataset import write_dataset
from failbench.sweeps.executors import Executor, LocalExecutor
from failbench.sweeps.journal import SweepJournal
from failbench.sweeps.sweep import SweepProgress, generate_dataset, versions
from failbench.sweeps.work import PlanSettings, Sweep, SweepMotion
from graceful_plan.compare.runs.machine import resident_megabytes

TITLE = "FailBench: what a million rollouts cost"
MEASURED = """\
A sweep of all 19 faults on two motions (`tabletop/lift_to_goal`, the whole arm and 15 free boxes, and
`desk/bring_coffee`, with coffee that spills), one second after each onset, two workers: local processes, and a Ray
cluster of two nodes on this machine, over its network interface. CPU seconds are those of the processes between the
first and the last chunk that comes back, so that starting and planning do not count: "workers" is everything but the
driver, on Ray with its schedulers. "Writing" is what the driver does for the same rows without workers, over and over
until there are many: into the journal, and from there into a dataset. Whole core-hours a million are what one pays for;
workers a driver can feed are how many cores one driver keeps busy. A million were not simulated here: figures are
scaled from the rollouts in the table, since a sweep of a million is nothing but more chunks of the same size; the
writing is scaled likewise.
"""
PRICE = 0.04
"""USD for an hour of a core, as clouds asked for one on demand when this was written; an assumption."""
_MILLION = 1e6
TASKS = (("tabletop", "lift_to_goal"), ("desk", "bring_coffee"))


@dataclass(frozen=True)
class _Mark:
    """Where a sweep is at some moment."""

    rollouts: int
    wall: float
    driver: float
    workers: float


def run(options: suite.Options) -> str:
    """Measure everything."""
    each = options.pick(32, quick=2)
    sweep = Sweep(
        motions=tuple(
            SweepMotion(name=f"{scene}/{task}", scene=scene, task=task, plan=PlanSettings(iterations=200))
            for scene, task in TASKS
        ),
        faults=tuple(to_document(fault()) for fault in faults().values()),
        rollouts=each,
    ).planned()
    with tempfile.TemporaryDirectory() as folder:
        here = Path(folder)
        found = {"local processes": _watched(sweep, here / "local", LocalExecutor(workers=2), _local_seconds)}
        if importlib.util.find_spec("ray"):
            found["Ray, two nodes"] = _on_ray(sweep, here / "ray")
        with SweepJournal(here / "local" / "journal.sqlite") as journal:
            rows = [journal.rows(chunk) for chunk in sweep.chunks]
        writing = _writing(here / "written", sweep, rows, options.pick(40_000, quick=2_000))
    return f"{MEASURED}\n{_table(found)}\n{writing}\n" + "\n".join(_costs(found)) + "\n"


def _on_ray(sweep: Sweep, folder: Path) -> tuple[_Mark, _Mark]:
    from failbench.sweeps.ray_executor import RayExecutor

    with RayNodes(2) as nodes:
        return _watched(sweep, folder, RayExecutor(address=nodes.address), nodes.seconds)


def _watched(sweep: Sweep, folder: Path, executor: Executor, seconds: Callable[[], float]) -> tuple[_Mark, _Mark]:
    """Do a sweep and return where it was after its first chunks and after its last."""
    marks: list[_Mark] = []

    def look(progress: SweepProgress) -> None:
        marks.append(_Mark(progress.rollouts_done, time.monotonic(), time.process_time(), seconds()))

    generate_dataset(sweep, folder, executor=executor, callback=look)
    return marks[min(3, len(marks) - 2)], marks[-1]  # each worker has loaded its first scene by then


def _local_seconds() -> float:
    return sum(process_seconds(child.pid) for child in multiprocessing.active_children() if child.pid)


def _writing(folder: Path, sweep: Sweep, rows: list[Rows], count: int) -> str:
    """Write many rows as the driver does, and say what that takes."""
    folder.mkdir()
    size = sum(len(chunk["rollouts"]) for chunk in rows)
    times = max(1, count // size)
    started, before = time.process_time(), resident_megabytes()
    with SweepJournal(folder / "journal.sqlite") as journal:
        journal.begin({"sweep": sweep.to_document(), "versions": versions()})
        chunks = [replace(chunk, index=k * len(rows) + chunk.index) for k in range(times) for chunk in sweep.chunks]
        for chunk in chunks:
            journal.record(ChunkOutcome(chunk=chunk, rows=rows[chunk.index % len(rows)]))
        kept = time.process_time()
        again = (journal.rows(chunk) for chunk in chunks)
        manifest = write_dataset(folder, again, {"sweep": sweep.to_document(), "versions": versions()})
    done, written = time.process_time(), manifest["rows"]["rollouts"]
    sizes = (folder / "journal.sqlite").stat().st_size, sum(part["bytes"] for part in manifest["parts"])
    scale = _MILLION / written
    row = (
        written,
        f"{(kept - started) * scale / 3600.0:.2f}",
        f"{(done - kept) * scale / 3600.0:.2f}",
        *(f"{size * scale / 1e9:.2f} GB" for size in sizes),
        f"{resident_megabytes() - before:.0f} MB",
    )
    head = ("rows written", "journal, core-hours a million", "dataset, core-hours a million", "journal of a million")
    return report.table((*head, "dataset of a million", "memory that came on top"), [row])


def _table(found: dict[str, tuple[_Mark, _Mark]]) -> str:
    rows = []
    for name, (first, last) in found.items():
        count = last.rollouts - first.rollouts
        workers, driver = (last.workers - first.workers) / count, (last.driver - first.driver) / count
        rows.append(
            (
                name,
                count,
                f"{1e3 * workers:.1f} ms",
                f"{1e3 * driver:.2f} ms",
                f"{1.0 / workers:.1f}",
                f"{workers / driver:.0f}",
                f"{count / (last.wall - first.wall):.1f}",
            )
        )
    head = ("where", "rollouts", "CPU of workers, a rollout", "CPU of the driver, a rollout")
    rates = ("rollouts/s of a worker's core", "workers a driver can feed", "rollouts/s by the clock, two workers")
    return report.table((*head, *rates), rows)


def _costs(found: dict[str, tuple[_Mark, _Mark]]) -> Iterator[str]:
    for name, (first, last) in found.items():
        spent = (last.workers - first.workers) + (last.driver - first.driver)
        hours = spent / (last.rollouts - first.rollouts) * _MILLION / 3600.0
        yield f"- A million on {name}: {hours:.1f} core-hours, {PRICE * hours:.2f} USD at {PRICE:g} USD a core-hour."
