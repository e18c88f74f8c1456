"""The site is complete: navigation lists every page, the reference every public name, and file links have pages."""

import importlib.util
import inspect
import re
from pathlib import Path

import pytest
import yaml
from places import ROOT

import failbench
import graceful_plan as gp

DOCS = ROOT / "docs"
GENERATED = {"readme.md", "changelog.md", "contributing.md", "benchmarks.md", "results/index.md", "examples.md"}
ENTRIES = {
    entry: page.name
    for page in (DOCS / "api").glob("*.md")
    for entry in re.findall(r"^::: (\S+)$", page.read_text(), flags=re.MULTILINE)
}


def pages(nav) -> list[str]:
    """List the pages of a navigation."""
    if isinstance(nav, str):
        return [nav]
    items = nav.values() if isinstance(nav, dict) else nav
    return [page for item in items for page in pages(item)]


def test_every_page_has_its_place():
    named = pages(yaml.safe_load((ROOT / "mkdocs.yml").read_text())["nav"])
    there = {page.relative_to(DOCS).as_posix() for page in DOCS.rglob("*.md")}
    assert len(named) == len(set(named))
    assert set(named) == there | GENERATED


@pytest.mark.parametrize("package", [gp, failbench])
def test_every_public_function_and_class_is_in_the_reference(package):
    public = [getattr(package, name) for name in package.__all__]
    named = {f"{x.__module__}.{x.__name__}" for x in public if inspect.isclass(x) or inspect.isfunction(x)}
    assert sorted(named - ENTRIES.keys()) == []


@pytest.mark.parametrize("entry", sorted(ENTRIES))
def test_entries_exist_and_are_described(entry):
    module, _, name = entry.rpartition(".")
    found = getattr(importlib.import_module(module), name)
    assert (found.__module__, found.__name__) == (module, name)
    assert inspect.getdoc(found)


@pytest.fixture(scope="module")
def hooks():
    pytest.importorskip("mkdocs")
    pytest.importorskip("latex2mathml")
    spec = importlib.util.spec_from_file_location("hooks", ROOT / ".ci" / "docs" / "hooks.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    ("text", "folder", "expected"),
    [
        ("[a](../README.md)", "docs", "[a](readme.md)"),
        ("[a](../benchmarks/results/kernels.md#b)", "docs", "[a](results/kernels.md#b)"),
        ("[a](results/README.md)", "benchmarks", "[a](results/index.md)"),
        ("[a](kernels.md)", "benchmarks/results", "[a](../results/kernels.md)"),
        ("[a](../examples/custom_fault.py)", "docs", "[a](examples.md#custom_faultpy)"),
        ("[a](docs/risk.md#b)", ".", "[a](risk.md#b)"),
        ("![a](docs/images/a.png)", ".", "![a](images/a.png)"),
        ("[a](risk.md)", "docs", "[a](risk.md)"),
        ("[a](https://b.c/d.md)", "docs", "[a](https://b.c/d.md)"),
        ("`[a](../README.md)` [b](#c)", "docs", "`[a](../README.md)` [b](#c)"),
        ("```\n[a](../README.md)\n```\n", "docs", "```\n[a](../README.md)\n```\n"),
        ("[a](../planners.md)", "docs/api", "[a](../planners.md)"),
    ],
)
def test_links_lead_to_pages(hooks, text, folder, expected):
    assert hooks.linked(text, Path(folder)) == expected


def test_lists_after_paragraphs_are_lists(hooks):
    assert hooks.spaced("A:\n- b\n- c\n  d\n- e\n") == "A:\n\n- b\n- c\n  d\n- e\n"


def test_every_fault_is_seen_moving():
    from failbench.pictures.contact_sheet import WORDS

    text, films = (DOCS / "faults-moving.md").read_text(), DOCS / "images" / "faults"
    assert set(WORDS) == set(failbench.faults()) == {film.stem for film in films.iterdir()}
    for name, words in WORDS.items():
        assert f"![{name}: {words}](images/faults/{name}.webp)" in text
        assert b"ANIM" in (films / f"{name}.webp").read_bytes()[:64]
    assert sum(film.stat().st_size for film in films.iterdir()) < 3e6


@pytest.mark.parametrize(
    ("page", "display"),
    [
        (r'<p><span class="arithmatex">\(a &lt; b\)</span></p>', "inline"),
        (r'<div class="arithmatex">\[a &lt; b\]</div>', "block"),
        ("<p>.. math:: a &lt; b</p>", "block"),
        ("<p>:math:<code>a &lt; b</code></p>", "inline"),
    ],
)
def test_formulas_become_mathml(hooks, page, display):
    made = hooks.on_page_content(page, None, None, None)
    assert re.search(rf'<math [^>]*display="{display}">.*&#x0003C;|&lt;', made)
    assert "arithmatex" not in made and "math:" not in made.replace("http://www.w3.org", "")


def test_every_formula_of_the_theory_is_understood(hooks):
    text = (DOCS / "theory.md").read_text()
    formulas = re.findall(r"\$\$(.*?)\$\$", text, flags=re.DOTALL)
    formulas += re.findall(r"\$([^$\n]+)\$", re.sub(r"\$\$.*?\$\$", "", text, flags=re.DOTALL))
    assert len(formulas) > 30
    for formula in formulas:
        made = hooks.convert(formula.strip())
        assert not re.search(r"<m\w+>\\", made), f"{formula}: a command that is left as it is"
