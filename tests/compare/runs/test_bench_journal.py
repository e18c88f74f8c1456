import json
import os
import signal
import subprocess
import sys
import time

import pytest
from bench_cases import MACHINE, own_planner, rich, solved, suite_file

from graceful_plan import compare as bench
from graceful_plan.compare.runs.journal import NAME, OtherSettings, RunJournal, RunJournalBusy, differences, read
from graceful_plan.compare.runs.records import Run
from graceful_plan.exceptions import FormatError

SETTINGS = {"seconds": 0.5, "seeds": [0, 1], "planners": [{"label": "a", "settings": {}}]}


def opened(folder, settings=SETTINGS):
    return RunJournal(folder, settings, MACHINE)


@pytest.mark.parametrize("run", rich().runs[:6], ids=lambda run: f"{run.planner} {run.status}")
def test_a_run_survives_writing_and_reading(run):
    back = Run.from_document(json.loads(run.to_json()), "here")
    assert repr(back) == repr(run)  # NaN is not equal to itself


def test_runs_are_there_again(tmp_path):
    runs = [solved("a", "x", seed, 1.0) for seed in range(3)]
    with opened(tmp_path) as first:
        assert first.runs == []
        for run in runs:
            first.add(run)
    with opened(tmp_path) as second:
        assert second.runs == runs


def test_a_kill_at_any_byte_loses_the_last_run_only(tmp_path):
    with opened(tmp_path) as whole:
        for seed in range(3):
            whole.add(solved("a", "x", seed, 1.0))
    content = (tmp_path / NAME).read_bytes()
    ends = [i + 1 for i, byte in enumerate(content) if byte == ord("\n")]
    assert len(ends) == 4
    for length in [0, 1, *(end + k for end in ends for k in (-2, -1, 0, 1, 50) if 0 < end + k <= len(content))]:
        (tmp_path / NAME).write_bytes(content[:length])
        with opened(tmp_path) as journal:
            kept = sum(end <= length for end in ends)
            assert len(journal.runs) == max(0, kept - 1)
            for seed in range(len(journal.runs), 3):
                journal.add(solved("a", "x", seed, 1.0))
        assert [run.seed for run in read(tmp_path / NAME)[1]] == [0, 1, 2]


def test_damage_elsewhere_is_refused_with_its_line(tmp_path):
    with opened(tmp_path) as whole:
        for seed in range(3):
            whole.add(solved("a", "x", seed, 1.0))
    lines = (tmp_path / NAME).read_bytes().splitlines(keepends=True)
    for i, bad in ((1, b"{oops\n"), (2, b"[1, 2]\n"), (2, lines[2].replace(b'"seed":1', b'"seed":null'))):
        (tmp_path / NAME).write_bytes(b"".join([*lines[:i], bad, *lines[i + 1 :]]))
        with pytest.raises(FormatError, match=f"{NAME}:{i + 1}: "):
            opened(tmp_path)


@pytest.mark.parametrize(
    ("head", "message"),
    [
        (b"hello\n", "no journal of a comparison"),
        (b"my notes, without an end", "no journal of a comparison"),
        (b'{"schema": "graceful_plan.bench", oops\n', ":1: not JSON"),
        (b"{}\n", "no journal of a comparison"),
        (b'{"schema": "graceful_plan.bench", "version": 99}\n', "version 99; this version reads 1 to 3"),
        (b'{"schema": "graceful_plan.bench", "version": true}\n', "version True; this version reads 1 to 3"),
        (b'{"schema": "graceful_plan.bench", "version": 3}\n', "damaged: no begun"),
        (b'{"schema": "graceful_plan.bench", "version": 1}\n', "damaged: no settings"),
    ],
)
def test_other_files_are_refused(tmp_path, head, message):
    (tmp_path / NAME).write_bytes(head)
    with pytest.raises(FormatError, match=message):
        opened(tmp_path)
    assert (tmp_path / NAME).read_bytes() == head


LATER = {  # fields that the journal of each version lacked
    1: {"self_clearance", "certified", "times", "velocities", "motion_wall", "motion_cpu", "early"},
    2: {"motion_wall", "motion_cpu", "early"},
}


@pytest.mark.long
@pytest.mark.parametrize("version", LATER)
def test_journals_of_earlier_versions_are_read_but_not_continued(tmp_path, version):
    suite, out = suite_file(tmp_path), tmp_path / "out"
    made = bench.compare(suite, planners=["rrt_connect"], out=out, processes=0)
    head, *runs = map(json.loads, (out / NAME).read_text().splitlines())
    head["version"] = version
    if version == 1:
        del head["begun"], head["known"]
    older = [head, *({key: value for key, value in run.items() if key not in LATER[version]} for run in runs)]
    (out / NAME).write_text("".join(json.dumps(line) + "\n" for line in older))
    read_back = bench.load_comparison(out)
    assert [(run.key, run.status, run.total) for run in read_back.runs] == [
        (run.key, run.status, run.total) for run in made.runs
    ]
    assert all(run.early == () and run.motion_wall != run.motion_wall for run in read_back.runs)
    with pytest.raises(OtherSettings, match=f"version.*{version}.*3"):
        bench.compare(suite, planners=["rrt_connect"], out=out, processes=0)
    del older[1]["total"]
    (out / NAME).write_text("".join(json.dumps(line) + "\n" for line in older))
    with pytest.raises(FormatError, match=f"{NAME}:2: "):
        bench.load_comparison(out)


