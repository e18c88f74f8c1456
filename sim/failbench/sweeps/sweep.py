"""Sweeps: execute chunks, record their outcomes in a journal, and write the dataset when all are done.

A sweep has a folder with `journal.sqlite` from the beginning, and the dataset once it is complete. It may be killed at
any time; `resume` continues it, with the same result as without the interruption.
"""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from failbench.basics.chunks import Chunk, Rows
from failbench.basics.errors import ExecutionRefused, SweepFailed
from failbench.basics.tables import check_rows
from failbench.basics.versions import versions
from failbench.fault.registry import to_document
from failbench.scenario import scenarios
from failbench.simulated.world import SimSettings
from failbench.sweeps.card import write_card
from failbench.sweeps.dataset import check_arrow, read_dataset, write_dataset
from failbench.sweeps.definition import PlanSettings, Sweep, SweepMotion, fault_of, own_file
from failbench.sweeps.executors import Executor, LocalExecutor
from failbench.sweeps.journal import SweepJournal
from failbench.sweeps.work import execution_of, run_chunk
from graceful_plan.exceptions import FormatError, SettingError
from graceful_plan.regular_file import path_of

JOURNAL = "journal.sqlite"


class SweepProgress(NamedTuple):
    """Progress of a sweep."""

    chunks: int
    chunks_done: int
    rollouts: int
    rollouts_done: int
    failed: int
    """Number of failed chunks."""


@dataclass(frozen=True, kw_only=True)
class Generated:
    """A complete sweep.

    Args:
        folder: Folder of the sweep.
        manifest: Manifest of its dataset.
        healthy: Motions that do harm without a failure, by name: the harm, and the lost fraction of the contents.
    """

    folder: Path
    manifest: dict[str, Any]
    healthy: Mapping[str, tuple[float, float]]


Callback = Callable[[SweepProgress], None]


def generate_dataset(
    sweep: Sweep, folder: str | Path, *, executor: Executor | None = None, callback: Callback | None = None
) -> Generated:
    """Run a sweep and write its dataset. If the folder holds the same sweep, unfinished or complete, continue it.

    Args:
        sweep: The sweep; motions without a trajectory are planned first.
        folder: Folder of journal and dataset. An empty journal there causes a warning, and the sweep starts again.
        executor: Executor of the chunks; by default processes on this machine, one per core.
        callback: Called after each chunk.

    Raises:
        FormatError: If the folder holds another sweep, or a damaged one.
        SweepBusy: If another process is working on the sweep.
        ExecutionRefused: If the healthy robot cannot execute a motion.
        SweepFailed: If chunks failed; the others are done, and `resume` retries the failed ones.
        MissingExtra: If pyarrow is not installed.
    """
    check_arrow()  # before hours of work, not after
    folder = path_of(folder)
    folder.mkdir(parents=True, exist_ok=True)
    # Plan before creating the journal, so that an existing journal is empty only after a kill within milliseconds.
    is_there = (folder / JOURNAL).exists()
    about = None if is_there else _prepared(sweep)
    with SweepJournal(folder / JOURNAL) as journal:
        if not journal.begun:
            if is_there:
                warnings.warn(f"{journal.file} is empty: the sweep starts from the beginning", stacklevel=2)
            journal.begin(about or _prepared(sweep))
        _check_same(journal, sweep)
        return _finish(journal, folder, executor, callback)


def resume(folder: str | Path, *, executor: Executor | None = None, callback: Callback | None = None) -> Generated:
    """Continue the sweep in a folder. See `generate`.

    Raises:
        FormatError: If the folder holds no sweep, or one begun with other versions, files or settings.
    """
    check_arrow()
    with _begun(path_of(folder)) as journal:
        return _finish(journal, Path(folder), executor, callback)


