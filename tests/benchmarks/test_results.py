"""Result files, their index, and citations of them in src and sim."""

from __future__ import annotations

import dataclasses
import re
import shutil
import subprocess
import sys
import types

import pytest
from places import ROOT

sys.path.insert(0, str(ROOT))

from benchmarks import planning, report, same_code
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


QUOTED = re.compile(r"^\| ([^|]+) \| ([^|]+) \| \[[^]]+\]\(\.\./benchmarks/results/(\w+)\.md\) \|$", flags=re.MULTILINE)
NUMBER = re.compile(r"(?<![\w.])\d+(?:,\d{3})*(?:\.\d+)?")


@pytest.mark.parametrize(
    ("what", "figures", "name"), QUOTED.findall((ROOT / "docs" / "index.md").read_text(encoding="utf-8"))
)
def test_figures_of_the_docs_are_in_the_results_that_they_cite(what: str, figures: str, name: str):
    result = (report.RESULTS / f"{name}.md").read_text(encoding="utf-8").partition("- Machine")[2]
    known = [float(x.replace(",", "")) for x in NUMBER.findall(result)]
    missing = [
        x
        for x in NUMBER.findall(figures)
        if not any(abs(float(x.replace(",", "")) - k) <= 0.5001 * 10.0 ** -len(x.partition(".")[2]) for k in known)
    ]
    assert missing == [], what


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


def test_the_guide_names_the_total_time_of_its_table():
    text = (ROOT / "benchmarks" / "README.md").read_text(encoding="utf-8")
    minutes = dict(re.findall(r"^\| `(\w+)` \|.*\| (?:< )?([\d.]+) \|[^|]*\|$", text, flags=re.MULTILINE))
    assert sorted(minutes) == sorted(runner.SUBJECTS)
    total = sum(float(minutes[name]) for name in runner.SUBJECTS if name not in runner.APART)
    for quoted in (text, (ROOT / "Makefile").read_text(encoding="utf-8")):
        assert abs(int(re.findall(r"about (\d+) minutes on two quiet cores", quoted)[0]) - total) < 5


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


@pytest.fixture
def git(tmp_path, monkeypatch):
    """Use a repository with two files, of which a subject depends on one; return a function that calls git in it."""

    def call(*words: str) -> str:
        identity = ("-c", "user.name=a", "-c", "user.email=a@b")
        done = subprocess.run(["git", *identity, *words], cwd=tmp_path, capture_output=True, text=True, check=True)
        return done.stdout.strip()

    call("init", "-q")
    for name in ("measured.py", "other.py"):
        (tmp_path / name).write_text("one = 1\n")
    call("add", ".")
    call("commit", "-q", "-m", "first")
    results = tmp_path / "results"
    results.mkdir()
    monkeypatch.setattr(runner, "ROOT", tmp_path)
    monkeypatch.setattr(report, "RESULTS", results)
    monkeypatch.setattr(report, "INDEX", results / "README.md")
    monkeypatch.setattr(runner, "SUBJECTS", ("safety",))
    monkeypatch.setattr(runner, "paths_of", lambda name: ("measured.py",))
    return call


def _write_result(commit: str, body: str = "") -> None:
    head = report.Head(commit=commit, date="", command="", duration="", machine="")
    report.file_of("safety").write_text(report.document("T", "Q?", head, body))


def test_results_are_stale_once_their_paths_change(git, tmp_path):
    commit = git("rev-parse", "--short=8", "HEAD")
    assert list(runner.stale()) == [("safety", "no results")]
    reasons = {"unknown": "commit unknown", f"{commit}+": f"uncommitted changes at {commit}", commit: None}
    for named, reason in reasons.items():
        _write_result(named)
        assert [why for _, why in runner.stale()] == ([] if reason is None else [reason])
    (tmp_path / "other.py").write_text("one = 2\n")
    assert list(runner.stale()) == []
    (tmp_path / "measured.py").write_text("# Comment.\none = 2\n")
    assert list(runner.stale()) == [("safety", f"1 files changed since {commit}, such as measured.py")]
    (tmp_path / "measured.py").unlink()
    assert list(runner.stale()) == [("safety", f"1 files changed since {commit}, such as measured.py")]
    _write_result("0123abcd")
    assert list(runner.stale()) == [("safety", "commit 0123abcd is not in this repository")]


def test_results_are_not_stale_after_changes_of_comments_docstrings_and_formatting(git, tmp_path):
    _write_result(git("rev-parse", "--short=8", "HEAD"))
    (tmp_path / "measured.py").write_text('"""What it measures."""\n\none = (\n    1  # a number\n)\n"""Its unit."""\n')
    assert list(runner.stale()) == []


