"""Copies of the tree for mutants: make one, run its tests, report survivors."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).parents[1]
LIMIT = 120
"""Processor time for the tests of one mutant [s]; a longer run counts as detected."""
PATIENCE = 1800
"""Wall-clock time for the tests of one mutant [s], for runs that only wait."""


def copied(place: Path) -> Path:
    """Copy the files that git tracks and the installed native modules."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True, text=True).stdout
    for name in filter(None, listed.split("\0")):
        if (ROOT / name).is_file():
            (place / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, place / name)
    for package, module in (("core", "_native"), ("judge", "_pendulum")):
        folder = Path("graceful_plan", package)
        (native,) = (Path(sysconfig.get_path("platlib")) / folder).glob(f"{module}*")
        shutil.copy(native, place / "src" / folder)
    return place


def tests_pass(place: Path, tests: Sequence[str], **variables: str) -> tuple[bool, str]:
    """Run tests in a copy with additional environment variables; return whether they pass, and the first failure."""
    # Without site: the importer of the editable install would take precedence over the copy.
    paths = (place / "src", place / "sim", sysconfig.get_path("platlib"))
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(map(str, paths)),
        "OPENBLAS_NUM_THREADS": "1",
        **variables,
    }
    options = ["-q", "-x", "-m", "not long", "-p", "no:cacheprovider", "-p", "no:xdist"]
    limited = ["sh", "-c", f'ulimit -t {LIMIT}; exec "$@"', "sh"]
    command = [*limited, sys.executable, "-S", "-m", "pytest", *options, *tests]
    try:
        run = subprocess.run(
            command, cwd=place, env=environment, capture_output=True, text=True, timeout=PATIENCE, check=False
        )
    except subprocess.TimeoutExpired:
        return False, f"took more than {PATIENCE} s"
    failures = [line for line in run.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return run.returncode == 0, (failures or run.stdout.splitlines()[-1:] or [run.stderr[-200:]])[0][:200]


def report(results: Sequence[dict[str, object]]) -> int:
    """Print scores and survivors; return how many survived."""
    survivors = [result for result in results if result["survived"]]
    total, left = (Counter(str(result["module"]) for result in some) for some in (results, survivors))
    for module, count in total.items():
        print(f"{module}: {count - left[module]} of {count} noticed")
    for result in survivors:
        print(f"{result['module']}:{result['line']}: {result['before']}  ->  {result['after']}")
    print(f"{len(results) - len(survivors)} of {len(results)} mutants noticed")
    return len(survivors)
