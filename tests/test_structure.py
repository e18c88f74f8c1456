"""Structure of the project: import directions, light imports, complete tables, correct documents."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import pkgutil
import re
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from places import LIBRARY, ROOT

import failbench
import graceful_plan as gp
from failbench.rollouts import execution
from failbench.simulated import robot, simulation, world
from graceful_plan.analysis.explanation import Explanation
from graceful_plan.analysis.impact_maps import ImpactMap
from graceful_plan.core import arrays
from graceful_plan.scene import elements

FILES = sorted(LIBRARY.rglob("*.py"))
HARNESS = ROOT / "sim" / "failbench"
HARNESS_FILES = sorted(HARNESS.rglob("*.py"))

BASICS = {
    "_version",
    "array_types",
    "exceptions",
    "disk_cache",
    "lazy_imports",
    "path",
    "regular_file",
    "setting_checks",
    "untrusted_json",
    "untrusted_yaml",
    "yaml_file",
}
"""Modules at the root that every package may use."""
FLOORS = (
    {"basics"},
    {"scene"},
    {"core", "formats"},
    {"timing"},
    {"result"},
    {"documents"},
    {"costs"},
    {"constraints"},
    {"planners", "judge"},
    {"analysis", "transcription"},
    {"query"},
    {"plan", "roadmap", "monitor"},
    {"replanning", "tuning", "job"},
    {"viz"},
    {"mobile"},
    {"annotation", "viewer"},
    {"compare"},
    {"graceful_plan"},
    {"testing", "tools"},
)
"""From the bottom up: a package uses only lower floors. "graceful_plan" is the package itself."""
HARNESS_FLOORS = (
    {"basics"},
    {"simulated"},
    {"fault"},
    {"surroundings", "recording"},
    {"rollouts"},
    {"scenario", "report"},
    {"validation"},
    {"comparison", "choice"},
    {"front_validation", "job_validation"},
    {"sweeps", "calibrations", "pictures"},
    {"traces", "policies", "learning", "mobile"},
    {"failbench"},
    {"commands"},
    {"testing", "cli"},
)

HEAVY = (
    "scipy",
    "toppra",
    "ompl",
    "mink",
    "casadi",
    "fcl",
    "matplotlib",
    "qpsolvers",
    "pyarrow",
    "ray",
    "PIL",
    "viser",
    "gymnasium",
)


def module_name(file: Path) -> str:
    """Return the module name of a file: planners/trees/trrt.py is graceful_plan.planners.trees.trrt."""
    root = LIBRARY if file.is_relative_to(LIBRARY) else HARNESS
    return ".".join([root.name, *file.relative_to(root).with_suffix("").parts]).removesuffix(".__init__")


MODULES = {module_name(file): file for file in FILES + HARNESS_FILES}


@cache
def syntax_of(file: Path) -> ast.Module:
    """Parse a file, once."""
    return ast.parse(file.read_text())


def statements(tree: ast.AST) -> Iterator[ast.stmt]:
    """Yield all statements, without their expressions: `ast.walk` takes ten times as long."""
    for block in ("body", "orelse", "handlers", "finalbody", "cases"):
        for node in getattr(tree, block, ()):
            if isinstance(node, ast.stmt):
                yield node
            yield from statements(node)


def imports(tree: ast.Module) -> Iterator[str]:
    """Yield the full name of every import, also for types and inside functions."""
    for node in statements(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0 and node.module, "imports are absolute"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def imported_modules(name: str) -> set[str]:
    """Return the modules of both packages that a module imports; a name in a module stands for the module."""
    found = set()
    for full in imports(syntax_of(MODULES[name])):
        parts = full.split(".")
        known = [".".join(parts[:n]) for n in range(len(parts), 0, -1) if ".".join(parts[:n]) in MODULES]
        found.update(known[:1])
    return found - {name}


@cache
def all_imports() -> dict[str, set[str]]:
    """Return the imports of each module; on demand, since not every test process needs to parse all files."""
    return {name: imported_modules(name) for name in MODULES}


def room(module: str) -> str:
    """Return the package below the root to which a module belongs; it may be the module itself."""
    package, *rest = module.split(".")
    return package if not rest else "basics" if rest[0] in BASICS and package == LIBRARY.name else rest[0]


def above(package: str, floors: tuple[set[str], ...]) -> list[str]:
    """List imports within a package that lead to the same floor or upwards."""
    floor = {name: i for i, names in enumerate(floors) for name in names}
    return [
        f"{module} imports {other}"
        for module, others in all_imports().items()
        for other in others
        if module.split(".")[0] == other.split(".")[0] == package
        and room(module) != room(other)
        and floor[room(other)] >= floor[room(module)]
    ]


def circles() -> list[set[str]]:
    """Return groups of modules that import each other, directly or not (Tarjan's strong components)."""
    order: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found = []

    def visit(module: str) -> None:
        order[module] = low[module] = len(order)
        stack.append(module)
        for other in all_imports()[module]:
            if other not in order:
                visit(other)
            if other in stack:
                low[module] = min(low[module], low[other])
        if low[module] == order[module]:
            start = stack.index(module)
            found.append(set(stack[start:]))
            del stack[start:]

    for module in MODULES:
        if module not in order:
            visit(module)
    return [group for group in found if len(group) > 1]


@pytest.mark.parametrize(("package", "floors"), [("graceful_plan", FLOORS), ("failbench", HARNESS_FLOORS)])
def test_rooms_use_lower_floors_only(package, floors):
    assert not above(package, floors)


@pytest.mark.parametrize(("package", "floors"), [("graceful_plan", FLOORS), ("failbench", HARNESS_FLOORS)])
def test_every_module_is_on_a_floor_and_every_room_exists(package, floors):
    rooms = {room(module) for module in MODULES if module.split(".")[0] == package}
    named = [name for names in floors for name in names]
    assert len(named) == len(set(named)) and rooms | {"basics"} == set(named) | {"basics"}


def test_no_module_imports_itself_through_others():
    assert circles() == []


def test_circles_are_found(monkeypatch):
    known = all_imports()
    monkeypatch.setitem(known, "graceful_plan.path", known["graceful_plan.path"] | {"graceful_plan.result"})
    assert any({"graceful_plan.path", "graceful_plan.result"} <= group for group in circles())


def test_an_import_upwards_is_found(monkeypatch):
    monkeypatch.setitem(all_imports(), "graceful_plan.scene.roles", {"graceful_plan.core.compile"})
    assert above("graceful_plan", FLOORS) == ["graceful_plan.scene.roles imports graceful_plan.core.compile"]


def test_no_module_has_the_name_of_a_public_function():
    functions = {
        (package.__name__, name)
        for package in (gp, failbench)
        for name in package.__all__
        if inspect.isfunction(getattr(package, name))
    }
    shared = {(m.split(".")[0], m.split(".")[-1]) for m in MODULES} & functions
    assert shared == {("graceful_plan", "plan")}  # plan.py tells the steps of a query


def test_the_judge_shares_nothing_with_the_planners():
    judges = [module for module in MODULES if room(module) == "judge"]
    seen, queue = set(judges), list(judges)
    while queue:
        new = all_imports()[queue.pop()] - seen
        seen |= new
        queue += new
    assert judges and not {room(module) for module in seen} & {"core", "costs", "planners", "plan", "query", "mobile"}


def test_no_class_name_stands_twice():
    names = Counter(
        node.name
        for file in FILES + HARNESS_FILES
        for node in statements(syntax_of(file))
        if isinstance(node, ast.ClassDef)
    )
    assert not {name for name, n in names.items() if n > 1}


def test_library_never_imports_what_is_built_on_it():
    roots = {name.split(".")[0] for file in FILES for name in imports(syntax_of(file))}
    assert "numpy" in roots
    assert not roots & {"failbench", "benchmarks", "tests", "examples"}


def test_the_harness_uses_what_is_public_and_nothing_above_it():
    names = {name for file in HARNESS_FILES for name in imports(syntax_of(file))}
    assert not {name for name in names if name.startswith("graceful_plan") and "._" in name}
    assert not {name.split(".")[0] for name in names} & {"benchmarks", "tests", "examples"}


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


@pytest.mark.parametrize("root", [LIBRARY, HARNESS], ids=["library", "harness"])
def test_types_are_for_users_too(root):
    assert (root / "py.typed").read_bytes() == b""


def test_every_python_that_is_supported_gets_a_wheel():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    words = [word.rsplit(" ", 1)[1] for word in project["project"]["classifiers"] if "Python :: 3." in word]
    versions = sorted(tuple(map(int, word.split("."))) for word in words)
    built = sorted((3, int(name[3:-2])) for name in project["tool"]["cibuildwheel"]["build"])
    stable = (3, int(project["tool"]["scikit-build"]["wheel"]["py-api"][3:]))
    assert built[0] == versions[0] and built[-1] == stable  # packages in between have their own; newer ones share one
    assert built == [version for version in versions if version <= stable]


def field_tables() -> list[type]:
    modules = (arrays, elements, robot, simulation, world, execution)
    classes = [cls for module in modules for _, cls in inspect.getmembers(module, dataclasses.is_dataclass)]
    classes += [Explanation, ImpactMap]  # their modules have the names of functions of the package
    return list(dict.fromkeys(cls for cls in classes if "| field" in (cls.__doc__ or "")))


def test_every_table_of_arrays_is_found():
    assert {cls.__name__ for cls in field_tables()} >= {"RobotArrays", "WorldArrays", "ImpactArrays", "Limits"}


@pytest.mark.parametrize("cls", field_tables(), ids=lambda cls: cls.__name__)
def test_field_tables_list_the_fields(cls):
    rows = re.findall(r"^\s*\| (\w+) ", inspect.getdoc(cls) or "", flags=re.MULTILINE)
    assert rows == ["field", *(field.name for field in dataclasses.fields(cls))]


def readme_snippets() -> list[str]:
    return re.findall(r"^```python\n(.*?)^```", (ROOT / "README.md").read_text(), flags=re.MULTILINE | re.DOTALL)


def test_readme_has_snippets():
    assert readme_snippets()


@pytest.fixture
def counted(monkeypatch):
    """Replace the time limits of `plan` calls in documents by iterations: the machine may be busy."""

    def plan(*args, **kwargs):
        return real(*args, **(kwargs if "time_limit" in kwargs else {"iterations": 300, **kwargs}))

    real = gp.plan
    monkeypatch.setattr(gp, "plan", plan)


@pytest.mark.usefixtures("counted")
@pytest.mark.parametrize("snippet", readme_snippets())
def test_readme_snippet_runs(snippet, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(compile(snippet, "README.md", "exec"), {})


def guide_snippets(guide: str) -> list[str]:
    return re.findall(r"^```python\n(.*?)^```", (ROOT / "docs" / guide).read_text(), flags=re.MULTILINE | re.DOTALL)


ELSEWHERE = {
    "annotate.md": "annotation/test_asking.py",
    "datasets.md": "failbench/sweeps/test_dataset.py",
    "explain.md": "analysis/test_explanation.py",
    "problem-files.md": "compare/problems/test_problem_files.py",
    "risk.md": "analysis/test_risk_measures.py",
    "viewer.md": "viewer/browser/test_browser.py",
}
"""Guides whose snippets need files, long budgets or an extra, and the tests that run them."""
GUIDES = sorted(
    file.name for file in (ROOT / "docs").glob("*.md") if guide_snippets(file.name) and file.name not in ELSEWHERE
)


def test_snippets_of_all_guides_are_run():
    assert len(GUIDES) > 20
    assert all(guide in (ROOT / "tests" / test).read_text() for guide, test in ELSEWHERE.items())


@pytest.mark.long
@pytest.mark.usefixtures("counted")
@pytest.mark.parametrize("guide", GUIDES)
def test_guides_run(guide, tmp_path, monkeypatch):
    (tmp_path / "faults.yaml").write_text("version: 1\npresets: {mine: {weak_grip: 2, dropout: 1}}\n")
    monkeypatch.chdir(tmp_path)
    task = gp.load_scene("tabletop_l1").tasks["green_to_blue"]
    known = {"gp": gp, "task": task, "start": task.start, "goal": task.goal, "scene": task.scene}
    snippets = guide_snippets(guide)
    assert snippets
    exec(compile("\n".join(snippets), guide, "exec"), known)


def dotted_names() -> list[tuple[str, str]]:
    """List the attributes graceful_plan.x and failbench.x.y in documents, each with its document, except file names."""
    found = set()
    for file in (ROOT / "README.md", *(ROOT / "docs").glob("*.md")):
        for name in re.findall(r"(?<![\w./-])(?:graceful_plan|failbench)(?:\.[A-Za-z_]\w*)+", file.read_text()):
            if not name.endswith((".md", ".yaml")):
                found.add((file.name, name))
    return sorted(found)


def test_documents_have_dotted_names():
    assert ("faults.md", "failbench.fault.registry") in dotted_names()


def test_names_in_documents_can_be_imported():
    words = {
        word
        for file in FILES + HARNESS_FILES
        for found in re.findall(r'"schema": "(\w+\.\w+)"|SCHEMA\b.* = "(\w+\.\w+)"', file.read_text())
        for word in found
    }
    unknown = []
    for document, name in dotted_names():
        try:
            pkgutil.resolve_name(name)
        except (ImportError, AttributeError):
            if name not in words:
                unknown.append(f"{document}: {name}")
    assert unknown == []
