import re
import sqlite3
import subprocess
import sys
import zlib

import fake_work
import pytest
from hypothesis import given
from hypothesis import strategies as st

from failbench.basics.chunks import ChunkOutcome
from failbench.basics.errors import SweepBusy
from failbench.sweeps import journal as journal_module
from failbench.sweeps.journal import SweepJournal
from graceful_plan.exceptions import FormatError

ABOUT = {"sweep": {"scene": "tabletop"}, "versions": {"mujoco": "4.0.0"}}
CHUNKS = fake_work.chunks(4)


@pytest.fixture
def file(tmp_path):
    return tmp_path / "journal.sqlite"


@pytest.fixture
def begun(file):
    with SweepJournal(file) as journal:
        journal.begin(ABOUT)
    return file


def done(index):
    return ChunkOutcome(chunk=CHUNKS[index], rows=fake_work.rows(CHUNKS[index]))


def test_records_survive_reopening(file):
    with SweepJournal(file) as journal:
        assert not journal.begun
        journal.begin(ABOUT)
        journal.record(done(2))
        journal.record(ChunkOutcome(chunk=CHUNKS[1], error="it broke"))
    with SweepJournal(file) as journal:
        assert journal.begun
        assert journal.about == ABOUT
        assert journal.done() == {2}
        assert journal.errors() == {1: "it broke"}
        assert journal.rows(CHUNKS[2]) == fake_work.rows(CHUNKS[2])


json_values = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**63) | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(st.characters(exclude_categories=["Cs"])),
    lambda inner: st.lists(inner, max_size=3),
)  # fmt: skip


@given(st.lists(st.dictionaries(st.text("abc"), json_values, max_size=3), max_size=3))
def test_rows_come_back_exactly(tmp_path_factory, rows):
    with SweepJournal(tmp_path_factory.mktemp("journal") / "j") as journal:
        journal.begin({})
        journal.record(ChunkOutcome(chunk=CHUNKS[0], rows={"rollouts": rows}))
        assert journal.rows(CHUNKS[0]) == {"rollouts": rows}


def test_a_chunk_is_done_once_but_a_failed_one_can_be_done_again(begun):
    with SweepJournal(begun) as journal:
        journal.record(ChunkOutcome(chunk=CHUNKS[0], error="first"))
        journal.record(ChunkOutcome(chunk=CHUNKS[0], error="second"))
        assert journal.errors() == {0: "second"}
        journal.record(done(0))
        assert (journal.errors(), journal.done()) == ({}, {0})
        for again in (done(0), ChunkOutcome(chunk=CHUNKS[0], error="late")):
            with pytest.raises(ValueError, match="motion / fault 0 / 0-2"):
                journal.record(again)
        assert journal.rows(CHUNKS[0]) == fake_work.rows(CHUNKS[0])


def test_missing_rows(begun):
    with SweepJournal(begun) as journal:
        journal.record(ChunkOutcome(chunk=CHUNKS[1], error="it broke"))
        for chunk in CHUNKS[:2]:
            with pytest.raises(KeyError, match=chunk.name):
                journal.rows(chunk)


def test_nan_is_refused_and_leaves_no_trace(begun):
    with SweepJournal(begun) as journal:
        with pytest.raises(ValueError, match="JSON compliant"):
            journal.record(ChunkOutcome(chunk=CHUNKS[0], rows={"rollouts": [{"impact": float("nan")}]}))
        assert journal.done() == set()


def test_only_one_process_at_a_time(begun):
    code = f"from pathlib import Path; from failbench.sweeps import journal; journal.SweepJournal(Path({str(begun)!r}))"
    with SweepJournal(begun):
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
        assert "SweepBusy" in done.stderr
        with pytest.raises(SweepBusy, match=r"journal\.sqlite"):
            SweepJournal(begun)
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_other_files_are_refused(file, tmp_path):
    file.write_bytes(b"PAR1" * 1000)
    with pytest.raises(FormatError, match=r"journal\.sqlite: damaged"):
        SweepJournal(file)
    other = tmp_path / "other.sqlite"
    with sqlite3.connect(other) as database:
        database.execute("CREATE TABLE recipes (name TEXT)")
    database.close()
    with pytest.raises(FormatError, match=r"other\.sqlite: .*journal"):
        SweepJournal(other)
    with pytest.raises(FormatError, match="Is a directory"):
        SweepJournal(tmp_path)


def test_another_version_is_refused(begun):
    with sqlite3.connect(begun) as database:
        database.execute("UPDATE about SET value = '2' WHERE key = 'version'")
    database.close()
    with pytest.raises(FormatError, match=r"version 2.*version 1"):
        SweepJournal(begun)


@pytest.mark.parametrize("keep", [0.2, 0.6])
def test_a_truncated_file_is_refused(begun, keep):
    with SweepJournal(begun) as journal:
        for index in range(4):
            journal.record(done(index))
    whole = begun.read_bytes()
    begun.write_bytes(whole[: int(keep * len(whole))])
    with pytest.raises(FormatError, match=r"journal\.sqlite: "):
        SweepJournal(begun)


