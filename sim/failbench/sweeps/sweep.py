"""Sweeps: hand the chunks to an executor, write down what comes back, and make a dataset of it when all is there.

A sweep lives in a folder: `journal.sqlite` from its beginning on, the dataset once it is complete. It may be killed at
any moment; `resume` goes on, and what comes out is the same as if nothing had happened.
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

from failbench.basics.chunks import Chunk
from failbench.basics.errors import ExecutionRefused, SweepFailed
from failbench.basics.versions import versions
from failbench.fault.registry import to_document
from failbench.scenario import scenarios
from failbench.simulated.world import SimSettings
from failbench.sweeps.card import write_card
from failbench.sweeps.dataset import check_arrow, write_dataset
from failbench.sweeps.executors import Executor, LocalExecutor
from failbench.sweeps.journal import SweepJournal
from failbench.sweeps.work import PlanSettings, Sweep, SweepMotion, execution_of, fault_of, own_file, run_chunk
from graceful_plan.exceptions import FormatError, SettingError
from graceful_plan.regular_file import path_of

JOURNAL = "journal.sqlite"


class SweepProgress(NamedTuple):
    """How far a sweep has come."""

    chunks: int
    chunks_done: int
    rollouts: int
    rollouts_done: int
    failed: int
    """Chunks that failed."""


@dataclass(frozen=True, kw_only=True)
class Generated:
    """A sweep that is complete.

    Args:
        folder: Where it is.
        manifest: Of its dataset.
        healthy: Motions that do harm without any failure, by name: the harm, and the part of the contents that they
            lose.
    """

    folder: Path
    manifest: dict[str, Any]
    healthy: Mapping[str, tuple[float, float]]


Callback = Callable[[SweepProgress], None]


def generate(
    sweep: Sweep, folder: str | Path, *, executor: Executor | None = None, callback: Callback | None = None
) -> Generated:
    """Do a sweep and write its dataset. If the folder holds the same sweep, begun or complete, go on with that.

    Args:
        sweep: What to do; motions without a trajectory are planned first.
        folder: Where journal and dataset go. An empty journal there is warned of, and begun anew.
        executor: Who does it; by default processes on this machine, one for each core.
        callback: Called after each chunk.

    Raises:
        FormatError: If the folder holds another sweep, or a damaged one.
        SweepBusy: If another process is working on it.
        ExecutionRefused: If the healthy robot cannot carry a motion out.
        SweepFailed: If chunks failed; the others are done, and `resume` tries these again.
        MissingExtra: If pyarrow is not installed.
    """
    check_arrow()  # before hours of work, not after
    folder = path_of(folder)
    folder.mkdir(parents=True, exist_ok=True)
    # Planned before there is a journal, so that one that is there was begun but for a kill within milliseconds.
    is_there = (folder / JOURNAL).exists()
    about = None if is_there else _prepared(sweep)
    with SweepJournal(folder / JOURNAL) as journal:
        if not journal.begun:
            if is_there:
                warnings.warn(f"{journal.file} is empty: the sweep begins anew", stacklevel=2)
            journal.begin(about or _prepared(sweep))
        _check_same(journal, sweep)
        return _finish(journal, folder, executor, callback)


def resume(folder: str | Path, *, executor: Executor | None = None, callback: Callback | None = None) -> Generated:
    """Go on with the sweep in a folder. See `generate`.

    Raises:
        FormatError: If no sweep was begun there, or it was begun with other versions, files or settings.
    """
    check_arrow()
    with _begun(path_of(folder)) as journal:
        return _finish(journal, Path(folder), executor, callback)


@contextmanager
def _begun(folder: Path) -> Generator[SweepJournal]:
    """Open the journal of a sweep that was begun."""
    if not (folder / JOURNAL).exists():
        raise FormatError(str(folder), f"no sweep was begun here: there is no {JOURNAL}")
    with SweepJournal(folder / JOURNAL) as journal:
        if not journal.begun:
            raise FormatError(str(journal.file), "no sweep was begun in it; `generate` begins one")
        yield journal


def read_sweep(folder: str | Path) -> Sweep:
    """Return the sweep that was begun in a folder.

    Raises:
        FormatError: If none was, or its journal is damaged.
        SweepBusy: If another process is working on it.
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
    """Return a sweep over scenarios of the registry: each fault on a planned motion of each task.

    Args:
        patterns: Patterns of scenarios, such as "drop/*"; together they have to be every fault on every task.
        rollouts: How often each fault strikes on each motion.
        plans: How the motions are planned; each task has one motion for each of these.
        horizon: How long is simulated after the onset [s].
        seed: Of everything random but the planner.
        settings: How the scenes are simulated.

    Raises:
        UnknownNameError: If a pattern matches nothing.
        SettingError: If some task has a fault that another one does not have.
    """
    found = {scenario.name: scenario for pattern in patterns for scenario in scenarios(pattern)}
    tasks = dict.fromkeys((scenario.scene, scenario.task) for scenario in found.values())
    faults = dict.fromkeys(scenario.fault for scenario in found.values())
    if len(found) != len(tasks) * len(faults):
        raise SettingError("scenarios", " ".join(patterns), "the same faults on every task; do the others separately")
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
    """Plan what is still to be planned, and return what the sweep is about, with all that decides about results."""
    planned = sweep.planned()
    return {"sweep": planned.to_document(), "versions": versions(), "inputs": _inputs(planned)}


