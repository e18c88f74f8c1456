"""Names that are imported on first access behave like ordinary attributes of the package."""

import importlib
import inspect
import subprocess
import sys

import pytest

import failbench
import graceful_plan as gp
from graceful_plan import lazy_imports

PACKAGES = (gp, failbench)
names = pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.__name__)


def fresh(code):
    """Run code in a new process and return the words that it prints."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.stderr, done.returncode) == ("", 0)
    return done.stdout.split()


@names
def test_every_name_is_that_of_its_module(package):
    for name in package.__all__:
        value = getattr(package, name)
        home = importlib.import_module(package._homes[name])
        assert value is (home if inspect.ismodule(value) else getattr(home, name))


@names
def test_packages_list_exactly_their_names(package):
    assert set(package.__all__) <= set(dir(package))
    assert not hasattr(package, "plam")
    with pytest.raises(AttributeError, match=f"'{package.__name__}'.*'plam'") as caught:
        _ = package.plam
    assert (caught.value.name, caught.value.obj) == ("plam", package)


@pytest.mark.parametrize("first", ["import graceful_plan.plan", "from graceful_plan import *"])
def test_the_module_plan_never_hides_the_function(first):
    """Whether the module is imported by name or by other modules."""
    code = f"{first}\nimport graceful_plan as gp, graceful_plan.plan\nprint(callable(gp.plan), gp.plan.__module__)"
    assert fresh(code) == ["True", "graceful_plan.plan"]


def test_importing_and_the_version_need_no_slow_imports():
    code = """
import sys, graceful_plan, failbench, graceful_plan.tools.cli, failbench.cli
for program in (graceful_plan.tools.cli, failbench.cli):
    try:
        program.main(["--version"])
    except SystemExit as end:
        print(end.code, *{"numpy", "mujoco", "yaml"} & set(sys.modules))
"""
    assert fresh(code) == [gp.__version__, "0"] * 2


def test_planning_imports_only_what_it_needs():
    code = "import sys, graceful_plan as gp\ngp.plan, gp.load_scene\nprint(*sys.modules)"
    rooms = {name.split(".")[1] for name in fresh(code) if name.startswith("graceful_plan.")}
    assert "query" in rooms and not rooms & {"compare", "roadmap", "testing", "tools", "tuning", "viewer", "viz"}


def test_other_packages_can_use_lazy_imports(tmp_path, monkeypatch):
    folder = tmp_path / "lazy_one"
    folder.mkdir()
    (folder / "__init__.py").write_text("from graceful_plan import lazy_imports\nlazy_imports.install(__name__)\n")
    (folder / "__init__.pyi").write_text(
        "from lazy_one import parts as parts\nfrom lazy_one.lift import lift as lift\n"
    )
    (folder / "lift.py").write_text("def lift(): return 1\n")
    (folder / "parts.py").write_text("HEIGHT = 2\n")
    monkeypatch.syspath_prepend(tmp_path)
    lazy = importlib.import_module("lazy_one")
    assert isinstance(lazy, lazy_imports.LazyPackage)
    assert lazy.__all__ == ["lift", "parts"]
    assert (lazy.parts.HEIGHT, lazy.lift()) == (2, 1)
    monkeypatch.setattr(lazy, "lift", len)  # a replacement by a test stays
    assert lazy.lift is len


@pytest.mark.long
def test_type_checkers_know_the_names_and_refuse_others(tmp_path):
    file = tmp_path / "robot_code.py"
    file.write_text("import graceful_plan as gp\n\nreveal_type(gp.load_scene)\ngp.plam\n")
    checker = [sys.executable, "-m", "basedpyright", str(file)]
    said = subprocess.run(checker, capture_output=True, text=True, check=False).stdout
    assert 'Type of "gp.load_scene" is "(name_or_path: str | Path) -> Scene"' in said
    assert '"plam" is not a known attribute of module "graceful_plan"' in said


@pytest.mark.long
def test_planning_for_a_base_imports_its_planners_before_the_clock_runs():
    code = """
import sys, time, types
sys.path.insert(0, "tests")
import graceful_plan as gp
from hall import hall
plan, scene, known = gp.plan, hall(), []
def perf_counter():
    known.append(set(sys.modules))
    return time.perf_counter()
sys.modules["graceful_plan.plan"].time = types.SimpleNamespace(perf_counter=perf_counter)
plan("west", "east", scene, w=0.0, iterations=1)
slow = tuple(f"graceful_plan.mobile.{room}" for room in ("query", "planners", "floor"))
print(*(name for name in set(sys.modules) - known[0] if name.startswith(slow)))
"""
    assert fresh(code) == []
