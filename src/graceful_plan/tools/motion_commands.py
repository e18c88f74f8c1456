"""Commands that make and judge motions: demo, plan, evaluate and tune."""

from __future__ import annotations

import argparse
from pathlib import Path as FilePath
from typing import Any

import graceful_plan as gp
from graceful_plan import documents
from graceful_plan.costs.objective import DEFAULT_WEIGHT
from graceful_plan.exceptions import SettingError
from graceful_plan.tools.console import (
    DONE,
    FAILED,
    ProgressLine,
    add_budget,
    add_command,
    add_scene,
    budget,
    chosen_problem,
    chosen_task,
    sentence,
    show,
)
from graceful_plan.tuning.fronts import ChoiceStatus


def add_to(commands: Any) -> None:
    """Add these commands to those of the parser."""
    demo = add_command(commands, "demo", _demo, "plan 'tabletop' with w = 0 and the default w, compare, draw")
    demo.add_argument("--output", type=FilePath, default=FilePath("graceful_plan_demo"), help="folder for what is made")
    add_budget(demo)

    plan = add_command(commands, "plan", _plan, "plan one motion")
    add_scene(plan)
    plan.add_argument("--start", nargs="+", metavar="Q", help="keyframe, or one number a joint; default: the task's")
    plan.add_argument("--goal", nargs="+", metavar="Q", help="keyframe, or one number a joint; default: the task's")
    weight = f"safety weight; 0 is an ordinary planner (default {DEFAULT_WEIGHT:g})"
    plan.add_argument("--w", type=float, default=DEFAULT_WEIGHT, help=weight)
    plan.add_argument("--planner", default="auto", help="see `graceful-plan planners`")
    plan.add_argument("--output", type=FilePath, metavar="FILE", help="write the trajectory to FILE.json or FILE.csv")
    add_budget(plan)

    evaluate = add_command(commands, "evaluate", _evaluate, "judge a path or trajectory from any planner")
    evaluate.add_argument("motion", type=FilePath, help="JSON file with a path or a trajectory")
    add_scene(evaluate)
    evaluate.add_argument("--w", type=float, default=DEFAULT_WEIGHT, help=weight)

    tune = add_command(commands, "tune", _tune, "find the front of motion against impact, to choose a safety weight")
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


def _demo(args: argparse.Namespace) -> int:
    from graceful_plan.tools import demo

    with ProgressLine(args.json) as progress:
        outcome = demo.run(args.output, callback=progress, **budget(args))
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
    text = [documents.cost_table(costs), "", outcome.comparison(), ""] if outcome.solved else []
    text += [f"{label}: {sentence(result)}" for label, result in outcome.results.items()]
    text += ["", *(f"wrote {file}" for file in outcome.files)]
    show(args, document, "\n".join(text))
    return DONE if outcome.solved else FAILED


def _plan(args: argparse.Namespace) -> int:
    scene, start, goal = chosen_problem(args)
    if args.output is not None and args.output.suffix not in (".json", ".csv"):
        raise SettingError("--output", str(args.output), "a file name that ends in .json or .csv")
    with ProgressLine(args.json) as progress:
        result = gp.plan(start, goal, scene, w=args.w, planner=args.planner, callback=progress, **budget(args))
    text = [sentence(result)]
    if result.status is gp.PlanStatus.SOLVED:
        text += ["", documents.cost_table({f"w = {args.w:g}": result.cost})]
        if args.output is not None:
            trajectory = result.unwrap()
            write = trajectory.to_csv if args.output.suffix == ".csv" else trajectory.to_json
            write(args.output)
            text += ["", f"wrote {args.output}"]
    show(args, documents.result_document(result), "\n".join(text))
    return DONE if result.status is gp.PlanStatus.SOLVED else FAILED


def _evaluate(args: argparse.Namespace) -> int:
    motion = documents.read_motion(args.motion)
    scene = chosen_task(args)[0]
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
    show(args, document, "\n".join([*text, documents.table(["check", "", "worst", ""], rows)]))
    return DONE if verdict.passed else FAILED


def _tune(args: argparse.Namespace) -> int:
    from graceful_plan.tools import tune_report

    task = chosen_task(args)[1]
    if task is None:
        raise SettingError("task", None, "a scene with a task")
    planner = {} if args.planner is None else {"planner": args.planner}
    with ProgressLine(args.json) as progress:
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
    show(args, outcome.to_document(), str(outcome))
    chosen = outcome.choice.status is ChoiceStatus.MET
    return DONE if chosen and outcome.front.status is gp.PlanStatus.SOLVED else FAILED