def _finish(journal: SweepJournal, folder: Path, executor: Executor | None, callback: Callback | None) -> Generated:
    """Do what is left of a sweep that was begun, and write the dataset."""
    about = journal.about
    sweep = Sweep.from_document(about["sweep"], str(journal.file))
    done = journal.done()
    todo = [chunk for chunk in sweep.chunks if chunk.index not in done]
    if todo:
        _check_circumstances(journal, sweep)
        _do(sweep, todo, journal, executor or LocalExecutor(), callback)
    errors = journal.errors()
    if errors:
        raise SweepFailed(folder, list(errors.values()), len(sweep.chunks))
    rows = (journal.rows(chunk) for chunk in sweep.chunks)
    manifest = write_dataset(folder, rows, {"sweep": about["sweep"], "versions": about["versions"]})
    write_card(folder, sweep, manifest)
    return Generated(folder=folder, manifest=manifest, healthy=_healthy(journal, sweep))


def _healthy(journal: SweepJournal, sweep: Sweep) -> dict[str, tuple[float, float]]:
    """Return harm and spilled part of each motion that does harm without any failure, as one of its rows says."""
    found = {}
    for chunk in sweep.chunks:
        name = sweep.motions[chunk.motion].name
        if name not in found:
            row = journal.rows(chunk)["rollouts"][0]
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
    """Raise FormatError if the journal's sweep asks something else."""
    theirs, ours = Sweep.from_document(journal.about["sweep"], str(journal.file)).question, sweep.question
    different = ", ".join(sorted(key for key in ours if ours[key] != theirs[key]))
    if different:
        raise FormatError(str(journal.file), f"it is of another sweep, with other {different}; use another folder")


def _check_circumstances(journal: SweepJournal, sweep: Sweep) -> None:
    """Raise FormatError if chunks that are still to be done would be done differently from those that are."""
    about = journal.about
    for key, found in (("versions", versions()), ("inputs", _inputs(sweep))):
        changed = ", ".join(sorted(name for name in found if about[key].get(name) != found[name]))
        if changed:
            raise FormatError(str(journal.file), f"begun with other {key} ({changed}); begin again in another folder")


def _inputs(sweep: Sweep) -> dict[str, str]:
    """Return checksums of what is simulated: the model of each motion, and the files with faults of one's own.

    Raises:
        ExecutionRefused: If the healthy robot cannot carry a motion out.
        GracefulPlanError: If a fault makes no sense for this robot.
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
