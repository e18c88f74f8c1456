"""RESULTS.md and what is said of it: no section without its subject, no reference without its section."""

from __future__ import annotations

import importlib
import re
import sys
from pathlib import Path

import pytest
from places import ROOT

sys.path.insert(0, str(ROOT))

from benchmarks import run as runner

SECTION = re.compile(r"<!-- begin (\w+) -->\n(.*?)\n<!-- end \1 -->\n", flags=re.DOTALL)
SECTIONS = dict(SECTION.findall(runner.RESULTS.read_text()))
DOCUMENTS = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
MENTION = re.compile(r"RESULTS\.md")
LINK = re.compile(r"\[[^\]]*\]\([^)\s]*RESULTS\.md(?:#([\w-]+))?\)")
MADE = re.compile(r"\d{4}-\d\d-\d\d, `python benchmarks/\w+\.py[^`]*`, .*\bload average\b.*; Linux.*; ")
"""Date, command and machine."""


def title(subject: str) -> str:
    return importlib.import_module(f"benchmarks.subjects.{subject}").TITLE


def anchors(text: str) -> set[str]:
    """Name what the headings of a document can be linked by, as code hosts do."""
    headings = re.findall(r"^#+ (.+)$", text, flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-") for heading in headings}


def false_references(text: str, known: set[str], *, whole: bool) -> list[str]:
    """List references to RESULTS.md that are no link to a section of it.

    Args:
        text: A document.
        known: Anchors of RESULTS.md.
        whole: Whether all of RESULTS.md may be linked, too.
    """
    false = []
    for line in text.splitlines():
        links = [match.group(1) for match in LINK.finditer(line)]
        fine = [anchor in known if anchor else whole for anchor in links]
        if not all(fine) or MENTION.search(LINK.sub("", line)):
            false.append(line.strip())
    return false


@pytest.mark.parametrize("subject", [name for name in runner.SUBJECTS if name not in runner.ON_REQUEST])
def test_every_subject_has_its_section(subject):
    assert subject in SECTIONS, f"python benchmarks/run.py {subject} --write"


@pytest.mark.parametrize("name", SECTIONS)
def test_every_section_belongs_to_a_subject_and_says_how_it_was_made(name):
    head, _, made, *_ = SECTIONS[name].splitlines()
    if name == runner.TAKEN_OUT:
        assert head == "## Taken out"
        return
    assert name in runner.SUBJECTS
    assert head == f"## {title(name)}"
    assert MADE.match(made), made
    assert "Quick run" not in SECTIONS[name]


def test_nothing_stands_between_the_sections():
    """What is written there would be lost when the next section is written."""
    assert SECTION.sub("", runner.RESULTS.read_text()).strip() == runner.report.HEADER.strip()


@pytest.mark.parametrize("file", DOCUMENTS, ids=lambda file: file.name)
def test_what_documents_say_of_the_results_is_in_them(file: Path):
    assert not false_references(file.read_text(), anchors(runner.RESULTS.read_text()), whole=file.name == "README.md")


def test_anchors_are_those_of_headings():
    assert anchors("# A, b: plan(w=1)\n\ntext\n### FailBench: kill -9\n") == {"a-b-planw1", "failbench-kill--9"}


@pytest.mark.parametrize(
    ("line", "false"),
    [
        ("see [RESULTS.md](../benchmarks/RESULTS.md#here), too", False),
        ("see [the figures](../benchmarks/RESULTS.md#here) and [RESULTS.md](benchmarks/RESULTS.md#here)", False),
        ("see [RESULTS.md](../benchmarks/RESULTS.md#gone)", True),
        ("see [RESULTS.md](../benchmarks/RESULTS.md)", True),
        ("`benchmarks/RESULTS.md` has it", True),
        ("[it](benchmarks/RESULTS.md#here) is in `RESULTS.md`", True),
        ("no word of it", False),
    ],
)
def test_false_references_are_found(line, false):
    assert bool(false_references(line, {"here"}, whole=False)) == false


def test_the_guide_names_every_subject():
    listed = re.findall(r"^\| `(\w+)` \|", runner.RESULTS.with_name("README.md").read_text(), flags=re.MULTILINE)
    assert sorted(listed) == sorted(runner.SUBJECTS)
