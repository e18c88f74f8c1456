"""Headers of the native core: each compiles alone and is in the library's namespace; only bindings use nanobind."""

import os
import re
import shutil
import subprocess
import sysconfig
from pathlib import Path

import nanobind
import pytest

ROOT = Path(__file__).parents[2]
NATIVE = ROOT / "src" / "graceful_plan" / "core" / "native"
HEADERS = sorted(path.relative_to(NATIVE).as_posix() for path in NATIVE.rglob("*.hpp"))
_COMPILER = shutil.which(os.environ.get("CXX", "c++"))


def _warnings() -> list[str]:
    (flags,) = re.findall(r"set\(GP_WARNINGS ([^)]*)\)", (ROOT / "CMakeLists.txt").read_text(encoding="utf-8"))
    return flags.split()


def test_there_are_headers():
    assert len(HEADERS) > 80


@pytest.mark.parametrize("name", HEADERS)
def test_a_header_has_a_guard_and_a_namespace(name: str):
    text = (NATIVE / name).read_text(encoding="utf-8")
    assert text.count("#pragma once") == 1
    if name != "target.hpp":  # contains only macros
        assert re.search(r"^namespace gp\b", text, re.MULTILINE)


def test_nanobind_is_in_the_bindings_alone():
    sources = [path for path in NATIVE.rglob("*.[ch]pp") if path.parent.name != "bindings"]
    assert sources
    users = [path.name for path in sources if re.search(r"nanobind|\bnb::", path.read_text(encoding="utf-8"))]
    assert users == []


@pytest.mark.long
@pytest.mark.skipif(_COMPILER is None, reason="no C++ compiler")
@pytest.mark.parametrize("name", HEADERS)
def test_a_header_compiles_alone(name: str):
    includes = (NATIVE, Path(nanobind.include_dir()), Path(sysconfig.get_path("include")))
    # Functions of a header are unused in this translation unit.
    flags = ["-std=c++20", "-fsyntax-only", "-fvisibility=hidden", *_warnings(), "-Werror", "-Wno-unused-function"]
    command = [str(_COMPILER), *flags, "-I", str(includes[0])]
    for folder in includes[1:]:
        command += ["-isystem", str(folder)]
    unit = f'#include "{name}"\n#include "{name}"\n'
    done = subprocess.run([*command, "-x", "c++", "-"], input=unit, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
