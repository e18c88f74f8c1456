"""Small files that claim a huge content are refused before memory is allocated."""

from __future__ import annotations

import hashlib
import zipfile
from pathlib import Path

import numpy as np
import pytest

import graceful_plan as gp
from failbench.basics.tables import arrow_schema
from failbench.calibrations.failures import read_failures
from failbench.policies.mlp import Mlp
from failbench.sweeps import dataset
from graceful_plan import untrusted_json
from graceful_plan.exceptions import FormatError
from graceful_plan.formats import csv_text, parquet_file
from graceful_plan.formats.npz_file import read_arrays
from graceful_plan.mobile.floor.files import moving_ai


def _head(shape: tuple[int, ...], kind: str = "<f8", version: bytes = b"\x01\x00") -> bytes:
    text = f"{{'descr': {kind!r}, 'fortran_order': False, 'shape': {shape!r}, }}".encode().ljust(117) + b"\n"
    return b"\x93NUMPY" + version + len(text).to_bytes(2, "little") + text


def _archive(file: Path, content: bytes) -> Path:
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("w0.npy", content)
    return file


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (_head((2**27,)), "bytes for float64"),  # claims a gigabyte that is missing
        (_head((-1,)), "bytes for float64"),
        (_head((10**40,)), "bytes for float64"),
        (_head((1,), "|O") + bytes(8), "no .npz file of arrays"),
        (_head((1,), version=b"\x07\x00") + bytes(8), "no .npz file of arrays"),
        (b"\x93NUMPY\x01\x00\x76\x00" + b"(" * 118, "no .npz file of arrays"),
        (_head((1 << 20, 3)) + bytes(24 << 20), "holds 25165824 bytes"),  # compresses to almost nothing
        (b"", "no .npz file of arrays"),
    ],
    ids=["absent", "negative", "huge", "objects", "version", "brackets", "zeros", "empty"],
)
def test_arrays_are_added_up_by_their_headers(content: bytes, said: str, tmp_path: Path) -> None:
    file = _archive(tmp_path / "net.npz", content)
    assert file.stat().st_size < 100_000
    with pytest.raises(FormatError, match=said):
        read_arrays(file, most_bytes=1 << 20)
    for read in (Mlp.load, read_failures):
        with pytest.raises(FormatError):
            read(file)


def test_arrays_come_back(tmp_path: Path) -> None:
    arrays = {"a": np.arange(6.0).reshape(2, 3), "text": np.array("é"), "none": np.zeros((0, 3))}
    for write in (np.savez, np.savez_compressed):
        write(tmp_path / "all.npz", **arrays)
        found = read_arrays(tmp_path / "all.npz")
        assert found.keys() == arrays.keys()
        for name, values in arrays.items():
            np.testing.assert_array_equal(found[name], values)
    with pytest.raises(FormatError, match="cannot be read"):
        read_arrays(tmp_path / "absent.npz")


