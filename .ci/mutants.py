"""Mutate the Python code in one place at a time and check whether tests fail.

python .ci/mutants.py [--each N] [--seed S] [--module NAME ...] [--processes N] [--minutes M] [--journal FILE]

Draws N mutants of cosmic-ray for each module below and runs the module's tests on each, in a copy of the tree. Results
are appended to a journal of JSON lines, so an interrupted run resumes; delete the journal after a change of the code.
Annotations are not mutated, because they have no effect at run time.
"""

from __future__ import annotations

import argparse
import ast
import json
import random
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from itertools import zip_longest
from pathlib import Path
from queue import SimpleQueue

import cosmic_ray.plugins
from cosmic_ray.ast import ast_nodes, get_ast_from_path
from cosmic_ray.mutating import apply_mutation
from mutated import ROOT, copied, report, tests_pass

LIBRARY = "src/graceful_plan"
MODULES = {
    "costs/objective.py": (
        "tests/costs/test_costs.py",
        "tests/costs/test_slopes.py",
        "tests/costs/test_own_loss.py",
        "tests/planners/optimisers/test_edge_derivatives.py",
    ),
    "timing/retiming.py": ("tests/timing/test_retiming.py",),
    "timing/trajectory.py": ("tests/timing/test_trajectory.py", "tests/formats/test_formats.py"),
    "costs/breakdown.py": ("tests/costs/test_costs.py", "tests/costs/test_own_loss.py"),
    "judge/verification.py": ("tests/judge/test_verification.py", "tests/judge/test_passing.py"),
    "judge/limit_checks.py": ("tests/judge/test_verification.py", "tests/judge/test_passing.py"),
    "judge/exact.py": (
        "tests/judge/test_verification.py",
        "tests/judge/test_clearance_proof.py",
        "tests/scene/test_contacts.py",
    ),
    "judge/motion_samples.py": ("tests/judge",),
    "judge/passing.py": ("tests/judge/test_passing.py", "tests/scene/test_moving.py"),
    "analysis/certificate.py": ("tests/analysis/test_certificate.py", "tests/analysis/test_certified_clearance.py"),
    "query/endpoints/usable.py": ("tests/query/endpoints/test_goals.py",),
    "query/endpoints/goals.py": (
        "tests/query/endpoints/test_goals.py",
        "tests/query/endpoints/test_pose_sets.py",
        "tests/query/endpoints/test_ik.py",
        "tests/query/test_cancel.py",
        "tests/mobile/motions/test_drives.py",
    ),
    "scene/scene.py": (
        "tests/scene/test_scene.py",
        "tests/scene/test_edit.py",
        "tests/scene/loading/test_naming.py",
        "tests/scene/urdf",
    ),
    "scene/assembly.py": ("tests/scene/test_scene.py", "tests/scene/test_edit.py", "tests/scene/loading/test_file.py"),
    "scene/changes.py": ("tests/scene/test_scene.py", "tests/scene/test_edit.py", "tests/scene/loading/test_naming.py"),
    "scene/screening.py": ("tests/scene/test_screening.py",),
    "scene/specs.py": ("tests/scene/test_screening.py",),
}
"""Modules on which verdicts depend, and their tests."""


@dataclass(frozen=True)
class Mutant:
    """One change: an operator of cosmic-ray and the index of the place to which it applies."""

    module: str
    operator: str
    occurrence: int
    line: int


def mutants_of(module: str) -> Iterator[Mutant]:
    """Yield every mutant of a module outside of annotations and docstrings."""
    file = ROOT / LIBRARY / module
    left_out = annotated_lines(ast.parse(file.read_text(encoding="utf-8")))
    tree = get_ast_from_path(file)
    for name in sorted(cosmic_ray.plugins.operator_names()):
        kind = cosmic_ray.plugins.get_operator(name)
        if kind.arguments():
            continue
        operator = kind()
        places = (place for node in ast_nodes(tree) for place in operator.mutation_positions(node))
        for occurrence, ((line, column), _) in enumerate(places):
            if (line, column) not in left_out:
                yield Mutant(module, name, occurrence, line)


