import hashlib
import importlib.util
import json
import re

import fake_work
import pytest
from places import ROOT

from failbench.basics import tables
from failbench.basics.errors import MissingExtra
from failbench.basics.tables import TABLES, VERSION
from failbench.sweeps import dataset
from failbench.sweeps.dataset import MANIFEST, read_dataset, write_dataset
from graceful_plan.exceptions import FormatError

ABOUT = {"sweep": {"schema": "failbench.sweep", "seed": 7}, "versions": {"graceful_plan": "0.1.0", "mujoco": "4.0.0"}}
COUNT = 10


def chunks(size=3, count=COUNT):
    return (fake_work.full_rows(i, min(i + size, count)) for i in range(0, count, size))


@pytest.fixture
def folder(tmp_path):
    write_dataset(tmp_path / "data", chunks(), ABOUT)
    return tmp_path / "data"


def files(folder):
    return {str(file.relative_to(folder)): file.read_bytes() for file in sorted(folder.rglob("*")) if file.is_file()}


def test_rows_come_back_exactly_and_in_order(folder):
    read = read_dataset(folder)
    assert read.rollouts.to_pylist() == [fake_work.rollout_row(i) for i in range(COUNT)]
    assert read.contacts.to_pylist() == [fake_work.contact_row(i) for i in range(COUNT)]
    assert read.manifest["rows"] == {"rollouts": COUNT, "contacts": COUNT}
    assert read.manifest["sweep"] == ABOUT["sweep"]


def test_pandas_polars_and_duckdb_read_it_in_one_line(folder):
    import duckdb
    import pandas
    import polars

    expected = sum(0.1 * i for i in range(COUNT))
    assert pandas.read_parquet(folder / "rollouts")["observed_impact"].sum() == pytest.approx(expected)
    assert polars.read_parquet(folder / "rollouts/*.parquet")["observed_impact"].sum() == pytest.approx(expected)
    found = duckdb.sql(
        f"SELECT sum(observed_impact), count(*) FROM '{folder}/rollouts/*.parquet' "
        f"JOIN '{folder}/contacts/*.parquet' USING (rollout) WHERE list_contains(left_support, 'vase')"
    ).fetchall()
    assert found == [(pytest.approx(expected), COUNT)]
    poses = polars.read_parquet(folder / "rollouts/*.parquet")["poses"]
    assert poses[2][0] == {"name": "vase", "wxyz_xyz": [1.0, 0.0, 0.0, 0.0, 0.2, 0.2, 0.3]}
    assert list(pandas.read_parquet(folder / "contacts")) == [column.name for column in TABLES["contacts"]]


def test_bytes_depend_on_the_rows_alone(folder, tmp_path):
    write_dataset(tmp_path / "again", chunks(size=4), ABOUT)
    assert files(folder) == files(tmp_path / "again")
    write_dataset(tmp_path / "other", chunks(count=COUNT - 1), ABOUT)
    other = json.loads((tmp_path / "other" / MANIFEST).read_text())["content"]
    mine = json.loads((folder / MANIFEST).read_text())["content"]
    assert all(other[table] != mine[table] for table in TABLES)


def test_many_rows_make_many_parts(tmp_path, monkeypatch):
    monkeypatch.setattr(dataset, "PART_ROWS", 4)
    write_dataset(tmp_path, chunks(), ABOUT)
    assert [file.name for file in sorted((tmp_path / "rollouts").iterdir())] == [
        f"part-0000{i}.parquet" for i in range(3)
    ]
    assert read_dataset(tmp_path).rollouts["rollout"].to_pylist() == list(range(COUNT))


def test_a_table_without_rows_can_be_read(tmp_path):
    import pandas

    write_dataset(tmp_path, [{"rollouts": [fake_work.rollout_row(0)], "contacts": []}], ABOUT)
    assert read_dataset(tmp_path).contacts.num_rows == 0
    assert len(pandas.read_parquet(tmp_path / "contacts")) == 0