def test_other_settings_are_refused_and_named(tmp_path):
    with opened(tmp_path) as first:
        first.add(solved("a", "x", 0, 1.0))
    other = {"seconds": 2.0, "seeds": [0, 1], "planners": [{"label": "b", "settings": {}}]}
    with pytest.raises(OtherSettings, match=r"seconds .*0\.5.*2\.0.*planners\[0\]\.label.*\"a\".*\"b\""):
        opened(tmp_path, other)
    with opened(tmp_path) as again:
        assert len(again.runs) == 1


def test_differences_name_missing_parts():
    assert list(differences({"a": 1}, {"a": 1})) == []
    assert list(differences({"a": 1}, {"b": 2})) == ["a was 1 and is null", "b was null and is 2"]
    longer = list(differences({"p": [{"label": "a"}]}, {"p": [{"label": "a"}, {"label": "b"}]}))
    assert longer == ['p was ["a"] and is ["a", "b"]']


def test_two_processes_do_not_share_a_journal(tmp_path):
    with opened(tmp_path), pytest.raises(RunJournalBusy):
        opened(tmp_path)


@pytest.mark.long
def test_only_missing_runs_are_repeated(tmp_path):
    suite, out = suite_file(tmp_path), tmp_path / "out"
    whole = bench.compare(suite, planners=["rrt_connect"], out=out, processes=0)
    lines = (out / NAME).read_bytes().splitlines(keepends=True)
    (out / NAME).write_bytes(b"".join([*lines[:3], lines[3][:40]]))
    told = []
    again = bench.compare(suite, planners=["rrt_connect"], out=out, processes=0, progress=lambda *a: told.append(a[:2]))
    assert told == [(2, 4), (3, 4), (4, 4)]
    assert [run.key for run in again.runs] == [run.key for run in whole.runs]
    assert (out / NAME).read_bytes().splitlines(keepends=True)[:3] == lines[:3]


@pytest.mark.long
def test_a_changed_planner_is_another_comparison(here):
    suite, word = suite_file(here), own_planner(here)
    bench.compare(suite, planners=[word], out=here / "out", processes=0)
    file = here / "straight.py"
    file.write_text(file.read_text() + "\n# better\n")
    with pytest.raises(OtherSettings, match=r"planners\[0\].digest was"):
        bench.compare(suite, planners=[word], out=here / "out", processes=0)


def test_a_folder_without_a_journal_has_no_report(tmp_path):
    with pytest.raises(FormatError, match="No such file"):
        bench.load_comparison(tmp_path)


@pytest.mark.long
def test_a_killed_and_interrupted_command_resumes(tmp_path):
    out = tmp_path / "out"
    # Many more slow runs than finish before the kill; the remaining ones are quick after `slow` is deleted.
    slow = own_planner(tmp_path, act="import pathlib, time; time.sleep(0.2 * pathlib.Path('slow').exists())")
    (tmp_path / "slow").touch()
    command = [sys.executable, "-m", "graceful_plan.tools.cli", "bench", "--suite", str(suite_file(tmp_path)), "--json"]
    command += ["--planners", slow, "--seeds", "20", "--out", str(out)]

    def stopped(stop, lines):
        process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=tmp_path)
        deadline = time.monotonic() + 300.0
        while not (out / NAME).exists() or (out / NAME).read_bytes().count(b"\n") < lines:
            assert time.monotonic() < deadline and process.poll() is None
            time.sleep(0.01)
        os.kill(process.pid, stop)
        return process.communicate(timeout=100)[1], process.returncode

    stopped(signal.SIGKILL, 3)
    killed = bench.load_comparison(out)
    told, code = stopped(signal.SIGINT, len(killed.runs) + 3)
    interrupted = bench.load_comparison(out)
    assert 2 <= len(killed.runs) < len(interrupted.runs) < 40
    assert code == 130
    assert f"{len(interrupted.runs)} of 40" in told and str(out) in told
    assert "Traceback" not in told
    (tmp_path / "slow").unlink()
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    after = bench.load_comparison(out)
    assert json.loads(done.stdout)["runs"] == len(after.runs) == after.expected == 40
    for earlier in (killed, interrupted):
        assert {repr(run) for run in earlier.runs} <= {repr(run) for run in after.runs}