@contextmanager
def _begun(folder: Path) -> Generator[SweepJournal]:
    """Open the journal of an existing sweep."""
    if not (folder / JOURNAL).exists():
        raise FormatError(str(folder), f"no sweep was begun here: there is no {JOURNAL}")
    with SweepJournal(folder / JOURNAL) as journal:
        if not journal.begun:
            raise FormatError(str(journal.file), "no sweep was begun in it; `generate` begins one")
        yield journal


def read_sweep(folder: str | Path) -> Sweep:
    """Return the sweep in a folder.

    Raises:
        FormatError: If there is none, or its journal is damaged.
        SweepBusy: If another process is working on the sweep.
    """
    with _begun(path_of(folder)) as journal:
        return Sweep.from_document(journal.about["sweep"], str(journal.file))


def sweep_of(
    patterns: Sequence[str],
    rollouts: int,
    *,
    plans: Sequence[PlanSettings] = (PlanSettings(),),
    horizon: float = 1.0,
    seed: int = 0,
    settings: SimSettings | None = None,
) -> Sweep:
    """Return a sweep over registered scenarios: each fault on planned motions of each task.

    Args:
        patterns: Patterns of scenarios, such as "drop/*"; all tasks must have the same faults.
        rollouts: Number of rollouts of each fault on each motion.
        plans: Planning settings; each task gets one motion for each of them.
        horizon: Simulated time after the onset [s].
        seed: Seed of all random numbers except the planner's.
        settings: Settings of the simulation.

    Raises:
        UnknownNameError: If a pattern matches nothing.
        SettingError: If the tasks have different faults.
    """
    found = {scenario.name: scenario for pattern in patterns for scenario in scenarios(pattern)}
    tasks = dict.fromkeys((scenario.scene, scenario.task) for scenario in found.values())
    faults = dict.fromkeys(scenario.fault for scenario in found.values())
    if len(found) != len(tasks) * len(faults):
        raise SettingError(
            "scenarios", " ".join(patterns), "the same faults on every task; run others as separate sweeps"
        )
    motions = tuple(
        SweepMotion(
            name=f"{scene}/{task}" + f"/{i}" * (len(plans) > 1),
            scene=scene,
            task=task,
            plan=plan,
        )
        for scene, task in tasks
        for i, plan in enumerate(plans)
    )
    return Sweep(
        motions=motions,
        faults=tuple(to_document(fault) for fault in faults),
        rollouts=rollouts,
        horizon=horizon,
        seed=seed,
        settings=SimSettings() if settings is None else settings,
    )


def _prepared(sweep: Sweep) -> dict[str, Any]:
    """Plan missing motions, and return the sweep's description with everything that determines its results."""
    planned = sweep.planned()
    return {"sweep": planned.to_document(), "versions": versions(), "inputs": _inputs(planned)}


def _finish(journal: SweepJournal, folder: Path, executor: Executor | None, callback: Callback | None) -> Generated:
    """Run the remaining chunks of a sweep, and write the dataset."""
    about = journal.about
    sweep = Sweep.from_document(about["sweep"], str(journal.file))
    done = journal.done()
    todo = [chunk for chunk in sweep.chunks if chunk.index not in done]
    if todo and journal.read_only:
        raise FormatError(str(folder), f"cannot be written, and {len(todo)} of {len(sweep.chunks)} chunks are not done")
    if todo:
        _check_circumstances(journal, sweep)
        _do(sweep, todo, journal, executor or LocalExecutor(), callback)
    errors = journal.errors()
    if errors:
        raise SweepFailed(folder, list(errors.values()), len(sweep.chunks))
    if journal.read_only:
        return _finished(journal, folder, sweep)
    rows = (_rows(journal, sweep, chunk) for chunk in sweep.chunks)
    manifest = write_dataset(folder, rows, {"sweep": about["sweep"], "versions": about["versions"]})
    write_card(folder, sweep, manifest)
    return Generated(folder=folder, manifest=manifest, healthy=_healthy(journal, sweep))


