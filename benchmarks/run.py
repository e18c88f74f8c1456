"""Run benchmarks and print a Markdown document for each; `--write` writes it to results/ and updates the index.

python benchmarks/run.py [subject ...] [--quick | --long] [--write] [--commit HASH] [--processes N] [--seconds S]
python benchmarks/run.py --stale
"""

from __future__ import annotations

import argparse
import importlib
import os
import re
import subprocess
import sys
import time
import traceback
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from benchmarks import planning, report, same_code, suite  # noqa: E402 - the import path is set above
from graceful_plan.compare.runs import machine  # noqa: E402

SUBJECTS = (
    "kernels",
    "safety",
    "first_motion",
    "real_tasks",
    "inverse_kinematics",
    "motion_problems",
    "takeovers",
    "robots",
    "constraints",
    "planners",
    "auto",
    "tuning",
    "paper_table",
    "drop_prediction",
    "failure_prediction",
    "own_loss",
    "jobs",
    "prevention",
    "policies",
    "stops",
    "driven_tasks",
    "mobile_prevention",
    "failbench_speed",
    "libero",
)
"""In the order of the index. Each is a module of `benchmarks.subjects` with TITLE, QUESTION, HEADLINE, DEPENDS_ON and
run(options)."""
APART = ("libero",)
"""Subjects that only run when they are named; they need packages in a separate environment."""
_SHORT = 8
"""Digits of a commit in the results."""
_BEST_KNOWN = "benchmarks/best_known/"
_REFERENCE = re.compile(r"^\| (\w+/\w+) \| ([\d.]+) \|", flags=re.MULTILINE)  # task and "best known J" of a table
_ROUNDED = 1e-4
"""Relative tolerance of a best-known J in a table, which has five digits."""


def main(arguments: list[str] | None = None) -> int:
    """Run subjects and return the number of those that raised."""
    parser = _parser()
    args = parser.parse_args(arguments)
    if args.stale:
        for name, reason in stale():
            print(f"{name}: {reason}")
        return 0
    if args.quick and (args.write or args.long):
        parser.error("--quick: its figures mean little; leave out --write and --long")
    here = _head()
    if args.commit and here is not None and here != args.commit[: len(here)]:
        parser.error(f"--commit {args.commit}: this repository is at {here}; leave out --commit")
    if args.write and here is None and not args.commit:
        parser.error("--write: without git the commit of the code is unknown; name it by --commit HASH")
    options = suite.Options(
        quick=args.quick,
        long=args.long,
        processes=args.processes,
        seconds=args.seconds,
        calls=args.calls,
        tasks=tuple(args.tasks or ("*",)),
        drops=args.drops,
        mixed=args.mixed,
        weights=tuple(args.weights) if args.weights else None,
        bound=args.bound,
    )
    # For child processes: threads of linear algebra would compete with the processes.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    print(machine.described())
    failed = 0
    for name in args.subjects or [name for name in SUBJECTS if name not in APART]:
        try:
            text = measured(name, options, arguments, named=args.commit)
        except report.NotMeasured as reason:
            print(f"\n{name} is not measured: {reason}", flush=True)
            continue
        except Exception:
            failed += 1
            traceback.print_exc()
            continue
        print(f"\n{text}", flush=True)
        if args.write:
            write(name + ("_bound" if args.bound else "") + ("_long" if args.long else ""), text)
    return failed


def measured(name: str, options: suite.Options, arguments: list[str] | None, *, named: str | None = None) -> str:
    """Run one subject and return the text of its result file; `named` is the commit of code without a repository."""
    subject = module(name)
    commit, load, started = _commit(paths_of(name), named), os.getloadavg()[0], time.perf_counter()
    body = subject.run(options)
    seconds = time.perf_counter() - started
    head = report.Head(
        commit=commit,
        date=f"{datetime.now(UTC):%Y-%m-%d}",
        command=" ".join(["python benchmarks/run.py", *(sys.argv[1:] if arguments is None else arguments)]),
        duration=f"{seconds:.0f} s, load average {load:.1f} before the run",
        machine=machine.described(),
    )
    quick = "**Quick run: too small for meaningful figures.**\n\n" if options.quick else ""
    return report.document(subject.TITLE, subject.QUESTION, head, quick + body)


def write(name: str, text: str) -> None:
    """Write a result file and renew the index."""
    report.file_of(name).write_text(text, encoding="utf-8")
    report.INDEX.write_text(index(), encoding="utf-8")


def index() -> str:
    """Return the index of the result files that exist."""
    rows = {}
    for name in SUBJECTS:
        file, subject = report.file_of(name), module(name)
        if file.exists():
            text = file.read_text(encoding="utf-8")
            rows[name] = report.index_row(name, subject.QUESTION, subject.HEADLINE, text)
    return report.index(rows)


def module(name: str) -> ModuleType:
    """Import a subject."""
    return importlib.import_module(f"benchmarks.subjects.{name}")


def paths_of(name: str) -> tuple[str, ...]:
    """Return the paths in the repository that a subject's results depend on."""
    return (f"benchmarks/subjects/{name}.py", *module(name).DEPENDS_ON)


