"""Run benchmarks and print a Markdown section a subject; with `--write`, put it into RESULTS.md.

python benchmarks/run.py [subject ...] [--quick] [--write] [--processes N] [--seconds S]
"""

from __future__ import annotations

import argparse
import importlib
import os
import subprocess
import sys
import time
import traceback
from datetime import UTC, datetime
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from benchmarks import report, suite  # noqa: E402 - after the path to them is known
from graceful_plan.compare.runs import machine  # noqa: E402

SUBJECTS = (
    "kernels",
    "impact_speed",
    "safety",
    "first_path",
    "first_motion",
    "real_tasks",
    "inverse_kinematics",
    "straight_tool",
    "clouds",
    "robots",
    "constraints",
    "motion_problems",
    "own_costs",
    "planners",
    "best_known",
    "auto",
    "optima",
    "optimisers",
    "roadmap",
    "startup",
    "hardening",
    "viewer",
    "packages",
    "discretisation",
    "motions",
    "paper_table",
    "drop_physics",
    "drop_prediction",
    "walls",
    "failure_prediction",
    "trajectory_prediction",
    "learned_interaction",
    "prevention",
    "harm_curves",
    "damage_energy",
    "own_loss",
    "stops",
    "policies",
    "transcription",
    "moving_entities",
    "walking_past",
    "driving",
    "driven_tasks",
    "mobile_prevention",
    "other_floors",
    "whole_body",
    "base_failures",
    "clutter",
    "lattice",
    "floor_maps",
    "tuning",
    "annotation",
    "failbench_speed",
    "failbench_soak",
    "failbench_kills",
    "failbench_sweeps",
)
"""In the order of RESULTS.md; each is a module of `benchmarks.subjects` with TITLE and run(options)."""
ON_REQUEST = frozenset(
    {
        "packages",
        "best_known",
        "real_tasks",
        "auto",
        "trajectory_prediction",
        "learned_interaction",
        "prevention",
        "harm_curves",
        "constraints",
        "stops",
        "lattice",
        "floor_maps",
        "policies",
        "driven_tasks",
        "mobile_prevention",
        "other_floors",
    }
)
"""Run only when named: one takes the better part of an hour and is to be done before `planners`, the other hours."""
TAKEN_OUT = "taken_out"
"""Section written by hand: what was measured, did not help and is gone."""
RESULTS = Path(__file__).with_name("RESULTS.md")


def main(arguments: list[str] | None = None) -> int:
    """Run subjects and return how many of them raised."""
    args = _parser().parse_args(arguments)
    options = suite.Options(
        quick=args.quick,
        processes=args.processes,
        seconds=args.seconds,
        calls=args.calls,
        tasks=tuple(args.tasks or ("*",)),
        drops=args.drops,
        mixed=args.mixed,
        weights=tuple(args.weights) if args.weights else None,
    )
    # Of the processes that are started from here: with one each, threads of linear algebra only stand in the way.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    print(machine.described())
    failed = 0
    for name in args.subjects or [name for name in SUBJECTS if name not in ON_REQUEST]:
        try:
            body = section(name, options, arguments)
        except Exception:
            failed += 1
            traceback.print_exc()
            continue
        print(f"\n{body}", flush=True)
        if args.write:
            report.write_section(RESULTS, name, body, (*SUBJECTS, TAKEN_OUT))
    return failed


def section(name: str, options: suite.Options, arguments: list[str] | None) -> str:
    """Run one subject and format its section."""
    subject = importlib.import_module(f"benchmarks.subjects.{name}")
    load, started = os.getloadavg()[0], time.perf_counter()
    body = subject.run(options)
    seconds = time.perf_counter() - started
    command = " ".join(["python benchmarks/run.py", *(sys.argv[1:] if arguments is None else arguments)])
    made = f"{datetime.now(UTC):%Y-%m-%d}, `{command}`, commit {_commit()}, {seconds:.0f} s"
    made = f"{made}, load average {load:.1f} before it began."
    quick = "\n\n**Quick run: sizes too small for its figures to mean much.**" if options.quick else ""
    return f"## {subject.TITLE}\n\n{made} {machine.described()}.{quick}\n\n{body}"


def _commit() -> str:
    """Return the commit that is measured, with a plus if files differ from it; "unknown" outside of a repository."""
    words = ["git", "describe", "--always", "--dirty=+", "--exclude=*"]
    try:
        found = subprocess.run(words, cwd=Path(__file__).parent, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return found.stdout.strip()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("subjects", nargs="*", choices=SUBJECTS, metavar="subject", help=", ".join(SUBJECTS))
    parser.add_argument("--quick", action="store_true", help="small sizes: does it work?")
    parser.add_argument("--write", action="store_true", help="replace the sections in RESULTS.md")
    parser.add_argument(
        "--processes", type=int, default=max(1, (os.cpu_count() or 1)), help="for planning jobs (default: one a core)"
    )
    parser.add_argument("--seconds", type=float, help="time limit of a run, for best_known, planners and optima")
    parser.add_argument("--calls", type=int, metavar="N", help="calls of each time limit, for first_motion")
    own = parser.add_argument_group("of prevention and harm_curves")
    own.add_argument("--tasks", action="append", metavar="PATTERN", help="of scene/task; may be given again")
    own.add_argument("--drops", type=int, metavar="N", help="drops along each motion")
    own.add_argument("--mixed", type=int, metavar="N", help="mixed failures along each motion of prevention")
    own.add_argument("--weights", type=float, nargs="+", metavar="W", help="of the impact models in harm_curves")
    return parser


if __name__ == "__main__":
    sys.exit(main())
