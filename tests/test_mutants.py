"""Tools of `make mutants`: an edit becomes a choice between original and edit, and the named tests exist."""

import ast
import importlib
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture
def native_mutants(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(str(ROOT / ".ci"))
    names = ("native_mutants", "native_edits", "mutated")
    found = importlib.import_module("native_mutants")
    yield found
    for name in names:
        sys.modules.pop(name, None)


def test_an_edit_becomes_a_choice(native_mutants):
    edit = native_mutants.Edit(7, "a.hpp", "x = a «- b»;", "+ b", ())
    assert edit.entered("x = a - b; y = a;") == "x = a + (gp_mutant == 7 ? (+ b) : (- b)); y = a;"
    for text in ("y = a;", "x = a - b; x = a - b;"):
        with pytest.raises(SystemExit, match=r"a\.hpp"):
            edit.entered(text)


def test_files_of_edits_and_their_tests_exist(native_mutants):
    edits = list(native_mutants.edits())
    assert edits
    for edit in edits:
        text = (ROOT / native_mutants.NATIVE / edit.file).read_text(encoding="utf-8")
        assert edit.entered(text) != text
        for part in (edit.before.partition("«")[2].partition("»")[0], edit.after):
            assert part.count("(") == part.count(")"), f"{part} is no expression"
        assert edit.tests and all((ROOT / name).exists() for name in edit.tests)


def test_modules_and_their_tests_exist():
    tree = ast.parse((ROOT / ".ci" / "mutants.py").read_text(encoding="utf-8"))
    (given,) = (
        node.value for node in tree.body if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "MODULES"
    )
    modules = ast.literal_eval(given)
    assert modules
    for module, tests in modules.items():
        assert (ROOT / "src" / "graceful_plan" / module).is_file() and tests
        assert all((ROOT / name).exists() for name in tests)
