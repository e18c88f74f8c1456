"""The command line, `graceful-plan`. Thin: it calls the public API, prints, and turns outcomes into exit codes.

0: done. 1: no verified trajectory, or a check failed. 2: misuse. 130: interrupted.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path as FilePath
from typing import Any

import graceful_plan as gp
from graceful_plan import documents
from graceful_plan.exceptions import GracefulPlanError, SettingError, UnknownNameError
from graceful_plan.scene.scene import Scene

DONE, FAILED, MISUSE, INTERRUPTED = 0, 1, 2, 130


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    args = _parser().parse_args(argv)
    try:
        return args.run(args)
    except GracefulPlanError as error:
        print(f"graceful-plan {args.command}: {error}", file=sys.stderr)
        return MISUSE
    except OSError as error:
        if isinstance(error, BrokenPipeError):
            # The reader went away, as `head` does; a second complaint at shutdown is kept from it.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return DONE
        print(f"graceful-plan {args.command}: {error}", file=sys.stderr)
        return MISUSE
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return INTERRUPTED


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="graceful-plan", description="Plan motions along which a failure at any moment does little harm."
    )
    parser.add_argument("--version", action="version", version=gp.__version__)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    demo = _command(commands, "demo", _demo, "plan 'tabletop' with w = 0 and w = 1, compare, draw")
    demo.add_argument("--output", type=FilePath, default=FilePath("graceful_plan_demo"), help="folder for what is made")
    _add_budget(demo)

    plan = _command(commands, "plan", _plan, "plan one motion")
    _add_scene(plan)
    plan.add_argument("--start", nargs="+", metavar="Q", help="keyframe, or one number a joint; default: the task's")
    plan.add_argument("--goal", nargs="+", metavar="Q", help="keyframe, or one number a joint; default: the task's")
    plan.add_argument("--w", type=float, default=1.0, help="safety weight; 0 is an ordinary planner (default 1)")
    plan.add_argument("--planner", default="auto", help="see `graceful-plan planners`")
    plan.add_argument("--output", type=FilePath, metavar="FILE", help="write the trajectory to FILE.json or FILE.csv")
    _add_budget(plan)

    evaluate = _command(commands, "evaluate", _evaluate, "judge a path or trajectory from any planner")
    evaluate.add_argument("motion", type=FilePath, help="JSON file with a path or a trajectory")
    _add_scene(evaluate)
    evaluate.add_argument("--w", type=float, default=1.0, help="safety weight of the total (default 1)")

    explain = _command(commands, "explain", _explain, "say where the impact of a path or trajectory comes from")
    explain.add_argument("motion", type=FilePath, help="JSON file with a path, a trajectory or the result of `plan`")
    _add_scene(explain)
    _add_model(explain, gp.ImpactCost().model)
    explain.add_argument(
        "--exposure", default="length", help="what the impact is integrated over: length, time, waypoints"
    )
    explain.add_argument("--output", type=FilePath, metavar="FILE", help="draw it: FILE.png, .pdf or .svg")

    impact_map = _command(commands, "map", _map, "map what it would do to let the carried object go")
    _add_scene(impact_map)
    _add_model(impact_map, "footprint")
    impact_map.add_argument("--height", type=float, required=True, metavar="M", help="of its lowest point [m]")
    impact_map.add_argument("--speed", type=float, default=0.0, help="horizontal [m/s] (default 0)")
    impact_map.add_argument(
        "--direction", type=float, metavar="RAD", help="of the speed, from x towards y; default: all"
    )
    impact_map.add_argument(
        "--at", nargs="+", metavar="Q", help="configuration that says how it is turned; default: upright"
    )
    impact_map.add_argument(
        "--surface", type=float, metavar="Z", help="that the height counts from; default: the table's top"
    )
    impact_map.add_argument(
        "--resolution", type=float, default=0.02, metavar="M", help="width of a cell (default 0.02)"
    )
    impact_map.add_argument("--output", type=FilePath, metavar="FILE", help="draw it: FILE.png, .pdf or .svg")

    tune = _command(commands, "tune", _tune, "find the front of motion against impact, to choose a safety weight")
    tune.add_argument("scene", nargs="?", default="tabletop", help="bundled scene or scene file (default tabletop)")
    tune.add_argument("task", nargs="?", help="task of the scene; default: its first")
    tune.add_argument("--points", type=int, default=30, help="most motions on the front (default 30)")
    tune.add_argument("--seconds", type=float, metavar="S", help="for the whole search (default 10)")
    tune.add_argument("--iterations", type=int, help="instead: reproducible, unlike a time limit")
    tune.add_argument("--seed", type=int, default=0, help="of the random numbers (default 0)")
    tune.add_argument("--planner", help="what minimises for single weights; see `graceful-plan planners`")
    tune.add_argument("--speed", type=float, default=1.0, help="fraction of the velocity limits (default 1)")
    tune.add_argument("--target-impact", type=float, metavar="S", help="choose the shortest with at most this impact")
    tune.add_argument("--max-detour", type=float, metavar="R", help="choose among those so much longer, 0.05 is 5 %%")
    tune.add_argument("--validate", type=int, default=0, metavar="N", help="let FailBench fail N times along each")
    tune.add_argument(
        "--out", type=FilePath, default=FilePath("graceful_plan_front"), help="folder for front.html and the like"
    )

    roadmap = _command(commands, "roadmap", _roadmap, "build a roadmap of a scene and write it to a file")
    _add_scene(roadmap)
    roadmap.add_argument("output", type=FilePath, help="file to write, such as table.npz")
    roadmap.add_argument("--nodes", type=int, default=1500, help="size (default 1500)")
    roadmap.add_argument("--seed", type=int, default=0, help="of the random numbers (default 0)")

    _add_bench(commands)
    _command(commands, "scenes", _scenes, "list the bundled scenes and their tasks")
    _command(commands, "planners", _planners, "list the planners and their settings")
    _command(commands, "doctor", _doctor, "versions, instruction set in use, self-test")
    return parser


def _command(commands: Any, name: str, run: Callable[[argparse.Namespace], int], text: str) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    parser.set_defaults(run=run)
    return parser


def _add_bench(commands: Any) -> None:
    bench = _command(commands, "bench", _bench, "compare planners on a suite of problems, at equal time")
    bench.add_argument("--suite", default="quick", help="bundled suite, suite file, problem file or folder of those")
    bench.add_argument(
        "--planners", nargs="+", metavar="P", help="name, or name:setting=value,...; the first is the reference"
    )
    bench.add_argument(
        "--planner",
        action="append",
        default=[],
        metavar="MODULE:CLASS",
        help="planner of your own, by the class's name, as package.module:Class or package.module:Class:setting=value; "
        "repeat for more. Its module is imported, also from the current directory",
    )
    bench.add_argument("--seeds", metavar="N|S,S", help="number of seeds, or seeds with commas (default: the suite's)")
    bench.add_argument("--seconds", type=float, metavar="S", help="time limit of every call (default: the suite's)")
    bench.add_argument("--w", type=float, help="safety weight (default: the suite's)")
    bench.add_argument(
        "--out",
        type=FilePath,
        default=FilePath("graceful_plan_bench"),
        help="folder; a comparison that was interrupted there goes on (default graceful_plan_bench)",
    )
    bench.add_argument("--processes", type=int, default=1, help="runs at a time (default 1)")
    bench.add_argument(
        "--known",
        type=FilePath,
        metavar="FILE",
        help="best_known.yaml of another comparison, or a folder of best paths",
    )
    bench.add_argument("--export", default="", metavar="csv,parquet,arena", help="tables, and OMPL's Planner Arena")
    bench.add_argument("--report-only", action="store_true", help="run nothing; report what --out holds")


def _add_scene(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--scene", default="tabletop", help="bundled scene or scene file (default tabletop)")
    parser.add_argument("--task", help="task of the scene; default: its first, unless start and goal are given")


def _add_model(parser: argparse.ArgumentParser, default: Any) -> None:
    parser.add_argument("--model", default=default, help=f"interaction model (default {default})")


def _add_budget(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--time-limit", type=float, metavar="S", help="seconds of search (default 1)")
    parser.add_argument("--iterations", type=int, help="planner iterations: reproducible, unlike a time limit")
    parser.add_argument("--seed", type=int, default=0, help="of the random numbers (default 0)")


def _budget(args: argparse.Namespace) -> dict[str, Any]:
    limit = args.time_limit if args.time_limit is not None or args.iterations is not None else 1.0
    return {"time_limit": limit, "iterations": args.iterations, "seed": args.seed}


# --- commands --------------------------------------------------------------------------------------------------------


def _demo(args: argparse.Namespace) -> int:
    from graceful_plan.tools import demo

    with _Progress(args.json) as progress:
        outcome = demo.run(args.output, callback=progress, **_budget(args))
    solved = all(result.status is gp.PlanStatus.SOLVED for result in outcome.results.values())
    costs = {label: result.cost for label, result in outcome.results.items()}
    document = {
        "schema": "graceful_plan.demo",
        "version": 1,
        "results": {
            label: {"status": result.status.name, "cost": documents.cost_document(result.cost)}
            for label, result in outcome.results.items()
        },
        "files": [str(file) for file in outcome.files],
    }
    text = [documents.cost_table(costs), ""] if solved else []
    text += [f"{label}: {_sentence(result)}" for label, result in outcome.results.items()]
    text += ["", *(f"wrote {file}" for file in outcome.files)]
    _print(args, document, "\n".join(text))
    return DONE if solved else FAILED


def _plan(args: argparse.Namespace) -> int:
    scene, start, goal = _problem(args)
    if args.output is not None and args.output.suffix not in (".json", ".csv"):
        raise SettingError("--output", str(args.output), "a file name that ends in .json or .csv")
    with _Progress(args.json) as progress:
        result = gp.plan(start, goal, scene, w=args.w, planner=args.planner, callback=progress, **_budget(args))
    text = [_sentence(result)]
    if result.status is gp.PlanStatus.SOLVED:
        text += ["", documents.cost_table({f"w = {args.w:g}": result.cost})]
        if args.output is not None:
            trajectory = result.unwrap()
            write = trajectory.to_csv if args.output.suffix == ".csv" else trajectory.to_json
            write(args.output)
            text += ["", f"wrote {args.output}"]
    _print(args, documents.result_document(result), "\n".join(text))
    return DONE if result.status is gp.PlanStatus.SOLVED else FAILED


def _evaluate(args: argparse.Namespace) -> int:
    motion = documents.read_motion(args.motion)
    scene = _task(args)[0]
    cost = gp.evaluate(motion, scene, gp.Objective(w=args.w))
    verdict = gp.verify(motion, scene)
    rows = [
        [name, "passed" if check.passed else "FAILED", check.worst, check.detail]
        for name, check in verdict.checks.items()
    ]
    document = {
        "schema": "graceful_plan.evaluation",
        "version": 1,
        "cost": documents.cost_document(cost),
        "verdict": documents.verdict_document(verdict),
    }
    text = [documents.cost_table({f"w = {args.w:g}": cost}), ""]
    _print(args, document, "\n".join([*text, documents.table(["check", "", "worst", ""], rows)]))
    return DONE if verdict.passed else FAILED


def _explain(args: argparse.Namespace) -> int:
    _check_picture(args)
    motion, scene = documents.read_motion(args.motion), _task(args)[0]
    objective = gp.Objective(impact=gp.ImpactCost(model=args.model), exposure=args.exposure)
    explanation = gp.explain(motion, scene, objective)
    text = str(explanation)
    if args.output is not None:
        from graceful_plan.viz.explanation import draw_explanation

        draw_explanation(explanation, args.output)
        text += f"\n\nwrote {args.output}"
    _print(args, explanation.to_document(), text)
    return DONE


def _map(args: argparse.Namespace) -> int:
    _check_picture(args)
    scene = _task(args)[0]
    found = gp.impact_map(
        scene,
        gp.ImpactCost(model=args.model),
        height=args.height,
        speed=args.speed,
        direction=args.direction,
        q=None if args.at is None else _joint_values(scene, "--at", args.at),
        surface=args.surface,
        resolution=args.resolution,
    )
    text = str(found)
    if args.output is not None:
        from graceful_plan.viz.impact_maps import draw_impact_map

        draw_impact_map(found, scene, args.output)
        text += f"\n\nwrote {args.output}"
    _print(args, found.to_document(), text)
    return DONE


def _tune(args: argparse.Namespace) -> int:
    from graceful_plan.tools import tune_report

    task = _task(args)[1]
    if task is None:
        raise SettingError("task", None, "a scene with a task")
    planner = {} if args.planner is None else {"planner": args.planner}
    with _Progress(args.json) as progress:
        outcome = tune_report.run(
            args.scene,
            task,
            args.out,
            target_impact=args.target_impact,
            max_detour=args.max_detour,
            failures=args.validate,
            callback=progress,
            points=args.points,
            time_limit=args.seconds,
            iterations=args.iterations,
            seed=args.seed,
            speed=args.speed,
            **planner,
        )
    _print(args, outcome.to_document(), str(outcome))
    chosen = outcome.choice.status is gp.ChoiceStatus.MET
    return DONE if chosen and outcome.front.status is gp.PlanStatus.SOLVED else FAILED


def _roadmap(args: argparse.Namespace) -> int:
    started = time.perf_counter()
    roadmap = gp.Roadmap.build(_task(args)[0], nodes=args.nodes, seed=args.seed)
    roadmap.save(args.output)
    found = {"nodes": len(roadmap), "edges": len(roadmap.edges), "seconds": time.perf_counter() - started}
    text = "{nodes} nodes, {edges} directed edges in {seconds:.1f} s".format(**found)
    _print(args, {"schema": "graceful_plan.built_roadmap", "version": 1, **found}, f"{text}\n\nwrote {args.output}")
    return DONE


def _bench(args: argparse.Namespace) -> int:
    from graceful_plan import compare as bench

    exports = [name for name in args.export.split(",") if name]
    bench.check_exports(exports)
    if args.report_only:
        comparison = bench.load_comparison(args.out)
        known = {} if args.known is None else bench.read_known(args.known, comparison.w)
        summary = bench.summarise(bench.load_comparison(args.out, known))
    else:
        summary = bench.summarise(_compared(args))
    files = bench.write(summary, args.out, exports)
    text = [bench.text(summary), "", *(f"wrote {file}" for file in files)]
    _print(args, summary.to_document() | {"files": [str(file) for file in files]}, "\n".join(text))
    return DONE if any(planner.solved for planner in summary.planners) else FAILED


def _compared(args: argparse.Namespace) -> Any:
    from graceful_plan import compare as bench

    suite = bench.load_suite(args.suite)
    known = None if args.known is None else bench.read_known(args.known, suite.w if args.w is None else args.w)
    named = [*(gp.PLANNERS if args.planner and args.planners is None else args.planners or ()), *args.planner]
    counter = _Counter()
    try:
        return bench.compare(
            suite,
            planners=named or None,
            seeds=None if args.seeds is None else _seeds(args.seeds),
            seconds=args.seconds,
            w=args.w,
            out=args.out,
            processes=args.processes,
            known=known,
            progress=counter.show,
        )
    except KeyboardInterrupt:
        counter.end()
        if counter.total:
            # The journal knows better than the counter, which may not have heard of the last run.
            kept = bench.load_comparison(args.out)
            words = f"{len(kept.runs)} of {kept.expected} runs are kept in {args.out}; the same command goes on"
            print(words, file=sys.stderr)
        raise


def _seeds(text: str) -> int | list[int]:
    try:
        return [int(word) for word in text.split(",") if word] if "," in text else int(text)
    except ValueError:
        raise SettingError("--seeds", text, "a number of seeds, or seeds with commas between them") from None


def _scenes(args: argparse.Namespace) -> int:
    scenes = {name: gp.load_scene(name) for name in gp.scenes()}
    document = {
        name: {
            "joints": list(scene.joints),
            "keyframes": sorted(scene.keyframes),
            "entities": {entity.name: entity.category for entity in scene.entities.values()},
            "tasks": {task.name: task.description for task in scene.tasks.values()},
        }
        for name, scene in scenes.items()
    }
    lines = []
    for name, scene in scenes.items():
        lines += [f"{name}: {len(scene.entities)} entities, {len(scene.joints)} joints"]
        lines += [f"  {task.name}: {task.description}" for task in scene.tasks.values()]
    _print(args, document, "\n".join(lines))
    return DONE


def _planners(args: argparse.Namespace) -> int:
    document = {
        name: {
            "summary": (planner.__doc__ or "").strip().splitlines()[0],
            "anytime": planner.anytime,
            "settings": {field.name: repr(field.default) for field in _settings(planner)},
        }
        for name, planner in gp.PLANNERS.items()
    }
    rows = [[name, "yes" if entry["anytime"] else "no", entry["summary"]] for name, entry in document.items()]
    _print(args, document, documents.table(["planner", "anytime", ""], rows))
    return DONE


def _settings(planner: Any) -> tuple[dataclasses.Field[Any], ...]:
    return dataclasses.fields(planner)


def _doctor(args: argparse.Namespace) -> int:
    from graceful_plan.tools import doctor

    findings = doctor.examine()
    document = {
        finding.name: {"ok": finding.ok, "value": finding.value, "detail": finding.detail} for finding in findings
    }
    rows = [["ok" if finding.ok else "FAILED", finding.name, finding.value, finding.detail] for finding in findings]
    _print(args, document, documents.table(["", "what", "value", ""], rows))
    return DONE if all(finding.ok for finding in findings) else FAILED


# --- parts -----------------------------------------------------------------------------------------------------------


def _task(args: argparse.Namespace) -> tuple[Scene, gp.Task | None]:
    """Return the scene to plan in and the task whose object it holds, if one was asked for."""
    scene = gp.load_scene(args.scene)
    own_ends = getattr(args, "start", None) is not None and getattr(args, "goal", None) is not None
    name = args.task
    if name is None and (own_ends or not scene.tasks):
        return scene, None
    if name is None:
        name = next(iter(scene.tasks))
    if name not in scene.tasks:
        raise UnknownNameError("task", name, scene.tasks)
    task = scene.tasks[name]
    return task.scene, task


def _problem(args: argparse.Namespace) -> tuple[Scene, Any, Any]:
    scene, task = _task(args)
    ends = []
    for option, words, default in (
        ("--start", args.start, task and task.start),
        ("--goal", args.goal, task and task.goal),
    ):
        if words is None and task is None:
            raise SettingError(
                option, None, f"a keyframe ({', '.join(scene.keyframes) or 'none here'}) or joint values"
            )
        ends.append(default if words is None else _configuration(option, words))
    return scene, ends[0], ends[1]


def _configuration(option: str, words: Sequence[str]) -> str | list[float]:
    """Read a keyframe's name, or one number a joint."""
    try:
        return [float(word) for word in words]
    except ValueError:
        if len(words) == 1:
            return words[0]
        raise SettingError(option, " ".join(words), "the name of a keyframe, or numbers only") from None