class Places(set[tuple[int, int]]):
    """Positions in a text, as line and column."""

    def add_all(self, node: ast.expr | None) -> None:
        """Add every position of an expression."""
        if node is not None and node.end_lineno is not None and node.end_col_offset is not None:
            for line in range(node.lineno, node.end_lineno + 1):
                first = node.col_offset if line == node.lineno else 0
                last = node.end_col_offset if line == node.end_lineno else 200
                self.update((line, column) for column in range(first, last))


def annotated_lines(tree: ast.Module) -> Places:
    """Return the positions of annotations."""
    found = Places()
    for node in ast.walk(tree):
        if isinstance(node, ast.arg | ast.AnnAssign):
            found.add_all(node.annotation)
        elif isinstance(node, ast.FunctionDef):
            found.add_all(node.returns)
    return found


# --- testing ---------------------------------------------------------------------------------------------------------


def tried(mutant: Mutant, place: Path) -> dict[str, object]:
    """Test a mutant in a copy of the tree, then restore the file."""
    file = place / LIBRARY / mutant.module
    original = file.read_text(encoding="utf-8")
    try:
        _, text = apply_mutation(file, cosmic_ray.plugins.get_operator(mutant.operator)(), mutant.occurrence)
        before, after = next(
            (a, b) for a, b in zip(original.splitlines(), str(text).splitlines(), strict=False) if a != b
        )
        survived, reason = tests_pass(place, MODULES[mutant.module])
    finally:
        file.write_text(original, encoding="utf-8")
    return {**asdict(mutant), "survived": survived, "said": reason, "before": before.strip(), "after": after.strip()}


def drawn(modules: Sequence[str], each: int, seed: int) -> Iterator[Mutant]:
    """Draw mutants from the modules in turn, so an interrupted run has covered all modules."""
    samples = []
    for module in modules:
        every = list(mutants_of(module))
        samples.append(random.Random(seed).sample(every, min(each, len(every))))
    for turn in zip_longest(*samples):
        yield from filter(None, turn)


def key_of(result: Mapping[str, object]) -> tuple[object, ...]:
    """Return the key that identifies a mutant."""
    return result["module"], result["operator"], result["occurrence"]


def main() -> int:
    """Test mutants and print the detected share and the survivors."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--each", type=int, default=20, help="mutants of each module")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--module", nargs="*", default=list(MODULES), choices=list(MODULES), metavar="NAME")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--minutes", type=float, default=1e9, help="begin no further mutant after this time")
    parser.add_argument("--journal", type=Path, default=ROOT / "build" / "mutants.jsonl")
    args = parser.parse_args()
    end = time.monotonic() + 60.0 * args.minutes
    args.journal.parent.mkdir(exist_ok=True)
    args.journal.touch()
    known = {key_of(result): result for result in map(json.loads, args.journal.open())}
    results, todo = [], []
    for mutant in drawn(args.module, args.each, args.seed):
        (results if key_of(asdict(mutant)) in known else todo).append(known.get(key_of(asdict(mutant)), mutant))
    with tempfile.TemporaryDirectory() as scratch, ThreadPoolExecutor(args.processes) as pool:
        free: SimpleQueue[Path] = SimpleQueue()
        for i in range(args.processes if todo else 0):
            free.put(copied(Path(scratch) / str(i)))
        for module in {mutant.module for mutant in todo} - {result["module"] for result in known.values()}:
            if not (found := tests_pass(Path(scratch) / "0", MODULES[module]))[0]:
                raise SystemExit(f"tests of {module} fail as it is: {found[1]}")

        def attempt(mutant: Mutant) -> dict[str, object] | None:
            place = free.get()
            try:
                return tried(mutant, place) if time.monotonic() < end else None
            finally:
                free.put(place)

        for result in filter(None, pool.map(attempt, todo)):
            results.append(result)
            with args.journal.open("a") as out:
                out.write(json.dumps(result) + "\n")
    return report(results)


if __name__ == "__main__":
    main()
