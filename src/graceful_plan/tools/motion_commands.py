"""Commands for single motions: demo, plan and evaluate."""

from __future__ import annotations

import argparse
from pathlib import Path as FilePath
from typing import Any

import graceful_plan as gp
from graceful_plan import documents
from graceful_plan.costs.objective import DEFAULT_WEIGHT
from graceful_plan.exceptions import SettingError
from graceful_plan.formats.parquet_file import check_arrow
from graceful_plan.mobile.floor_pictures import draw_floor
from graceful_plan.mobile.map_options import PICTURES, add_map, chosen_map, map_problem
from graceful_plan.query.request import STOPS
from graceful_plan.tools.console import (
    add_budget,
    add_command,
    add_planner,
    add_scene,
    add_speed,
    add_validation,
    blamed_on,
    budget,
    check_file,
    check_folder,
    chosen_planner,
    chosen_problem,
    chosen_task,
    motion_in,
    sentence,
    show,
)
from graceful_plan.tools.parsing import DONE, FAILED
from graceful_plan.tools.progress import ProgressLine
from graceful_plan.tools.validation import Validation, check_failures, validate_motion


def add_to(commands: Any) -> None:
    """Add the commands of this module to the parser."""
    demo = add_command(commands, "demo", _demo, "plan 'tabletop' with w = 0 and the default w, compare, draw")
    demo.add_argument("--output", type=FilePath, default=FilePath("graceful_plan_demo"), help="folder for the files")
    add_budget(demo, 1.0)

    plan = add_command(commands, "plan", _plan, "plan one motion")
    add_scene(plan)
    add_map(plan)
    plan.add_argument(
        "--start",
        nargs="+",
        metavar="Q",
        help="keyframe, or one number a joint; default: the task's; on a map x, y, yaw",
    )
    plan.add_argument("--goal", nargs="+", metavar="Q", help="keyframe, or one number a joint; default: the task's")
    weight = f"safety weight; 0 is an ordinary planner (default {DEFAULT_WEIGHT:g})"
    plan.add_argument("--w", type=float, default=DEFAULT_WEIGHT, help=weight)
    add_planner(plan, "planner")
    add_speed(plan)
    plan.add_argument(
        "--output",
        type=FilePath,
        metavar="FILE",
        help="write the trajectory to FILE.json, .csv, .parquet, or .yaml (a ROS message)",
    )
    add_validation(plan, "simulate N failures along the motion in FailBench")
    add_budget(plan, 1.0)
    plan.add_argument(
        "--stop",
        choices=STOPS,
        help="end with the first verified motion, on convergence (the default without a limit), or with the time limit "
        "or iterations",
    )
    plan.add_argument(
        "--no-refine", dest="refine", action="store_false", help="follow the planner's raw path with rounded corners"
    )

    evaluate = add_command(commands, "evaluate", _evaluate, "judge a path or trajectory from any planner")
    evaluate.add_argument(
        "motion", type=FilePath, help="file with a path or a trajectory: .json, .csv, .parquet, .yaml"
    )
    add_scene(evaluate)
    evaluate.add_argument("--w", type=float, default=DEFAULT_WEIGHT, help=weight)


def _demo(args: argparse.Namespace) -> int:
    from graceful_plan.tools import demo

    check_folder(args.output)
    with ProgressLine(args.json) as progress:
        outcome = demo.run(args.output, callback=progress.callback, **budget(args))
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
    check_file(args.output, documents.MOTION_FILES)
    if args.output is not None and args.output.suffix == ".parquet":
        check_arrow()
    check_failures(args.validate)
    planner = chosen_planner(args)
    check_file(args.picture, PICTURES)
    scene, start, goal = chosen_problem(args) if args.map is None else map_problem(args)
    if args.picture is not None and scene.base is None:
        raise SettingError("--picture", str(args.picture), "none: this robot does not drive; see `graceful-plan view`")
    task = None if args.map is not None else chosen_task(args)[1]
    if args.validate and task is None:
        raise SettingError("--validate", args.validate, "a task, by --task: without one there is no carried object")
    settings: dict[str, Any] = {"w": args.w, "planner": planner, "speed": args.speed, **budget(args)}
    settings |= {"stop": args.stop, "refine": args.refine}
    validation = None
    with ProgressLine(args.json, "preparing the scene") as progress:
        result = gp.plan(start, goal, scene, callback=progress.callback, **settings)
        if result.trajectory is not None and result.status is gp.PlanStatus.SOLVED:
            if args.output is not None:
                documents.write_motion(result.trajectory, args.output)
            if args.picture is not None:
                floor = None if args.map is None else chosen_map(args)
                draw_floor(scene, result.trajectory, args.picture, floor=floor, objective=gp.Objective(w=args.w))
            if args.validate and task is not None:
                progress.stage(f"FailBench: {args.validate} failures")
                validation = validate_motion(
                    result.trajectory,
                    args.scene,
                    task.name,
                    args.validate,
                    grasp=args.grasp,
                    seed=args.seed,
                    as_json=args.json,
                )
    return _answer(args, result, validation)


def _answer(args: argparse.Namespace, result: gp.PlanResult, validation: Validation | None) -> int:
    solved = result.status is gp.PlanStatus.SOLVED
    text = [sentence(result)]
    if solved:
        text += ["", documents.cost_table({f"w = {args.w:g}": result.cost})]
    if validation is not None:
        text += ["", validation.text]
    if solved:
        text += ["", *(f"wrote {file}" for file in (args.output, args.picture) if file is not None)]
    asked = {} if validation is None else {"validation": validation.document}
    show(args, documents.result_document(result) | asked, "\n".join(text))
    return DONE if solved else FAILED


def _evaluate(args: argparse.Namespace) -> int:
    scene = chosen_task(args)[0]
    motion = motion_in(args.motion, scene)
    with ProgressLine(args.json, "judging"), blamed_on(args.motion):
        cost = gp.evaluate(motion, scene, gp.Objective(w=args.w))
        verdict = gp.verify(motion, scene)
    rows = [
        [
            name,
            "passed" if check.passed else "warns" if name in verdict.warnings else "FAILED",
            check.worst,
            check.detail,
        ]
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
