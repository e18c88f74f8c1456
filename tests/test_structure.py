"""The shape of the project: imports point one way, importing is light, tables and documents say what is true."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import graceful_plan as gp
from failbench import execution, plant, robot, world
from graceful_plan import Explanation, ImpactMap, arrays, elements

ROOT = Path(__file__).parents[1]
LIBRARY = ROOT / "src" / "graceful_plan"
FILES = sorted(LIBRARY.rglob("*.py"))
HARNESS = ROOT / "sim" / "failbench"
HARNESS_FILES = sorted(HARNESS.rglob("*.py"))

LAYERS = (
    {"kernels", "compile", "certified_clearance"},
    {"costs", "checks", "explain", "impact_map", "risk", "harm_law", "sensitivity", "certificate", "symbolic"},
    {"planners"},
    {
        "plan",
        "prefer",
        "search",
        "finish",
        "departure",
        "ends",
        "escape",
        "arguments",
        "problems",
        "testing",
        "optimise",
        "motion_program",
        "motion_rows",
        "motion_charges",
        "motion_check",
        "roadmap",
    },
    {"front_archive", "front_descent", "front_refine", "front_search", "pareto_front", "front_file", "tuning"},
    {"__init__"},
    {"bench", "cli", "demo", "doctor", "tune_report", "viz"},
)
"""From the bottom up; a module that is named nowhere lies below all of them, with the scene and the tables."""

HEAVY = ("scipy", "toppra", "ompl", "mink", "casadi", "fcl", "matplotlib", "qpsolvers", "pyarrow", "ray", "PIL")


def layer(module: str) -> int:
    return next((i for i, names in enumerate(LAYERS, start=1) if module in names), 0)


def module_of(file: Path) -> str:
    """Name a module by its place directly below the package: planners/prm.py is `planners`."""
    return file.relative_to(LIBRARY).with_suffix("").parts[0]


def imports(tree: ast.Module) -> Iterator[str]:
    """Yield the full name of everything imported, but for types only."""
    for_types = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        for inner in ast.walk(node)
    }
    for node in ast.walk(tree):
        if id(node) in for_types:
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0 and node.module, "imports are absolute"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def imported_modules(file: Path) -> set[str]:
    """Name the modules below graceful_plan that a file imports; `__init__` stands for the package itself."""
    found = set()
    for name in imports(ast.parse(file.read_text())):
        first, *rest = name.split(".")
        if first == "graceful_plan":
            inside = rest and ((LIBRARY / rest[0]).is_dir() or (LIBRARY / f"{rest[0]}.py").exists())
            found.add(rest[0] if inside or rest[:1] == ["_native"] else "__init__")
    return found


def test_imports_point_downwards():
    upwards = [
        f"{file.relative_to(LIBRARY)} imports {name}"
        for file in FILES
        for name in imported_modules(file)
        if name != module_of(file) and layer(name) > layer(module_of(file))
    ]
    assert not upwards


def test_layers_name_real_modules():
    modules = {module_of(file) for file in FILES}
    assert set().union(*LAYERS) <= modules


@pytest.mark.parametrize("judge", ["verify", "exact"])
def test_the_judge_shares_nothing_with_the_planners(judge):
    shared = imported_modules(LIBRARY / f"{judge}.py") & {"kernels", "compile", "planners", "plan", "_native"}
    assert not shared


def test_library_never_imports_what_is_built_on_it():
    roots = {name.split(".")[0] for file in FILES for name in imports(ast.parse(file.read_text()))}
    assert "numpy" in roots
    assert not roots & {"failbench", "benchmarks", "tests", "examples"}


def test_the_harness_uses_what_is_public_and_nothing_above_it():
    names = {name for file in HARNESS_FILES for name in imports(ast.parse(file.read_text()))}
    assert not {name for name in names if name.startswith("graceful_plan") and "._" in name}
    assert not {name.split(".")[0] for name in names} & {"benchmarks", "tests", "examples"}


def test_only_the_command_lines_print():
    printing = {
        file.name
        for file in FILES + HARNESS_FILES
        for node in ast.walk(ast.parse(file.read_text()))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "print"
    }
    assert printing == {"cli.py"}


@pytest.mark.parametrize("package", ["graceful_plan", "failbench"])
def test_import_is_light_and_has_no_effects(package):
    code = f"""
import os, sys, threading
before = dict(os.environ)
import {package}
assert dict(os.environ) == before, "environment changed"
assert threading.active_count() == 1, "threads started"
print(*[name for name in {HEAVY} if name in sys.modules])
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.stdout.strip(), done.stderr, done.returncode) == ("", "", 0)


def field_tables() -> list[type]:
    modules = (arrays, elements, robot, plant, world, execution)
    classes = [cls for module in modules for _, cls in inspect.getmembers(module, dataclasses.is_dataclass)]
    classes += [Explanation, ImpactMap]  # their modules have the names of functions of the package
    return list(dict.fromkeys(cls for cls in classes if "| field" in (cls.__doc__ or "")))


def test_every_table_of_arrays_is_found():
    assert {cls.__name__ for cls in field_tables()} >= {"RobotArrays", "WorldArrays", "HazardArrays", "Limits"}


@pytest.mark.parametrize("cls", field_tables(), ids=lambda cls: cls.__name__)
def test_field_tables_list_the_fields(cls):
    rows = re.findall(r"^\s*\| (\w+) ", inspect.getdoc(cls) or "", flags=re.MULTILINE)
    assert rows == ["field", *(field.name for field in dataclasses.fields(cls))]


def readme_snippets() -> list[str]:
    return re.findall(r"^```python\n(.*?)^```", (ROOT / "README.md").read_text(), flags=re.MULTILINE | re.DOTALL)


def test_readme_has_snippets():
    assert readme_snippets()


@pytest.mark.parametrize("snippet", readme_snippets())
def test_readme_snippet_runs(snippet, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(compile(snippet, "README.md", "exec"), {})


def guide_snippets(guide: str) -> list[str]:
    return re.findall(r"^```python\n(.*?)^```", (ROOT / "docs" / guide).read_text(), flags=re.MULTILINE | re.DOTALL)


GUIDES = (
    "auto.md", "casadi.md", "certificate.md", "chomp.md", "comparing-planners.md", "faults-prior.md",
    "impact-models.md", "moving.md", "optimisers.md", "roadmap.md", "tuning.md",
)  # fmt: skip


@pytest.mark.parametrize("guide", GUIDES)
def test_guides_run(guide, tmp_path, monkeypatch):
    (tmp_path / "faults.yaml").write_text("version: 1\npresets: {mine: {weak_grip: 2, dropout: 1}}\n")
    monkeypatch.chdir(tmp_path)
    task = gp.load_scene("tabletop_l1").tasks["green_to_blue"]
    known = {"gp": gp, "task": task, "start": task.start, "goal": task.goal, "scene": task.scene}
    snippets = guide_snippets(guide)
    assert snippets
    exec(compile("\n".join(snippets), guide, "exec"), known)


@pytest.mark.parametrize("guide", sorted(file.name for file in (ROOT / "docs").glob("*.md")))
def test_guides_name_existing_files(guide):
    for link in re.findall(r"\]\(([^)#:]+)\)", (ROOT / "docs" / guide).read_text()):
        assert (ROOT / "docs" / link).exists(), link


def test_readme_names_existing_files():
    text = (ROOT / "README.md").read_text()
    for link in re.findall(r"\]\(([^)#:]+)\)", text):
        assert (ROOT / link).exists(), link
