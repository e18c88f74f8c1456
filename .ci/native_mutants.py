"""Apply the edits of `native_edits.py` to the native core, one at a time, and check whether tests fail.

python .ci/native_mutants.py [--journal FILE] [--minutes M] [--only TEXT] [--place FOLDER]

All edits are compiled together, for the baseline instruction set only: an environment variable selects between each
original expression and its edit. So the core is compiled once instead of a hundred times.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from mutated import ROOT, copied, report, tests_pass
from native_edits import EDITS

NATIVE = Path("src/graceful_plan/core/native")
VARIABLE = "GP_MUTANT"
CHOICE = f"""#pragma once
#include <cstdlib>
inline const int gp_mutant = [] {{
  const char* chosen = std::getenv("{VARIABLE}");
  return chosen ? std::atoi(chosen) : -1;
}}();
"""


@dataclass(frozen=True)
class Edit:
    """Replacement of an expression in a file."""

    number: int
    file: str
    before: str
    after: str
    tests: tuple[str, ...]

    def entered(self, text: str) -> str:
        """Return the text of the file with a run-time choice in place of the expression.

        A sign before the expression is part of it, so `a - b` can become `a + b`.
        """
        begin, rest = self.before.split("«")
        old, end = rest.split("»")
        if text.count(begin + old + end) != 1:
            raise SystemExit(f"{self.file} has this {text.count(begin + old + end)} times: {begin + old + end}")
        sign = "+ " if old[:2] in ("+ ", "- ") else ""
        choice = f"{sign}(gp_mutant == {self.number} ? ({self.after}) : ({old}))"
        return text.replace(begin + old + end, begin + choice + end)


def edits() -> Iterator[Edit]:
    """Yield all edits with their numbers."""
    number = 0
    for file, (tests, some) in EDITS.items():
        for before, after in some:
            yield Edit(number, file, before, after, tests)
            number += 1


def built(place: Path) -> None:
    """Apply all edits to a copy of the tree, compile it, and install the module in the copy."""
    for edit in edits():
        file = place / NATIVE / edit.file
        file.write_text(edit.entered(file.read_text(encoding="utf-8")), encoding="utf-8")
    chosen = place / "choice.hpp"
    chosen.write_text(CHOICE, encoding="utf-8")
    out = place / "built"
    defined = (f"Python_EXECUTABLE={sys.executable}", f"CMAKE_CXX_FLAGS=-include {chosen}")
    options = ["-G", "Ninja", *(f"-D{one}" for one in ("GP_QUICK=ON", "GP_OPTIMISE=-O1", *defined))]
    subprocess.run(["cmake", "-S", place, "-B", out, *options], check=True, stdout=subprocess.DEVNULL)
    subprocess.run(["cmake", "--build", out, "--parallel", "1", "--target", "_native"], check=True)
    (native,) = out.glob("_native*.so")
    (old,) = (place / "src/graceful_plan/core").glob("_native*.so")
    os.replace(native, old)


def main() -> int:
    """Test edits and print the detected share and the survivors."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=1e9, help="begin no further edit after this time")
    parser.add_argument("--only", default="", help="only edits of files whose names contain this")
    parser.add_argument("--place", type=Path, help="folder for the compiled copy, which is reused")
    parser.add_argument("--journal", type=Path, default=ROOT / "build" / "native_mutants.jsonl")
    args = parser.parse_args()
    end = time.monotonic() + 60.0 * args.minutes
    args.journal.parent.mkdir(exist_ok=True)
    args.journal.touch()
    results = [json.loads(line) for line in args.journal.open()]
    known = {(result["module"], result["before"]) for result in results}
    with tempfile.TemporaryDirectory() as scratch:
        place = args.place or Path(scratch)
        if not (place / "built").exists():
            built(copied(place))
        for tests in sorted({tests for tests, _ in EDITS.values()}):
            if not (found := tests_pass(place, tests))[0]:
                raise SystemExit(f"{tests} fail as it is: {found[1]}")
        for edit in edits():
            if (edit.file, edit.before) in known or args.only not in edit.file or time.monotonic() > end:
                continue
            survived, reason = tests_pass(place, edit.tests, **{VARIABLE: str(edit.number)})
            result = {"module": edit.file, "before": edit.before, "after": edit.after}
            results.append({**result, "survived": survived, "said": reason, "line": 0})
            with args.journal.open("a") as out:
                out.write(json.dumps(results[-1]) + "\n")
    return report(results)


if __name__ == "__main__":
    main()
