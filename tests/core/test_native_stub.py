"""The stubs of the native modules match the modules: the same names with the same parameters."""

import ast
import re
from pathlib import Path
from types import ModuleType

import pytest
from places import LIBRARY

from graceful_plan.core import _native
from graceful_plan.judge import _pendulum

STUBS = {_native: LIBRARY / "core" / "_native.pyi", _pendulum: LIBRARY / "judge" / "_pendulum.pyi"}
Parameters = tuple[list[str], list[str]]
"""Names of positional parameters, and of keyword-only parameters."""


def stated(stub: Path) -> dict[str, Parameters | None]:
    """Return the parameters of every function and method in a stub, None for a property or a class."""
    found: dict[str, Parameters | None] = {}
    for node in ast.parse(stub.read_text()).body:
        if isinstance(node, ast.FunctionDef):
            found[node.name] = of_node(node)
        if isinstance(node, ast.ClassDef) and "TypedDict" not in map(ast.unparse, node.bases):
            found[node.name] = None
            for member in node.body:
                if isinstance(member, ast.FunctionDef):
                    found[f"{node.name}.{member.name}"] = None if member.decorator_list else of_node(member)
    return found


def of_node(node: ast.FunctionDef) -> Parameters:
    return [a.arg for a in node.args.args], [a.arg for a in node.args.kwonlyargs]


def native(module: ModuleType) -> dict[str, Parameters | None]:
    """Return the parameters of every function and method in a module, None for a property or a class."""
    found: dict[str, Parameters | None] = {}
    for name, thing in vars(module).items():
        if name.startswith("__"):
            continue
        if not isinstance(thing, type):
            found[name] = of_signature(thing)
            continue
        found[name] = None
        for member, value in vars(thing).items():
            if isinstance(value, property):
                found[f"{name}.{member}"] = None
            elif hasattr(value, "__nb_signature__"):
                found[f"{name}.{member}"] = of_signature(value)
    return found


def of_signature(function: object) -> Parameters:
    ((text, *_),) = function.__nb_signature__  # pyright: ignore[reportAttributeAccessIssue]
    inside = re.sub(r"\[[^\[\]]*\]", "", text.partition("(")[2].rpartition(") ->")[0])
    by_position, _, by_name = inside.partition("*, ")
    names = [re.findall(r"(?:^|, )(\w+)", part) for part in (by_position, by_name)]
    return names[0], names[1]


@pytest.mark.parametrize(("module", "least"), [(_native, 50), (_pendulum, 0)])
def test_the_stub_matches_the_module(module: ModuleType, least: int):
    assert len(native(module)) > least
    assert stated(STUBS[module]) == native(module)