def test_every_file_describes_itself(folder):
    import pyarrow.parquet as pq

    for table, columns in TABLES.items():
        schema = pq.read_schema(folder / table / "part-00000.parquet")
        assert schema.metadata[b"failbench.schema"] == f"failbench.{table}".encode()
        assert json.loads(schema.metadata[b"failbench.sweep"]) == ABOUT["sweep"]
        assert json.loads(schema.metadata[b"failbench.versions"]).keys() == {*ABOUT["versions"], "pyarrow"}
        for column in columns:
            about = schema.field(column.name).metadata
            assert (about[b"unit"].decode(), about[b"meaning"].decode()) == (column.unit, column.meaning)


PARTS = ("rollouts/part-00000.parquet", "contacts/part-00000.parquet")


@pytest.mark.parametrize("part", PARTS)
def test_a_part_with_any_byte_changed_is_refused(folder, part):
    file = folder / part
    whole = file.read_bytes()
    for place in [0, 4, len(whole) // 2, len(whole) - 9, len(whole) - 1]:
        file.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        with pytest.raises(FormatError, match=rf"{part}: .*checksum"):
            read_dataset(folder)
    file.write_bytes(whole)
    assert read_dataset(folder).rollouts.num_rows == COUNT


@pytest.mark.parametrize("part", PARTS)
def test_a_truncated_or_missing_part_is_refused(folder, part):
    file = folder / part
    file.write_bytes(file.read_bytes()[:-1])
    with pytest.raises(FormatError, match=rf"{part}: .*\d+ bytes"):
        read_dataset(folder)
    file.unlink()
    with pytest.raises(FormatError, match=rf"{part}: missing"):
        read_dataset(folder)


@pytest.mark.parametrize("name", ["part-00001.parquet", ".unfinished-part-00000.parquet", "notes.txt"])
def test_an_extra_file_is_refused(folder, name):
    (folder / "contacts" / name).write_bytes((folder / PARTS[1]).read_bytes())
    with pytest.raises(FormatError, match=rf"contacts/{name}: .*manifest\.json"):
        read_dataset(folder)


def test_a_dataset_without_manifest_is_unfinished(folder):
    (folder / MANIFEST).unlink()
    with pytest.raises(FormatError, match=r"manifest\.json: missing"):
        read_dataset(folder)


def test_a_manifest_that_was_touched_is_refused(folder):
    file = folder / MANIFEST
    whole = file.read_text()
    for change, message in (
        (whole.replace('"seed": 7', '"seed": 8'), "its checksum does not match"),
        (whole[:-20], "not JSON: "),
        ("[]", "not a manifest of a dataset"),
        (whole.replace("failbench.dataset", "failbench.cake"), "not a manifest of a dataset"),
        (whole.replace(f'"version": {VERSION}', '"version": 99'), f"version 99; this version reads 1 to {VERSION}"),
    ):
        assert change != whole
        file.write_text(change)
        with pytest.raises(FormatError, match=rf"manifest\.json: .*{message}"):
            read_dataset(folder)


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        (("rows",), 7, "no numbers of rows of each table"),
        (("rows", "contacts"), -1, "no numbers of rows of each table"),
        (("rows", "rollouts"), True, "no numbers of rows of each table"),
        (("versions",), {"graceful_plan": "0.1.0"}, "no versions of graceful_plan and mujoco"),
        (("sweep",), None, "no sweep"),
        (("parts",), {}, r"parts\[0\] does not say file"),
        (("parts", 1), [], r"parts\[1\] does not say file"),
        (("parts", 1, "file"), 0, r"parts\[1\] does not say file"),
        (("parts", 1, "sha256"), None, r"parts\[1\] does not say file"),
        (("parts", 1, "bytes"), 1.5, r"parts\[1\] does not say file"),
        (("parts", 0, "file"), "rollouts/../../secret.parquet", "is not a valid part name"),
        (("parts", 0, "file"), "/rollouts/part-00000.parquet", "is not a valid part name"),
    ],
)
def test_a_manifest_whose_checksum_fits_may_be_none_all_the_same(folder, place, value, message):
    manifest = json.loads((folder / MANIFEST).read_text())
    inner = manifest
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = value
    manifest["sha256"] = dataset._self_checksum(manifest)
    (folder / MANIFEST).write_text(json.dumps(manifest))
    with pytest.raises(FormatError, match=rf"manifest\.json: .*{message}"):
        read_dataset(folder)