@pytest.mark.parametrize(
    ("name", "old", "new", "same"),
    [
        ("a.py", "def f():\n    return 1\n", 'def f():\n    """Return one."""\n    return (1)  # one\n', True),
        ("a.py", "def f():\n    return 1\n", "def f():\n    return 2\n", False),
        ("a.py", 'x = "# one"\n', 'x = "# two"\n', False),
        ("a.py", "if a:\n    b()\nc()\n", "if a:\n    b()\n    c()\n", False),
        ("a.py", "x = (", "x = (", False),  # no Python
        ("a.cpp", "int a = 1;  // one\n", "/* A\n number */ int a =\n    1;\n", True),
        ("a.cpp", "int a = 1;\n", "int a = 2;\n", False),
        ("a.hpp", 'auto a = "x // y";\n', 'auto a = "x // z";\n', False),
        ("a.hpp", "auto a = 1'000; // one\n", "auto a = 1'000; // it's one\n", True),
        ("a.hpp", "auto a = 'a'; // x\nint b;\n", "auto a = '\"'; // x\nint b;\n", False),
        ("a.hpp", "#define A 1\nint b;\n", "#define A 1 int b;\n", False),
        ("a.hpp", "// int a;\nint b;\n", "int a;\nint b;\n", False),
    ],
)
def test_code_is_compared_without_its_text(name, old, new, same):
    assert same_code.same_code(name, old, new) is same


def test_other_languages_count_with_all_of_their_text():
    assert [name for name in ("a.py", "a.pyi", "a.hpp", "a.yaml", "a.json", "a") if same_code.is_compared(name)] == [
        "a.py",
        "a.pyi",
        "a.hpp",
    ]


def test_results_are_stale_once_another_best_known_motion_is_stored_than_they_show(git, tmp_path, monkeypatch):
    folder = tmp_path / "benchmarks" / "best_known"
    folder.mkdir(parents=True)
    stored = planning.BEST.file_of("desk/lift_coffee")
    motion = folder / stored.name
    motion.write_text("{}")
    git("add", ".")
    git("commit", "-q", "-m", "second")
    monkeypatch.setattr(planning, "BEST", dataclasses.replace(planning.BEST, folder=folder))
    monkeypatch.setattr(runner, "paths_of", lambda name: ("benchmarks",))
    motion.write_bytes(stored.read_bytes())
    commit, total = git("rev-parse", "--short=8", "HEAD"), planning.BEST.read(motion).total
    for shown, count in ((total, 0), (1.01 * total, 1)):
        _write_result(commit, f"| task | best known J |\n|---|---|\n| desk/lift_coffee | {shown:.5g} |\n")
        assert len(list(runner.stale())) == count


# --- commits ----------------------------------------------------------------------------------------------------------


@pytest.fixture
def measuring(git, monkeypatch):
    """Replace the subject by one that measures nothing."""
    body = report.targets([report.none_of("missed", 0)])
    subject = types.SimpleNamespace(TITLE="T", QUESTION="Q?", HEADLINE="missed", run=lambda options: body)
    monkeypatch.setattr(runner, "module", lambda name: subject)
    return git


def test_results_name_the_commit_of_the_repository(measuring):
    assert runner.main(["safety", "--write"]) == 0
    written = report.file_of("safety").read_text()
    assert report.commit_of(written) == measuring("rev-parse", "--short=8", "HEAD")


@pytest.mark.parametrize("inside", [False, True])
def test_results_of_files_without_a_repository_need_the_name_of_a_commit(
    measuring, tmp_path, monkeypatch, capsys, inside
):
    commit = measuring("rev-parse", "HEAD")
    if inside:  # of another repository, whose commits say nothing about the files
        (tmp_path / "export").mkdir()
        monkeypatch.setattr(runner, "ROOT", tmp_path / "export")
    else:
        shutil.rmtree(tmp_path / ".git")
    with pytest.raises(SystemExit):
        runner.main(["safety", "--write"])
    assert "--commit" in capsys.readouterr().err
    assert not report.file_of("safety").exists()
    assert runner.main(["safety", "--write", "--commit", commit]) == 0
    assert report.commit_of(report.file_of("safety").read_text()) == commit[:8]


def test_another_commit_than_that_of_the_repository_is_refused(measuring, capsys):
    for wrong in ("0123abcd", "main", "0123"):
        with pytest.raises(SystemExit):
            runner.main(["safety", "--write", "--commit", wrong])
        assert wrong in capsys.readouterr().err
    assert not report.file_of("safety").exists()


def test_stale_results_are_listed_without_a_failure(capsys, monkeypatch):
    monkeypatch.setattr(runner, "stale", lambda: iter([("safety", "no results")]))
    assert runner.main(["--stale"]) == 0
    assert capsys.readouterr().out == "safety: no results\n"
