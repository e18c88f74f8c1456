"""Command `bench`, which compares planners."""

from __future__ import annotations

import argparse
from pathlib import Path as FilePath
from typing import Any

import graceful_plan as gp
from graceful_plan.exceptions import SettingError
from graceful_plan.tools.console import add_command, add_time_limit, check_folder, show
from graceful_plan.tools.ending import note
from graceful_plan.tools.parsing import DONE, FAILED
from graceful_plan.tools.progress import RunCounter


def add_to(commands: Any) -> None:
    """Add the commands of this module to the parser."""
    bench = add_command(commands, "bench", _bench, "compare planners on a suite of problems, at equal time")
    bench.add_argument("--suite", default="quick", help="bundled suite, suite file, problem file or folder of these")
    bench.add_argument(
        "--planners",
        nargs="+",
        metavar="P",
        help="name, or name:setting=value,..., with +refine at the end to refine its paths as plan() does; the first "
        "is the reference",
    )
    bench.add_argument(
        "--planner",
        action="append",
        default=[],
        metavar="MODULE:NAME",
        help="custom planner: a class, as package.module:Class or package.module:Class:setting=value, or a function "
        "that calls another library; may be repeated. Its module is imported, also from the current directory",
    )
    bench.add_argument(
        "--refine",
        choices=("off", "on", "both"),
        default="off",
        help="whether to compare planners without +refine by their raw paths, by refined ones, or both (default off)",
    )
    bench.add_argument("--seeds", metavar="N|S,S", help="number of seeds, or seeds with commas (default: the suite's)")
    add_time_limit(bench, "for every call (default: the suite's)")
    bench.add_argument("--w", type=float, help="safety weight (default: the suite's)")
    bench.add_argument(
        "--output",
        "--out",
        type=FilePath,
        default=FilePath("graceful_plan_bench"),
        help="folder; an interrupted comparison in it is resumed (default graceful_plan_bench)",
    )
    bench.add_argument("--processes", type=int, default=1, help="number of parallel runs (default 1)")
    bench.add_argument(
        "--known",
        type=FilePath,
        metavar="FILE",
        help="best_known.yaml of another comparison, or a folder of best motions",
    )
    bench.add_argument("--export", default="", metavar="csv,parquet,arena", help="tables, and OMPL's Planner Arena")
    bench.add_argument("--report-only", action="store_true", help="run nothing; report the runs in --output")


def _bench(args: argparse.Namespace) -> int:
    from graceful_plan import compare as bench

    exports = [name for name in args.export.split(",") if name]
    bench.check_exports(exports)
    check_folder(args.output)
    if args.report_only:
        comparison = bench.load_comparison(args.output)
        known = {} if args.known is None else bench.read_known(args.known, comparison.w)
        summary, problems = bench.summarise(bench.load_comparison(args.output, known)), ()
    else:
        suite = bench.load_suite(args.suite)
        summary, problems = bench.summarise(_compared(args, suite)), suite.problems
    files = bench.write(summary, args.output, exports, space=bench.in_space(summary, problems))
    text = [bench.text(summary), "", *(f"wrote {file}" for file in files)]
    show(args, summary.to_document() | {"files": [str(file) for file in files]}, "\n".join(text))
    return DONE if any(planner.solved for planner in summary.planners) else FAILED


def _compared(args: argparse.Namespace, suite: Any) -> Any:
    from graceful_plan import compare as bench

    known = None if args.known is None else bench.read_known(args.known, suite.w if args.w is None else args.w)
    named = [*(gp.PLANNERS if args.planners is None else args.planners), *args.planner]
    own = [] if args.refine == "on" else named
    refined = [] if args.refine == "off" else [f"{name}{bench.REFINED}" for name in named if bench.REFINED not in name]
    counter = RunCounter(args.json)
    try:
        return bench.compare(
            suite,
            planners=[*own, *refined],
            seeds=None if args.seeds is None else _seeds(args.seeds),
            seconds=args.time_limit,
            w=args.w,
            out=args.output,
            processes=args.processes,
            known=known,
            progress=counter.show,
        )
    except KeyboardInterrupt:
        if counter.total:
            # The journal is more accurate than the counter, which may have missed the last run.
            kept = bench.load_comparison(args.output)
            counter.end()
            words = f"{len(kept.runs)} of {kept.expected} runs are kept in {args.output}; the same command resumes"
            note(words)
        raise
    finally:
        counter.end()


def _seeds(text: str) -> int | list[int]:
    try:
        return [int(word) for word in text.split(",") if word] if "," in text else int(text)
    except ValueError:
        raise SettingError("--seeds", text, "a number of seeds, or seeds separated by commas") from None
