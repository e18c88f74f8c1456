"""Rows of a journal become a dataset only if they are those of its rollouts."""

import json
import sqlite3
import zlib

import fake_work
import numpy as np
import pytest

from failbench.basics.chunks import ChunkOutcome
from failbench.basics.tables import check_rows
from failbench.fault.registry import faults, to_document
from failbench.sweeps import journal
from failbench.sweeps import sweep as sweeping
from failbench.sweeps.dataset import MANIFEST
from failbench.sweeps.definition import Sweep, SweepMotion
from failbench.sweeps.sweep import JOURNAL, generate_dataset, resume
from graceful_plan import Trajectory
from graceful_plan.exceptions import FormatError


def rows():
    return json.loads(json.dumps(fake_work.full_rows(6, 9)))


def test_rows_of_these_rollouts_are_accepted():
    check_rows(rows(), 6, 3, "a")
    old = rows()
    for row in old["rollouts"]:
        del row["healthy_harm"]  # which the first version did not have
    check_rows(old, 6, 3, "a")


def _set(table, k, name, value):
    def change(found):
        found[table][k][name] = value

    return change


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda found: found.clear(), "lists by table"),
        (lambda found: found.update(more=[]), "lists by table"),
        (lambda found: found.update(contacts={}), "lists by table"),
        (lambda found: found.update(rollouts=[{}]), "row 0 of rollouts.*no "),
        (lambda found: found["rollouts"].append(3), "row 3 of rollouts.*not a mapping"),
        (lambda found: found["rollouts"].pop(), "2 rows for the 3 rollouts from 6"),
        (lambda found: found["rollouts"].reverse(), "for the 3 rollouts from 6"),
        (_set("rollouts", 0, "rollout", 5), "for the 3 rollouts from 6"),
        (_set("contacts", 0, "rollout", 5), "contacts of other rollouts"),
        (_set("rollouts", 1, "seed", 2**63), "seed is not of the type int64"),
        (_set("rollouts", 1, "seed", True), "seed is not of the type int64"),
        (_set("rollouts", 1, "seed", None), "seed is not of the type int64"),
        (_set("rollouts", 1, "onset", "1"), "onset is not of the type double"),
        (_set("rollouts", 1, "onset", float("nan")), "onset is not of the type double"),
        (_set("rollouts", 1, "onset", 10**400), "onset is not of the type double"),
        (_set("rollouts", 1, "dropped", 1), "dropped is not of the type bool"),
        (_set("rollouts", 1, "fault", None), "fault is not of the type string"),
        (_set("rollouts", 1, "fell", "vase"), "fell is not of the type list<string>"),
        (_set("rollouts", 1, "fell", [3]), "fell is not of the type list<string>"),
        (_set("rollouts", 1, "state", [None]), "state is not of the type list<double>"),
        (_set("rollouts", 1, "poses", [{"name": "a"}]), "poses is not of the type poses"),
        (_set("rollouts", 1, "more", 1), "unknown column 'more'"),
        (_set("contacts", 1, "striker", 1), "striker is not of the type string"),
    ],
)
def test_others_are_refused(change, said):
    found = rows()
    change(found)
    with pytest.raises(FormatError, match=f"journal: damaged: .*{said}"):
        check_rows(found, 6, 3, "journal")


class _Faked:
    """Rows of the right form, without a simulation."""

    def map(self, work, chunks):
        for chunk in chunks:
            yield ChunkOutcome(chunk=chunk, rows=fake_work.full_rows(chunk.first, chunk.last))


@pytest.fixture
def finished(monkeypatch, tmp_path):
    """A folder with a finished sweep."""
    monkeypatch.setattr(sweeping, "_inputs", lambda sweep: {})
    motion = Trajectory(np.arange(2.0), *np.zeros((3, 2, 1)), ("a",))
    sweep = Sweep(
        motions=(SweepMotion(name="lift", scene="tabletop", task="lift_to_goal", trajectory=motion),),
        faults=(to_document(faults()["noise"]()),),
        rollouts=6,
    )
    generate_dataset(sweep, tmp_path, executor=_Faked())
    return tmp_path


def test_a_journal_with_one_empty_row_gives_no_dataset(finished):
    packed = zlib.compress(json.dumps({"rollouts": [{}], "contacts": []}).encode())
    with sqlite3.connect(finished / JOURNAL) as database:
        database.execute("UPDATE chunks SET rows = ?", (packed,))
    database.close()
    with pytest.raises(FormatError, match=r"journal\.sqlite: damaged"):
        resume(finished)


def test_a_finished_dataset_in_a_folder_that_cannot_be_written_is_returned(finished, monkeypatch):
    made = resume(finished)
    monkeypatch.setattr(journal.os, "access", lambda *_: False)
    monkeypatch.setattr(sweeping, "write_dataset", None)
    again = resume(finished)
    assert (again.folder, again.manifest, again.healthy) == (made.folder, made.manifest, made.healthy)
    (finished / MANIFEST).unlink()
    with pytest.raises(FormatError, match=r"manifest\.json: missing"):
        resume(finished)


def test_an_unfinished_one_there_is_refused(finished, monkeypatch):
    with sqlite3.connect(finished / JOURNAL) as database:
        database.execute("DELETE FROM chunks")
    database.close()
    monkeypatch.setattr(journal.os, "access", lambda *_: False)
    with pytest.raises(FormatError, match="cannot be written, and 1 of 1 chunks are not done"):
        resume(finished)
