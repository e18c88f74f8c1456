"""Result files, their index, and citations of them in src and sim."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest
from places import ROOT

sys.path.insert(0, str(ROOT))

from benchmarks import report
from benchmarks import run as runner

FILES = sorted(
    file.stem
    for file in report.RESULTS.glob("*.md")
    if file != report.INDEX and not file.stem.endswith(("_bound", "_long"))
)
SOURCES = [file for folder in ("src", "sim") for file in (ROOT / folder).rglob("*") if file.suffix in (".py", ".yaml")]
CITATION = re.compile(r"benchmarks/results/\w+\.md")
HEAD = re.compile(
    r"# .+\n\n\*\*.+\?\*\*\n\n- Commit: .+\n- Date: \d{4}-\d\d-\d\d\n- Command: `python benchmarks/run\.py .+`\n"
    r"- Duration: \d+ s, load average .+\n- Machine: .*Linux.*\n"
)


def test_results_cited_by_the_sources_exist():
    cited = {name for file in SOURCES for name in CITATION.findall(file.read_text(encoding="utf-8"))}
    assert cited
    assert [name for name in cited if not (ROOT / name).exists()] == []


def test_every_subject_has_results():
    assert sorted(runner.SUBJECTS) == FILES


def test_the_index_has_a_row_for_every_file_and_is_up_to_date():
    text = report.INDEX.read_text(encoding="utf-8")
    assert re.findall(r"^\| \[(\w+)\]\(\1\.md\)", text, flags=re.MULTILINE) == list(runner.SUBJECTS)
    assert text == runner.index()


@pytest.mark.parametrize("name", FILES)
def test_every_file_records_its_command(name: str):
    text = report.file_of(name).read_text(encoding="utf-8")
    assert HEAD.match(text)
    assert f"**{runner.module(name).QUESTION}**" in text
    assert "Quick run" not in text


@pytest.mark.parametrize("name", runner.SUBJECTS)
def test_paths_of_subjects_exist(name: str):
    assert [path for path in runner.paths_of(name) if not (ROOT / path).exists()] == []


def test_the_guide_names_every_subject():
    listed = re.findall(r"^\| `(\w+)` \|", (ROOT / "benchmarks" / "README.md").read_text(), flags=re.MULTILINE)
    assert sorted(listed) == sorted(runner.SUBJECTS)


# --- writing ----------------------------------------------------------------------------------------------------------

_HEAD = report.Head(commit="0123abcd", date="2026-01-02", command="run", duration="3 s", machine="abacus")
_TARGETS = (
    report.Target(what="speed, a|b", wanted=">= 1", measured="2", met=True),
    report.Target(what="gap", wanted="<= 1", measured="3", met=False),
)


def test_a_row_of_the_index_comes_from_the_file(tmp_path, monkeypatch):
    text = report.document("Title", "Why?", _HEAD, f"Text.\n\n{report.targets(_TARGETS)}\n| a | b | c | d |\n")
    assert report.commit_of(text) == "0123abcd"
    monkeypatch.setattr(report, "RESULTS", tmp_path)
    row = report.index_row("kernels", "Why?", "gap", text)
    assert row == ("[kernels](kernels.md)", "Why?", "gap: 3", "<= 1", "**no**", "1 of 2", "`0123abcd`")
    assert report.index_row("kernels", "Why?", "speed", text)[2] == "speed, a|b: 2"
    report.file_of("kernels_long").write_text(text)
    assert report.index_row("kernels", "Why?", "gap", text)[0] == "[kernels](kernels.md), [long](kernels_long.md)"
    with pytest.raises(ValueError, match="kernels: no target and no figure begins with 'harm'"):
        report.index_row("kernels", "Why?", "harm", text)


def test_without_targets_the_headline_is_a_line():
    text = report.document("Title", "Why?", _HEAD, "Harm: 3 [2, 4].\n")
    assert report.index_row("a", "Why?", "Harm", text)[2:6] == ("Harm: 3 [2, 4]", "-", "-", "-")


def test_results_are_written_with_the_index(tmp_path, monkeypatch):
    monkeypatch.setattr(report, "RESULTS", tmp_path)
    monkeypatch.setattr(report, "INDEX", tmp_path / "README.md")
    missed = report.none_of(runner.module("safety").HEADLINE, 3)
    runner.write("safety", report.document("Title", "Why?", _HEAD, report.targets([missed])))
    assert sorted(file.name for file in tmp_path.iterdir()) == ["README.md", "safety.md"]
    assert "| [safety](safety.md) |" in (tmp_path / "README.md").read_text()


def test_quick_results_are_not_written(capsys):
    with pytest.raises(SystemExit):
        runner.main(["safety", "--quick", "--write"])
    assert "--quick" in capsys.readouterr().err


def test_unknown_subjects_are_refused(capsys):
    with pytest.raises(SystemExit):
        runner.main(["roadmap"])
    assert "'roadmap' is no benchmark" in capsys.readouterr().err


# --- stale results ----------------------------------------------------------------------------------------------------


def test_results_are_stale_once_their_paths_change(tmp_path, monkeypatch):
    def git(*words: str) -> str:
        identity = ("-c", "user.name=a", "-c", "user.email=a@b")
        done = subprocess.run(["git", *identity, *words], cwd=tmp_path, capture_output=True, text=True, check=True)
        return done.stdout.strip()

    git("init", "-q")
    for name in ("measured.py", "other.py"):
        (tmp_path / name).write_text("one")
    git("add", ".")
    git("commit", "-q", "-m", "first")
    commit = git("rev-parse", "--short=8", "HEAD")
    results = tmp_path / "results"
    results.mkdir()
    monkeypatch.setattr(runner, "ROOT", tmp_path)
    monkeypatch.setattr(report, "RESULTS", results)
    monkeypatch.setattr(runner, "SUBJECTS", ("safety",))
    monkeypatch.setattr(runner, "paths_of", lambda name: ("measured.py",))
    assert list(runner.stale()) == [("safety", "no results")]
    reasons = {"unknown": "commit unknown", f"{commit}+": f"uncommitted changes at {commit}", commit: None}
    for named, reason in reasons.items():
        head = report.Head(commit=named, date="", command="", duration="", machine="")
        report.file_of("safety").write_text(report.document("T", "Q?", head, ""))
        assert [why for _, why in runner.stale()] == ([] if reason is None else [reason])
    (tmp_path / "other.py").write_text("two")
    assert list(runner.stale()) == []
    (tmp_path / "measured.py").write_text("two")
    assert list(runner.stale()) == [("safety", f"1 files changed since {commit}, such as measured.py")]
    report.file_of("safety").write_text("- Commit: `0123abcd`\n")
    assert list(runner.stale()) == [("safety", "commit 0123abcd is not in this repository")]


def test_stale_results_are_listed_without_a_failure(capsys, monkeypatch):
    monkeypatch.setattr(runner, "stale", lambda: iter([("safety", "no results")]))
    assert runner.main(["--stale"]) == 0
    assert capsys.readouterr().out == "safety: no results\n"
