"""Line files of long benchmarks: one line per job, nothing after the time limit, and quick runs store nothing."""

import math
import sys
from dataclasses import dataclass

from places import ROOT

sys.path.insert(0, str(ROOT))

from benchmarks import store, suite


@dataclass(frozen=True)
class Done:
    job: int
    found: dict


def work(job):
    return Done(job, {"twice": 2 * job})


def test_every_job_has_its_line_and_more_are_added(tmp_path):
    file = tmp_path / "new" / "lines.jsonl"
    for jobs in ([1, 2], [3]):
        store.fill(file, jobs, work, processes=1, label="test", until=math.inf)
    assert list(store.read_lines(file)) == [{"job": job, "found": {"twice": 2 * job}} for job in (1, 2, 3)]


def test_when_the_time_is_over_nothing_begins(tmp_path):
    store.fill(tmp_path / "lines.jsonl", [1, 2], work, processes=1, label="test", until=-math.inf)
    assert list(store.read_lines(tmp_path / "lines.jsonl")) == []


def test_a_truncated_line_is_ignored(tmp_path):
    (tmp_path / "lines.jsonl").write_text('{"job": 1}\n{"job"')
    assert list(store.read_lines(tmp_path / "lines.jsonl")) == [{"job": 1}]


def test_a_quick_run_keeps_nothing(tmp_path):
    with store.folder_of(suite.Options(), tmp_path) as folder:
        assert folder == tmp_path
    with store.folder_of(suite.Options(quick=True), tmp_path) as folder:
        assert folder.is_dir() and folder != tmp_path
    assert not folder.exists()
