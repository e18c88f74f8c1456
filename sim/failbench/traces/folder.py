"""Traces of a sweep as a folder of Parquet files, with a card for readers and Hugging Face."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from failbench.rollouts.sampling import check_whole
from failbench.sweeps.card import CARD, write_own
from failbench.sweeps.dataset import MANIFEST, check_arrow, read_manifest
from failbench.sweeps.definition import Sweep
from failbench.sweeps.work import execution_of, jobs_of
from failbench.traces.trace import Sampling, trace
from graceful_plan.exceptions import READ_ERRORS, FormatError, SettingError, read_error_reason

if TYPE_CHECKING:
    import pyarrow as pa

TABLES: tuple[str, ...] = ("steps", "points", "images")
_BATCH = 20_000
"""Greatest number of rows in memory, plus those of one rollout."""

_TYPES = {
    "steps": {
        "rollout": "int64",
        "step": "int32",
        "time": "float64",
        "q": "list",
        "qd": "list",
        "command": "list",
        "qpos": "list",
        "qvel": "list",
        "potential": "float64",
        "kinetic": "float64",
    },
    "points": {
        "rollout": "int64",
        "step": "int32",
        "time": "float64",
        "first": "string",
        "second": "string",
        **dict.fromkeys(("x", "y", "z", "fx", "fy", "fz", "depth"), "float64"),
    },
    "images": {"rollout": "int64", "step": "int32", "time": "float64", "image": "image"},
}
"""Columns of each table."""

_IMAGE_FEATURES = """\
dataset_info:
- config_name: images
  features:
  - {name: rollout, dtype: int64}
  - {name: step, dtype: int32}
  - {name: time, dtype: float64}
  - {name: image, dtype: image}
"""
_MARK = "<!-- made by failbench trace -->"
_CARD = """\
---
license: cc0-1.0
task_categories: [robotics]
tags: [robot-failures, mujoco, failbench]
configs:
{configs}
{features}---
{mark}

# Failures of a robot, step by step

{rollouts} rollouts in which a simulated robot or its surroundings fail, made with FailBench {version} and
MuJoCo {mujoco}. No value is measured on a real robot: values of the faults are stated assumptions, and contents of
containers are not simulated.

- `steps`: {steps} rows, one for every {every} steps of {dt:g} s from the onset on. `q`, `qd`: planned joints
  [rad, rad/s]; `command`: all actuators; `qpos`, `qvel`: MuJoCo's whole state; `potential`, `kinetic`: energies of
  the whole model [J].
- `points`: {points} rows, one for each contact with a force in such a step: `x y z` [m], force `fx fy fz` on
  `second` in the world [N], `depth` [m]. `first` and `second` are `body` (the robot), `carried`, entities, or names of
  other bodies. Sleeping objects have no rows.
- `images`: {images} rows: PNG.

The table `rollouts` of the source dataset has the fault and the consequences of each rollout, by the same number
`rollout`.

Motions: {motions}. Faults: {faults}.

Not for: rating people's safety, or real robots' rates of failure.
"""


def write_traces(
    dataset: str | Path, output: str | Path, *, rollouts: Sequence[int] | None = None, sampling: Sampling | None = None
) -> dict[str, int]:
    """Simulate rollouts of a dataset again, and write their steps.

    Args:
        dataset: Folder of a dataset that `generate` completed.
        output: Folder for `steps/`, `points/` and `images/` with one Parquet file each, and for the card `README.md`,
            unless there is one from another source.
        rollouts: Numbers of the rollouts; all by default.
        sampling: Sampled steps and pictures.

    Returns:
        Number of rows in each table.

    Raises:
        FormatError: If there is no complete dataset, or the folder cannot be made.
        SettingError: If there is no such rollout.
        MissingExtra: If pyarrow is not installed.
        NoPicture: If pictures are requested and no OpenGL works.
    """
    check_arrow()
    kept = Sampling() if sampling is None else sampling
    manifest, output = read_manifest(Path(dataset)), Path(output)
    sweep = Sweep.from_document(manifest["sweep"], f"sweep of {MANIFEST}")
    numbers = chosen(sweep, rollouts)
    make_folder(output)
    counts: dict[str, int] = dict.fromkeys(TABLES, 0)
    writers = {table: _TableWriter(output / table, table) for table in TABLES if table != "images" or kept.images}
    for number in numbers:
        for rows in traced(sweep, number, kept):
            for table, writer in writers.items():
                writer.add([{"rollout": number, **row} for row in rows[table]])
                counts[table] += len(rows[table])
    for writer in writers.values():
        writer.close()
    write_own(output / CARD, _card(sweep, manifest, counts, len(numbers), kept), _MARK)
    return counts


def traced(sweep: Sweep, number: int, sampling: Sampling) -> Iterator[dict[str, list[dict[str, Any]]]]:
    """Yield the rows of the sampled steps of a sweep's rollout."""
    motion, fault, i = sweep.place(number)
    yield from trace(
        execution_of(sweep, motion), jobs_of(sweep, motion, fault)[i], horizon=sweep.horizon, sampling=sampling
    )