def _joint_values(scene: Scene, option: str, words: Sequence[str]) -> Any:
    """Read a configuration; a keyframe is looked up in the scene."""
    given = _configuration(option, words)
    if isinstance(given, str) and given not in scene.keyframes:
        raise UnknownNameError("keyframe", given, scene.keyframes)
    return scene.keyframes[given] if isinstance(given, str) else given


def _check_picture(args: argparse.Namespace) -> None:
    if args.output is not None and args.output.suffix not in (".png", ".pdf", ".svg"):
        raise SettingError("--output", str(args.output), "a file name that ends in .png, .pdf or .svg")


def _sentence(result: gp.PlanResult) -> str:
    text = f"{result.status.name}: {result.status.value}" + (f" ({result.detail})" if result.detail else "")
    if result.trajectory is not None:
        text += f" {result.trajectory.duration:.2f} s long."
    return text


def _print(args: argparse.Namespace, document: Any, text: str) -> None:
    print(documents.to_json(document) if args.json else text)


class _Progress:
    """Shows the best cost so far while planning, if somebody sits at a terminal."""

    def __init__(self, quiet: bool) -> None:
        self.shown = sys.stderr.isatty() and not quiet

    def __enter__(self) -> Callable[[Any], None] | None:
        return self.show if self.shown else None

    def __exit__(self, *_: object) -> None:
        if self.shown:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)

    def show(self, point: Any) -> None:
        """Overwrite the line with the newest improvement, or with how far a search for a front has come."""
        text = f"{point.time:6.2f} s  "
        if isinstance(point, gp.TracePoint):
            text += f"total {point.total:.4g}  motion {point.motion:.4g}  impact {point.impact:.4g}"
        else:
            text += f"{point.stage}, {point.candidates} candidates"
        print(f"\r\x1b[K{text}", end="", file=sys.stderr, flush=True)


class _Counter:
    """Shows how many runs are done: on one line at a terminal, else ten times in all."""

    def __init__(self) -> None:
        self.total = 0

    def show(self, done: int, total: int, run: Any) -> None:
        """Show it."""
        self.total = total
        text = f"{done}/{total} runs" + (f": {run.problem}, {run.planner}, {run.status}" if run else "")
        if sys.stderr.isatty():
            print(f"\r\x1b[K{text}", end="\n" if done == total else "", file=sys.stderr, flush=True)
        elif run is None or done == total or done % max(1, total // 10) == 0:
            print(text, file=sys.stderr, flush=True)

    def end(self) -> None:
        """Leave the line."""
        if sys.stderr.isatty():
            print(file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