def _finished(journal: SweepJournal, folder: Path, sweep: Sweep) -> Generated:
    """Return the complete sweep of a folder that cannot be written.

    Raises:
        FormatError: If its dataset is missing or damaged, or of another sweep.
    """
    manifest = dict(read_dataset(folder).manifest)
    if manifest["sweep"] != journal.about["sweep"]:
        raise FormatError(str(folder), "cannot be written, and its dataset is of another sweep than its journal")
    return Generated(folder=folder, manifest=manifest, healthy=_healthy(journal, sweep))


def _rows(journal: SweepJournal, sweep: Sweep, chunk: Chunk) -> Rows:
    """Return the checked rows of a finished chunk."""
    rows = journal.rows(chunk)
    check_rows(rows, sweep.first_rollout(chunk), chunk.last - chunk.first, str(journal.file))
    return rows


def _healthy(journal: SweepJournal, sweep: Sweep) -> dict[str, tuple[float, float]]:
    """Return harm and lost fraction of each motion that does harm without a failure, from its first row."""
    found = {}
    for chunk in sweep.chunks:
        name = sweep.motions[chunk.motion].name
        if name not in found:
            row = _rows(journal, sweep, chunk)["rollouts"][0]
            found[name] = row.get("healthy_harm") or 0.0, row.get("healthy_spilled") or 0.0
    return {name: both for name, both in found.items() if any(both)}


def _do(
    sweep: Sweep, todo: Sequence[Chunk], journal: SweepJournal, executor: Executor, callback: Callback | None
) -> None:
    chunks, failed = len(sweep.chunks) - len(todo), 0
    total = len(sweep.motions) * len(sweep.faults) * sweep.rollouts
    rollouts = total - sum(chunk.last - chunk.first for chunk in todo)
    for outcome in executor.map(partial(run_chunk, sweep), todo):
        journal.record(outcome)
        if outcome.rows is None:
            failed += 1
        else:
            chunks += 1
            rollouts += outcome.chunk.last - outcome.chunk.first
        if callback is not None:
            callback(SweepProgress(len(sweep.chunks), chunks, total, rollouts, failed))


def _check_same(journal: SweepJournal, sweep: Sweep) -> None:
    """Raise FormatError if the journal holds another sweep."""
    theirs, ours = Sweep.from_document(journal.about["sweep"], str(journal.file)).question, sweep.question
    different = ", ".join(sorted(key for key in ours if ours[key] != theirs[key]))
    if different:
        raise FormatError(str(journal.file), f"it holds another sweep, with other {different}; use another folder")


def _check_circumstances(journal: SweepJournal, sweep: Sweep) -> None:
    """Raise FormatError if versions or inputs have changed since the sweep began."""
    about = journal.about
    for key, found in (("versions", versions()), ("inputs", _inputs(sweep))):
        changed = ", ".join(sorted(name for name in found if about[key].get(name) != found[name]))
        if changed:
            raise FormatError(str(journal.file), f"begun with other {key} ({changed}); start again in another folder")


def _inputs(sweep: Sweep) -> dict[str, str]:
    """Return checksums of the inputs: the model of each motion, and the files with user-defined faults.

    Raises:
        ExecutionRefused: If the healthy robot cannot execute a motion.
        GracefulPlanError: If a fault is not valid for this robot.
    """
    found = {}
    for i, motion in enumerate(sweep.motions):
        try:
            model = execution_of(sweep, i).world.model
        except ExecutionRefused as error:
            raise ExecutionRefused(f"{motion.name}: {error.what}", error.time, error.problem) from None
        buffer = np.empty(mujoco.mj_sizeModel(model), dtype=np.uint8)
        mujoco.mj_saveModel(model, None, buffer)
        found[f"motion {motion.name}"] = hashlib.sha256(buffer.tobytes()).hexdigest()
    for fault in sweep.faults:
        struck = fault_of(fault)
        execution_of(sweep, 0).world.robot.check_targets(struck.targets, struck.rates)
        if file := own_file(fault):
            found[file] = hashlib.sha256(Path(file).read_bytes()).hexdigest()
    return found