def chosen(sweep: Sweep, rollouts: Sequence[int] | None) -> list[int]:
    """Return the numbers of the chosen rollouts; all if None."""
    if rollouts is not None and not isinstance(rollouts, Sequence):
        raise SettingError("rollouts", rollouts, "numbers of rollouts")
    for number in rollouts or ():
        check_whole("rollouts", number, 0)
    numbers = (
        list(range(len(sweep.motions) * len(sweep.faults) * sweep.rollouts)) if rollouts is None else list(rollouts)
    )
    if not numbers or len(set(numbers)) < len(numbers):
        raise SettingError("rollouts", numbers, "at least one, each once")
    for number in numbers:
        sweep.place(number)
    return numbers


def make_folder(output: Path) -> None:
    """Create a folder for output, with its parents.

    Raises:
        FormatError: If that is not possible.
    """
    try:
        output.mkdir(parents=True, exist_ok=True)
    except READ_ERRORS as error:
        raise FormatError(str(output), read_error_reason(error).replace("read", "written", 1)) from None


def arrow_type(name: str) -> pa.DataType:
    """Return the type of a column."""
    import pyarrow as pa

    if name == "list":
        return pa.list_(pa.float64())
    if name == "image":
        return pa.struct([("bytes", pa.binary()), ("path", pa.string())])
    return pa.string() if name == "string" else pa.type_for_alias(name)


class _TableWriter:
    """Writes rows of a table in batches."""

    def __init__(self, folder: Path, table: str) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        folder.mkdir(parents=True, exist_ok=True)
        schema = pa.schema([(name, arrow_type(kind)) for name, kind in _TYPES[table].items()])
        self._file = pq.ParquetWriter(folder / "part-00000.parquet", schema, compression="zstd")
        self._schema, self._rows = schema, list[dict[str, Any]]()

    def add(self, rows: list[dict[str, Any]]) -> None:
        self._rows += rows
        if len(self._rows) >= _BATCH:
            self._flush()

    def close(self) -> None:
        self._flush()
        self._file.close()

    def _flush(self) -> None:
        import pyarrow as pa

        self._file.write_table(pa.Table.from_pylist(self._rows, schema=self._schema))
        self._rows = []


def _card(sweep: Sweep, manifest: dict[str, Any], counts: dict[str, int], rollouts: int, kept: Sampling) -> str:
    configs = [f"- config_name: {t}\n  data_files: {t}/*.parquet" for t in TABLES if t != "images" or kept.images]
    faults = [f"{fault.get('fault')} ({fault.get('degree', 'severe')})" for fault in sweep.faults]
    return _CARD.format(
        configs="\n".join(configs),
        mark=_MARK,
        features=_IMAGE_FEATURES if kept.images else "",
        rollouts=rollouts,
        version=manifest["versions"]["graceful_plan"],
        mujoco=manifest["versions"]["mujoco"],
        every=kept.every,
        dt=sweep.settings.timestep,
        motions=", ".join(motion.name for motion in sweep.motions),
        faults=", ".join(faults),
        **counts,
    )