def test_a_table_of_equal_rows_is_refused_by_their_number(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pyarrow")
    q = np.zeros((5000, 1))
    motion = gp.Trajectory(np.arange(5000.0), q, q, q, ("a",))
    content = tmp_path / "m.parquet"
    motion.to_parquet(content)
    assert len(gp.Trajectory.from_parquet(content)) == 5000
    monkeypatch.setattr(parquet_file, "MOST_VALUES", 19_999)
    with pytest.raises(FormatError, match=r"5000.*4"):
        gp.Trajectory.from_parquet(content)


@pytest.mark.parametrize("column", ["motion", "fell", "poses"])
def test_a_long_text_in_many_rows_is_refused_before_it_is_written_out(column: str, tmp_path: Path, monkeypatch) -> None:
    pa = pytest.importorskip("pyarrow")
    pq = pytest.importorskip("pyarrow.parquet")
    text, schema, rows = "x" * 100_000, arrow_schema("rollouts"), 50
    value = {"motion": text, "fell": [text], "poses": [{"name": text, "wxyz_xyz": [0.0]}]}[column]
    columns = [pa.array([value if f.name == column else None] * rows, f.type) for f in schema]
    pq.write_table(pa.table(columns, schema=schema), tmp_path / "t.parquet", compression="zstd")
    content = (tmp_path / "t.parquet").read_bytes()
    assert len(content) < 100_000
    assert parquet_file.read_bounded(content, "t.parquet", lambda _: None).num_rows == rows
    monkeypatch.setattr(parquet_file, "MOST_BYTES", rows * len(text) - 1)
    with pytest.raises(FormatError, match=r"t\.parquet: its texts"):
        parquet_file.read_bounded(content, "t.parquet", lambda _: None)


def test_parquet_with_other_columns_is_refused_before_its_values_are_read(tmp_path: Path, monkeypatch) -> None:
    pa = pytest.importorskip("pyarrow")
    pq = pytest.importorskip("pyarrow.parquet")
    pq.write_table(pa.table({"t": ["x" * 1000] * 1000}), tmp_path / "t.parquet")
    monkeypatch.setattr(pq, "read_table", None)
    with pytest.raises(FormatError, match=r"t\.parquet"):
        gp.Trajectory.from_parquet(tmp_path / "t.parquet")


def test_part_files_must_have_the_row_count_of_the_manifest(tmp_path: Path) -> None:
    pa = pytest.importorskip("pyarrow")
    pq = pytest.importorskip("pyarrow.parquet")
    file = tmp_path / "rollouts" / "part-00000.parquet"
    file.parent.mkdir()
    schema = arrow_schema("rollouts")
    for table, said in (
        (pa.table([pa.nulls(3, field.type) for field in schema], schema=schema), "3 rows, 1 were written"),
        (pa.table({"a": np.zeros(3)}), "wrong columns for rollouts"),
    ):
        pq.write_table(table, file)
        content = file.read_bytes()
        part = {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest(), "rows": 1}
        with pytest.raises(FormatError, match=said):
            dataset._read_part(file, part, dataset.VERSION)


def test_json_of_very_many_or_deep_values_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    assert untrusted_json.parse_json("[[], {}]", "a") == [[], {}]
    assert untrusted_json.parse_json(b"[1, 2]", "a") == [1, 2]
    for text in ("[" * 100_000, "[1,", "[" + "9" * 5000 + "]"):
        with pytest.raises(FormatError, match="a: not JSON"):
            untrusted_json.parse_json(text, "a")
    deep = untrusted_json.MOST_DEPTH
    assert untrusted_json.parse_json("[" * deep + "]" * deep, "a")
    for text in ("[" * (deep + 1) + "]" * (deep + 1), '{"a":' * (deep + 1) + "1" + "}" * (deep + 1)):
        with pytest.raises(FormatError, match=f"a: nested deeper than {deep} levels"):
            untrusted_json.parse_json(text, "a")
    monkeypatch.setattr(untrusted_json, "MOST_VALUES", 100)
    for text in ("[" + "[]," * 100 + "[]]", b"[" + b"1," * 100 + b"1]"):
        with pytest.raises(FormatError, match="more than 100 values"):
            untrusted_json.parse_json(text, "a")


def test_csv_of_too_many_cells_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    text = gp.Trajectory(np.arange(3.0), *np.zeros((3, 3, 1)), ("a",)).to_csv()
    assert len(gp.Trajectory.from_csv(text)) == 3
    monkeypatch.setattr(csv_text, "MOST_CELLS", 15)
    with pytest.raises(FormatError, match="more than 15 numbers"):
        gp.Trajectory.from_csv(text)


def test_a_file_of_too_many_scenarios_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    line = "0\tmap\t8\t8\t0\t0\t1\t1\t1.5\n"
    (tmp_path / "a.scen").write_text("version 1\n" + 3 * line)
    assert len(moving_ai.read_scenarios(tmp_path / "a.scen")) == 3
    monkeypatch.setattr(moving_ai, "_MOST_SCENARIOS", 2)
    with pytest.raises(FormatError, match=r"a\.scen.*more than 2 scenarios"):
        moving_ai.read_scenarios(tmp_path / "a.scen")