def stale() -> Iterator[tuple[str, str]]:
    """Yield each subject whose results are older than the code they measure, and why."""
    for name in SUBJECTS:
        file = report.file_of(name)
        if not file.exists():
            yield name, "no results"
            continue
        text = file.read_text(encoding="utf-8")
        commit = report.commit_of(text)
        if commit == "unknown" or commit.endswith("+"):
            yield name, "commit unknown" if commit == "unknown" else f"uncommitted changes at {commit[:-1]}"
            continue
        changed = _git("diff", "--name-only", commit, "--", *paths_of(name))
        if changed is None:
            yield name, f"commit {commit} is not in this repository"
            continue
        # A run stores motions that are better than the best known, and its gaps refer to them.
        shows_them = _REFERENCE.search(text)
        motions = [path for path in changed.splitlines() if shows_them and path.startswith(_BEST_KNOWN)]
        files = [path for path in changed.splitlines() if path not in motions and not _only_text_changed(commit, path)]
        tasks = _other_references(text) if motions else []
        reasons = [f"{len(files)} files changed since {commit}, such as {files[0]}"] if files else []
        reasons += [f"another best-known J of {len(tasks)} tasks, such as {tasks[0]}"] if tasks else []
        if reasons:
            yield name, "; ".join(reasons)


def _only_text_changed(commit: str, file: str) -> bool:
    """Whether the working copy of a file differs from that of a commit only in comments, docstrings or formatting."""
    now = ROOT / file
    if not same_code.is_compared(file) or not now.exists():
        return False
    before = _git("show", f"{commit}:{file}")
    return before is not None and same_code.same_code(file, before, now.read_text(encoding="utf-8"))


def _other_references(text: str) -> list[str]:
    """Return the tasks whose stored best-known J is not the one that a result file shows."""
    stored = {task: planning.BEST.read(planning.BEST.file_of(task)).total for task, _ in _REFERENCE.findall(text)}
    shown = {task: float(total) for task, total in _REFERENCE.findall(text)}
    return [task for task in shown if abs(stored[task] - shown[task]) > _ROUNDED * shown[task]]


def _commit(paths: tuple[str, ...], named: str | None = None) -> str:
    """Return the commit: the current one, with a plus if the paths have uncommitted changes, or the one that is named.

    "unknown" without git and without a name.
    """
    commit = _head()
    if commit is None:
        return "unknown" if named is None else named[:_SHORT]
    return f"{commit}+" if _git("status", "--porcelain", "--", *paths) else commit


def _head() -> str | None:
    """Return the current commit; None if the folder of the benchmarks is not the top of a git repository."""
    if _git("rev-parse", "--show-prefix") != "":  # not a repository, or an export inside of another one
        return None
    return _git("rev-parse", f"--short={_SHORT}", "HEAD")


def _git(*words: str) -> str | None:
    """Return what git prints; None if it fails."""
    try:
        done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout.strip()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    # No `choices`: with them, Python 3.11 refuses an empty list.
    parser.add_argument("subjects", nargs="*", type=_subject, metavar="subject", help=", ".join(SUBJECTS))
    parser.add_argument("--quick", action="store_true", help="small sizes: only checks that the benchmark runs")
    parser.add_argument("--long", action="store_true", help="large sizes, hours in all; see benchmarks/README.md")
    parser.add_argument(
        "--write",
        action="store_true",
        help="write results/SUBJECT.md, with --long results/SUBJECT_long.md, and the index",
    )
    parser.add_argument(
        "--commit", type=_hash, metavar="HASH", help="commit of the code, for results of files without a repository"
    )
    parser.add_argument("--stale", action="store_true", help="list results that are older than the code they measure")
    parser.add_argument(
        "--processes", type=int, default=max(1, (os.cpu_count() or 1)), help="for planning jobs (default: one per core)"
    )
    parser.add_argument(
        "--seconds", type=float, help="time limit of a run, in planners, driven_tasks and long subjects"
    )
    parser.add_argument("--calls", type=int, metavar="N", help="calls per time limit in first_motion")
    own = parser.add_argument_group("prevention")
    own.add_argument("--tasks", action="append", metavar="PATTERN", help="of SCENE/TASK; may be repeated")
    own.add_argument("--drops", type=int, metavar="N", help="drops per motion")
    own.add_argument("--mixed", type=int, metavar="N", help="mixed failures per motion")
    own.add_argument("--weights", type=float, nargs="+", metavar="W", help="weights of the impact models")
    parser.add_argument(
        "--bound", action="store_true", help="prevention and mobile_prevention: the best of many motions"
    )
    return parser


def _subject(name: str) -> str:
    if name not in SUBJECTS:
        raise argparse.ArgumentTypeError(f"{name!r} is no benchmark; choose from {', '.join(SUBJECTS)}")
    return name


def _hash(text: str) -> str:
    if not re.fullmatch(f"[0-9a-f]{{{_SHORT},40}}", text):
        raise argparse.ArgumentTypeError(f"{text!r} is no commit: {_SHORT} to 40 digits of its hash are needed")
    return text


if __name__ == "__main__":
    sys.exit(main())
