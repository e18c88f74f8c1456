"""Small files that claim a huge content are refused before memory is allocated."""

from __future__ import annotations

import hashlib
import zipfile
from pathlib import Path

import numpy as np
import pytest

import graceful_plan as gp
from failbench.calibrations.failures import read_failures
from failbench.policies.mlp import Mlp
from failbench.sweeps import dataset
from graceful_plan.exceptions import FormatError
from graceful_plan.formats import parquet_file
from graceful_plan.formats.npz_file import read_arrays


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
    monkeypatch.setattr(parquet_file, "MOST_NUMBERS", 19_999)
    with pytest.raises(FormatError, match=r"5000.*4"):
        gp.Trajectory.from_parquet(content)


def test_part_files_must_have_the_row_count_of_the_manifest(tmp_path: Path) -> None:
    pa = pytest.importorskip("pyarrow")
    pq = pytest.importorskip("pyarrow.parquet")
    file = tmp_path / "rollouts" / "part-00000.parquet"
    file.parent.mkdir()
    pq.write_table(pa.table({"a": np.zeros(200_000)}), file)
    content = file.read_bytes()
    part = {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}
    for rows in (1, 200_000):
        with pytest.raises(FormatError, match="rows"):
            dataset._read_part(file, part | {"rows": rows}, dataset.VERSION)
