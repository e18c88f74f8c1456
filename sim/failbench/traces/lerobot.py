"""Rollouts of a sweep as a LeRobot dataset of version 3.0: an episode per rollout, a frame per sampled step.

The state is joint positions and velocities, the action all actuators' commands. Episodes also have the fault and the
observed impact. There are no videos; `failbench.traces.folder` writes pictures.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from failbench.rollouts.sampling import check_whole
from failbench.sweeps.dataset import check_arrow, read_dataset
from failbench.sweeps.definition import Sweep
from failbench.sweeps.work import execution_of
from failbench.traces.folder import chosen, make_folder, traced
from failbench.traces.trace import Sampling
from graceful_plan.array_types import Array
from graceful_plan.exceptions import SettingError

if TYPE_CHECKING:
    import pyarrow as pa


_FILE = "chunk-000/file-000.parquet"
_COUNTS = {
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}
"""Scalar columns of frames, in addition to state and action."""


def write_lerobot(
    dataset: str | Path, output: str | Path, *, rollouts: Sequence[int] | None = None, every: int = 10
) -> int:
    """Simulate rollouts of a dataset again and write them as a LeRobot dataset of version 3.0.

    Args:
        dataset: Folder of a dataset that `generate` completed.
        output: Folder for `meta/` and `data/`; it must not exist yet.
        rollouts: Numbers of the rollouts; all by default. Their robots must have equal numbers of joints and actuators.
        every: Simulation steps per frame; the frame rate is 1 / (every dt).

    Returns:
        The number of frames.

    Raises:
        SettingError: If there is no such rollout, the frame rate is not a whole number, robots differ, or the folder
            exists.
        FormatError: If there is no complete dataset, or the folder cannot be made.
        MissingExtra: If pyarrow is not installed.
    """
    check_arrow()
    whole, output = read_dataset(dataset), Path(output)
    sweep = whole.sweep
    fps = _frames_a_second(sweep, every)
    if os.path.lexists(output):
        raise SettingError("output", str(output), "a folder that does not exist yet")
    numbers = chosen(sweep, rollouts)
    make_folder(output)
    told = whole.rollouts.select(["fault", "degree", "motion", "observed_impact"]).to_pylist()
    tasks = list(dict.fromkeys(_task(told[number]) for number in numbers))
    episodes, frames = [], []
    for episode, number in enumerate(numbers):
        rows = [rows["steps"][0] for rows in traced(sweep, number, Sampling(every=every))]
        frames.append(
            _frames(rows, episode, tasks.index(_task(told[number])), sum(len(f["index"]) for f in frames), fps)
        )
        episodes.append(_episode(frames[-1], episode, told[number]))
    shapes = {tuple(frame[name].shape[1] for name in ("observation.state", "action")) for frame in frames}
    if len(shapes) != 1:
        raise SettingError("rollouts", numbers, "rollouts of robots with equal numbers of joints and actuators")
    data = {name: np.concatenate([frame[name] for frame in frames]) for name in frames[0]}
    _write_parquet(output / "data" / _FILE, {name: _column(values) for name, values in data.items()})
    _write_parquet(output / "meta" / "episodes" / _FILE, _columns(episodes))
    _write_tasks(output / "meta" / "tasks.parquet", tasks)
    _write_json(output / "meta" / "stats.json", {name: _statistics(values) for name, values in data.items()})
    _write_json(output / "meta" / "info.json", _info(sweep, data, len(episodes), len(tasks), fps))
    return len(data["index"])


def _frames_a_second(sweep: Sweep, every: int) -> int:
    check_whole("every", every, 1)
    fps = 1.0 / (every * sweep.settings.timestep)
    if abs(fps - round(fps)) > 1e-6 or fps < 1.0:
        raise SettingError("every", every, f"steps of {sweep.settings.timestep:g} s of which a whole number makes 1 s")
    return round(fps)


def _task(row: Mapping[str, Any]) -> str:
    return f"{row['motion']}, and then: {row['fault']} ({row['degree']})"


def _frames(rows: list[dict[str, Any]], episode: int, task: int, first: int, fps: int) -> dict[str, Array]:
    count = np.arange(len(rows))
    return {
        "observation.state": np.array([row["q"] + row["qd"] for row in rows], dtype=np.float32),
        "action": np.array([row["command"] for row in rows], dtype=np.float32),
        "timestamp": (count / fps).astype(np.float32),
        "frame_index": count,
        "episode_index": np.full(len(rows), episode),
        "index": first + count,
        "task_index": np.full(len(rows), task),
    }


def _episode(frames: Mapping[str, Array], episode: int, row: Mapping[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = {
        "episode_index": episode,
        "tasks": [_task(row)],
        "length": len(frames["index"]),
        "dataset_from_index": int(frames["index"][0]),
        "dataset_to_index": int(frames["index"][-1]) + 1,
        **{f"{part}/{index}_index": 0 for part in ("data", "meta/episodes") for index in ("chunk", "file")},
        "observed_impact": row["observed_impact"],
        "fault": row["fault"],
        "degree": row["degree"],
    }
    for name, values in frames.items():
        found |= {f"stats/{name}/{key}": value for key, value in _statistics(values).items()}
    return found


def _statistics(values: Array) -> dict[str, list[float]]:
    flat = values.reshape(len(values), -1).astype(float)
    found = {"min": flat.min(axis=0), "max": flat.max(axis=0), "mean": flat.mean(axis=0), "std": flat.std(axis=0)}
    return {**{name: value.tolist() for name, value in found.items()}, "count": [len(values)]}


def _info(sweep: Sweep, data: Mapping[str, Array], episodes: int, tasks: int, fps: int) -> dict[str, Any]:
    world = execution_of(sweep, 0).world
    joints = [name.rpartition("/")[2] for name in world.robot.joints]
    names = {
        "observation.state": joints + [f"{joint}_velocity" for joint in joints],
        "action": [world.model.actuator(i).name or f"actuator{i}" for i in range(world.model.nu)],
    }
    vectors = {name: {"dtype": "float32", "shape": [len(words)], "names": words} for name, words in names.items()}
    counts = {name: {"dtype": kind, "shape": [1], "names": None} for name, kind in _COUNTS.items()}
    return {
        "codebase_version": "v3.0",
        "robot_type": world.scene.notes.robot.strip("/"),
        "total_episodes": episodes,
        "total_frames": len(data["index"]),
        "total_tasks": tasks,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": fps,
        "splits": {"train": f"0:{episodes}"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
        "features": {**vectors, **counts},
    }


def _column(values: Array) -> pa.Array:
    import pyarrow as pa

    if values.ndim == 1:
        return pa.array(values)
    return pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])


def _columns(rows: list[dict[str, Any]]) -> dict[str, pa.Array]:
    import pyarrow as pa

    return {name: pa.array([row[name] for row in rows]) for name in rows[0]}


def _write_tasks(file: Path, tasks: list[str]) -> None:
    """Write the tasks like a pandas frame indexed by them, as LeRobot reads it."""
    import pyarrow as pa

    kinds = (("task_index", "int64"), ("task", "unicode"))
    columns = [
        {
            "name": name,
            "field_name": name,
            "pandas_type": kind,
            "numpy_type": "object" if kind == "unicode" else kind,
            "metadata": None,
        }
        for name, kind in kinds
    ]
    about = {"index_columns": ["task"], "column_indexes": [], "columns": columns, "creator": {"library": "pyarrow"}}
    _write_parquet(
        file, {"task_index": pa.array(range(len(tasks))), "task": pa.array(tasks)}, {"pandas": json.dumps(about)}
    )


def _write_parquet(file: Path, columns: Mapping[str, pa.Array], about: Mapping[str, str] | None = None) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    file.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(pa.table(dict(columns)).replace_schema_metadata(about), file)


def _write_json(file: Path, document: Any) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