def test_flipped_bits_in_rows_are_noticed(begun):
    with SweepJournal(begun) as journal:
        journal.record(done(0))
    with sqlite3.connect(begun) as database:
        ((stored,),) = database.execute("SELECT rows FROM chunks").fetchall()
    database.close()
    whole = begun.read_bytes()
    assert whole.count(stored) == 1
    for place in range(0, len(stored), 7):
        flipped = bytearray(stored)
        flipped[place] ^= 0x10
        begun.write_bytes(whole.replace(stored, bytes(flipped)))
        with SweepJournal(begun) as journal:
            try:
                rows = journal.rows(CHUNKS[0])
            except FormatError as error:
                assert "journal.sqlite: damaged" in str(error)
            else:  # a bit of zlib's header that does not affect the content
                assert rows == fake_work.rows(CHUNKS[0])
                assert place == 0


def test_flipped_bits_anywhere_are_noticed_or_do_not_matter(begun):
    with SweepJournal(begun) as journal:
        for index in range(4):
            journal.record(done(index))
    whole = begun.read_bytes()
    told = 0
    for place in [*range(0, len(whole), 97), *(m.start() for m in re.finditer(b"tabletop|mujoco|4.0.0", whole))]:
        flipped = bytearray(whole)
        flipped[place] ^= 0x81 if place % 2 else 0x01  # invalid UTF-8, and valid UTF-8
        begun.write_bytes(flipped)
        try:
            with SweepJournal(begun) as journal:
                assert journal.about == ABOUT
                for index in journal.done():
                    assert journal.rows(CHUNKS[index]) == fake_work.rows(CHUNKS[index])
        except FormatError as error:
            told += "journal.sqlite" in str(error)
    assert told > 3


def test_kill_between_begin_and_commit_leaves_a_journal_that_was_not_begun(file):
    code = f"""
import os, signal
from pathlib import Path
from failbench.sweeps import journal
journal.json.dumps = lambda value: os.kill(os.getpid(), signal.SIGKILL)  # the tables are there, nothing is in them
with journal.SweepJournal(Path({str(file)!r})) as opened:
    opened.begin({{}})
"""
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == -9
    with SweepJournal(file) as journal:
        assert not journal.begun
        journal.begin(ABOUT)


def _put(file, packed):
    with sqlite3.connect(file) as database:
        database.execute("INSERT INTO chunks VALUES (0, 'a', ?, '')", (packed,))
    database.close()


def test_a_bomb_is_refused_before_it_is_unpacked(begun, monkeypatch):
    _put(begun, zlib.compress(b"[" + b" " * 1_000_000 + b"]", 9))
    with SweepJournal(begun) as journal:
        assert journal.rows(CHUNKS[0]) == []
        monkeypatch.setattr(journal_module, "_MOST_BYTES", 999_999)
        with pytest.raises(FormatError, match=r"journal\.sqlite: the rows of .* larger than 999999 bytes"):
            journal.rows(CHUNKS[0])
        monkeypatch.setattr(journal_module, "_MOST_BYTES", 100)
        with pytest.raises(FormatError, match=r"are larger than 100 bytes"):
            journal.rows(CHUNKS[0])


@pytest.mark.parametrize("text", [b"[" * 100_000, b"\xff", b"[1,", b""])
def test_rows_that_are_no_json_are_refused(begun, text):
    _put(begun, zlib.compress(text))
    with SweepJournal(begun) as journal, pytest.raises(FormatError, match=r"journal\.sqlite: "):
        journal.rows(CHUNKS[0])


@pytest.mark.parametrize(
    "change",
    [
        "CREATE TRIGGER more AFTER INSERT ON chunks BEGIN DELETE FROM about; END",
        "CREATE VIEW more AS SELECT * FROM about",
        "CREATE TABLE more (a)",
        "DROP TABLE chunks",
        "DROP TABLE about; CREATE TABLE about (key, value); INSERT INTO about VALUES ('schema', 1)",
    ],
)
def test_a_database_with_other_tables_or_triggers_is_refused(begun, change):
    with sqlite3.connect(begun) as database:
        database.executescript(change)
    database.close()
    with pytest.raises(FormatError, match="not a journal of a sweep"):
        SweepJournal(begun)


def test_a_deeply_nested_description_is_refused(begun):
    with sqlite3.connect(begun) as database:
        database.execute("UPDATE about SET value = ? WHERE key = 'about'", ("[" * 100_000,))
    database.close()
    with pytest.raises(FormatError, match=r"journal\.sqlite: not JSON"):
        SweepJournal(begun)


def test_a_journal_in_a_folder_that_cannot_be_written_is_read(file, monkeypatch):
    with SweepJournal(file) as journal:
        journal.begin(ABOUT)
        journal.record(done(1))
    before = sorted(file.parent.iterdir())
    monkeypatch.setattr(journal_module.os, "access", lambda *_: False)
    with SweepJournal(file) as journal:
        assert journal.read_only and journal.about == ABOUT and journal.done() == {1}
        assert journal.rows(CHUNKS[1]) == fake_work.rows(CHUNKS[1])
    assert sorted(file.parent.iterdir()) == before
    file.with_name("journal.sqlite-wal").write_bytes(b"1")
    with pytest.raises(FormatError, match=r"journal\.sqlite-wal"):
        SweepJournal(file)