def test_a_part_with_other_columns_is_refused_even_if_its_checksum_fits(folder):
    manifest = json.loads((folder / MANIFEST).read_text())
    content = (folder / PARTS[0]).read_bytes()
    (folder / PARTS[1]).write_bytes(content)
    manifest["parts"][1] |= {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}
    manifest["sha256"] = dataset._self_checksum(manifest)
    (folder / MANIFEST).write_text(json.dumps(manifest))
    with pytest.raises(FormatError, match="contacts"):
        read_dataset(folder)


def test_datasets_of_earlier_versions_are_read(tmp_path, monkeypatch):
    """A column that was added later is null in older datasets."""
    whole = tables.TABLES["rollouts"]
    first = tuple(column for column in whole if column.name not in tables.ADDED)
    with monkeypatch.context() as before:
        before.setitem(tables.TABLES, "rollouts", first)
        before.setattr(dataset, "VERSION", 1)
        write_dataset(tmp_path, ({**part, "rollouts": _without_added(part["rollouts"])} for part in chunks()), ABOUT)
    assert json.loads((tmp_path / MANIFEST).read_text())["version"] == 1
    read = read_dataset(tmp_path)
    assert read.rollouts.schema.names == [column.name for column in whole]
    assert read.rollouts["own_loss"].null_count == COUNT
    expected = [row["observed_impact"] for part in chunks() for row in part["rollouts"]]
    assert read.rollouts["observed_impact"].to_pylist() == expected


def _without_added(rows):
    return [{name: value for name, value in row.items() if name not in tables.ADDED} for row in rows]


def test_writing_again_replaces_everything(folder, monkeypatch):
    before = files(folder)
    monkeypatch.setattr(dataset, "PART_ROWS", 4)
    write_dataset(folder, chunks(), ABOUT)
    (folder / "rollouts" / ".unfinished-part-00009.parquet").write_text("left behind by a crash")
    monkeypatch.undo()
    write_dataset(folder, chunks(), ABOUT)
    assert files(folder) == before


def test_files_of_others_are_neither_removed_nor_mixed_with(folder):
    (folder / "rollouts" / "precious.csv").write_text("a,b")
    with pytest.raises(FormatError, match=r"precious\.csv"):
        write_dataset(folder, chunks(), ABOUT)
    assert (folder / MANIFEST).exists()


@pytest.mark.parametrize("writes", [0, 1, 2])
def test_files_before_a_crash_are_no_dataset(folder, monkeypatch, writes):
    real, count = dataset._write, iter(range(9))

    def crash(file, content):
        if next(count) == writes:
            file.with_name(dataset._TEMPORARY + file.name).write_bytes(content[: len(content) // 2])
            raise KeyboardInterrupt
        real(file, content)

    before = files(folder)
    monkeypatch.setattr(dataset, "_write", crash)
    with pytest.raises(KeyboardInterrupt):
        write_dataset(folder, chunks(), ABOUT)
    with pytest.raises(FormatError, match="an unfinished one"):
        read_dataset(folder)
    monkeypatch.undo()
    write_dataset(folder, chunks(), ABOUT)
    left = {name for name in files(folder) if dataset._TEMPORARY in name}
    assert {name: content for name, content in files(folder).items() if name not in left} == before
    assert read_dataset(folder).rollouts.num_rows == COUNT


def test_without_pyarrow_the_extra_is_named(folder, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(MissingExtra, match=r"pyarrow.*'\.\[data\]'"):
        read_dataset(folder)


def test_the_document_lists_the_columns():
    text = (ROOT / "docs" / "datasets.md").read_text()
    for table, columns in TABLES.items():
        section = re.split(r"^## ", text, flags=re.MULTILINE)
        (own,) = [part for part in section if part.startswith(f"`{table}`")]
        rows = re.findall(r"^\| `(\w+)` \| ([^|]*) \| ([^|]*) \| ([^|]*) \|$", own, flags=re.MULTILINE)
        assert [tuple(cell.strip() for cell in row) for row in rows] == [tuple(column) for column in columns]


@pytest.mark.parametrize("name", ["a\0b", "\ud800"])
def test_a_folder_that_cannot_exist_is_refused(name):
    with pytest.raises(FormatError):
        read_dataset(name)
