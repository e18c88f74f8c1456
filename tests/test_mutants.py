"""The list of edits fits the core as it is, and tests that mutants are tried with exist."""

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


def test_edits_of_the_core_fit(native_mutants):
    edits = list(native_mutants.edits())
    assert len(edits) >= 104
    for edit in edits:
        text = (ROOT / native_mutants.NATIVE / edit.file).read_text(encoding="utf-8")
        assert edit.entered(text) != text
        for part in (edit.before.partition("«")[2].partition("»")[0], edit.after):
            assert part.count("(") == part.count(")"), f"{part} is no expression"
        assert all((ROOT / name).exists() for name in edit.tests)


def test_modules_and_their_tests_exist():
    tree = ast.parse((ROOT / ".ci" / "mutants.py").read_text(encoding="utf-8"))
    (given,) = (
        node.value for node in tree.body if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "MODULES"
    )
    modules = ast.literal_eval(given)
    assert len(modules) >= 12
    for module, tests in modules.items():
        assert (ROOT / "src" / "graceful_plan" / module).is_file() and tests
        assert all((ROOT / name).exists() for name in tests)
