"""Links, anchors and file names in Markdown files exist, and code blocks fit a page."""

import re
from collections import Counter
from pathlib import Path

import pytest
from places import LIBRARY, ROOT

BENCHMARKS = ROOT / "benchmarks"
PAGES = [
    *sorted(ROOT.glob("*.md")),
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / ".ci").glob("*.md")),
    *sorted(BENCHMARKS.rglob("*.md")),
]
TREES = ("src", "sim", "tests", "docs", "benchmarks", "examples", "requirements", "typings", ".ci")
FILES = {
    "/" + file.relative_to(ROOT).as_posix()
    for top in (ROOT, *(ROOT / tree for tree in TREES))
    for file in (top.glob("*") if top == ROOT else top.rglob("*"))
    if file.is_file() and "__pycache__" not in file.parts
}
ENDINGS = "md|py|pyi|yaml|hpp|cpp|xml|toml|txt|jsonl"
WIDEST = 110
"""Most columns of a code block; on a page 1,300 px wide, Python beyond about 80 columns is wrapped."""

FENCE = re.compile(r"^( *)(```+|~~~+)([\w-]*).*?^\1\2 *$\n?", flags=re.MULTILINE | re.DOTALL)
LINK = re.compile(r"!?\[(?:[^\[\]]|\[[^\]]*\])*\]\(\s*([^)\s]+)\s*\)")
ROOTS = "src|sim|tests|docs|examples|requirements"
NAMED = re.compile(rf"(?:\.?[\w-]+/)*[\w.-]+\.(?:{ENDINGS})|(?:\.?[\w-]+/)+|(?:{ROOTS})(?:/[\w-]+)*")
"""A code span with the name of a file or folder of the repository."""
ROOTED = re.compile(rf"(?<![\w./<-])(?:{ROOTS})/[\w./-]+\.(?:{ENDINGS})\b")
"""A file name relative to the root of the repository, anywhere in a text."""

OTHERS = {
    *("build/", "dist/", "site/", "graceful_plan_demo/", "prevented/", "constrained_runs/"),
    *("policy_runs/", "job_runs/", "libero_runs/", "libero_scenes/"),
    *("comparison/report.html", "comparison/journal.jsonl", "best_known.yaml", "via_point.py"),
    *("ompl_planning.yaml", "scene0001.yaml", "request0001.yaml"),
}
"""Files and folders that programs write, or that belong to users and other tools."""


def prose(text: str) -> str:
    """Return a text without its code blocks."""
    return re.sub(r"(?<=\n\n)(?: {4,}.*\n|\n)+", "", FENCE.sub("", text))


def anchors(text: str) -> set[str]:
    """Return the anchors of a page's headings, as code hosts form them."""
    headings = re.findall(r"^#+ +(.+?) *$", FENCE.sub("", text), flags=re.MULTILINE)
    plain = [re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).strip().lower() for heading in headings]
    names = [re.sub(r"[^\w\- ]", "", heading).replace(" ", "-") for heading in plain]
    count = Counter[str]()
    found = set()
    for name in names:
        found.add(f"{name}-{count[name]}" if count[name] else name)
        count[name] += 1
    return found


def broken_links(page: Path, text: str) -> list[str]:
    """Return the relative links of a page whose file or anchor does not exist."""
    bad = []
    for link in LINK.findall(re.sub(r"`[^`\n]*`", "", prose(text))):
        if re.match(r"[a-z]+:", link):
            continue
        name, _, anchor = link.partition("#")
        target = page.parent / name
        if name and not target.exists():
            bad.append(link)
        elif anchor and anchor not in anchors(target.read_text() if name else text):
            bad.append(link)
    return bad


def missing_files(page: Path, text: str) -> list[str]:
    """Return the names of files and folders on a page that are not in the repository."""
    spans = {span for span in re.findall(r"`([^`\n]+)`", prose(text)) if NAMED.fullmatch(span)}
    names = (spans | set(ROOTED.findall(text))) - OTHERS
    return sorted(name for name in names if not (page.parent / name).exists() and not in_repository(name))


def in_repository(name: str) -> bool:
    """Return whether a file has this name at the end of its path, or a folder has it anywhere in its path."""
    ending = f"/{name}"
    return any(file.endswith(ending) or f"{ending.rstrip('/')}/" in file for file in FILES)


def wide_lines(text: str) -> list[str]:
    """Return lines of code blocks that are too wide, except blocks marked as text, which hold output."""
    fenced = [line for block in FENCE.finditer(text) if block[3] != "text" for line in block[0].splitlines()]
    indented = [line for line in FENCE.sub("", text).splitlines() if line.startswith("    ")]
    return [line for line in fenced + indented if len(line) > WIDEST]


def name_of(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_lead_to_files_and_headings(page):
    assert broken_links(page, page.read_text()) == []


@pytest.mark.parametrize("page", [page for page in PAGES if page.name != "mutants.md"], ids=name_of)
def test_named_files_exist(page):
    """The record of surviving mutants names files as they were at the time."""
    assert missing_files(page, page.read_text()) == []


@pytest.mark.parametrize("page", [page for page in PAGES if BENCHMARKS not in page.parents], ids=name_of)
def test_code_blocks_fit_the_page(page):
    assert wide_lines(page.read_text()) == []


def test_all_documents_are_checked():
    assert {"README.md", "CHANGELOG.md", "CONTRIBUTING.md", "docs/faq.md", "benchmarks/README.md"} <= set(
        map(name_of, PAGES)
    )
    assert LIBRARY.is_dir() and len(FILES) > 1000


@pytest.mark.parametrize(
    ("text", "bad"),
    [
        ("[a](auto.md)", []),
        ("[a](gone.md)", ["gone.md"]),
        ("[a](auto.md#the-search)", []),
        ("[a](auto.md#gone)", ["auto.md#gone"]),
        ("# A, b\n\n[a](#a-b) [b](#a)", ["#a"]),
        ("![a [b]](images/gone.png)", ["images/gone.png"]),
        ("[a](https://b.c/d.md) `[a](gone.md)`", []),
        ("```\n[a](gone.md)\n```\n", []),
    ],
)
def test_broken_links_are_found(text, bad):
    assert broken_links(ROOT / "docs" / "page.md", text) == bad


@pytest.mark.parametrize(
    ("text", "bad"),
    [
        ("`docs/auto.md`, `core/native/`, `fault_effects.yaml`, `sim/failbench`", []),
        ("`docs/gone.md`", ["docs/gone.md"]),
        ("`gone.yaml`", ["gone.yaml"]),
        ("`sim/gone`", ["sim/gone"]),
        ("`gone/`", ["gone/"]),
        ("```python\nx = 1  # see src/graceful_plan/gone.py\n```\n", ["src/graceful_plan/gone.py"]),
        ("`graceful-plan plan --output motion.yaml`", []),
    ],
)
def test_missing_files_are_found(text, bad):
    assert missing_files(ROOT / "docs" / "page.md", text) == bad


def test_wide_lines_are_found():
    wide = "x" * (WIDEST + 1)
    assert wide_lines(f"```\n{wide}\n```\n\n    {wide}\n\n{wide}\n\n```text\n{wide}\n```\n") == [wide, f"    {wide}"]
