"""Commands that look into impacts: explain and map."""

from __future__ import annotations

import argparse
from pathlib import Path as FilePath
from typing import Any

import graceful_plan as gp
from graceful_plan.tools.console import (
    add_command,
    add_model,
    add_scene,
    blamed_on,
    check_file,
    chosen_task,
    joint_values,
    motion_in,
    show,
)
from graceful_plan.tools.parsing import DONE
from graceful_plan.tools.progress import ProgressLine

_PICTURES = (".png", ".pdf", ".svg")


def add_to(commands: Any) -> None:
    """Add these commands to those of the parser."""
    explain = add_command(commands, "explain", _explain, "say where the impact of a path or trajectory comes from")
    explain.add_argument(
        "motion",
        type=FilePath,
        help="file with a path, a trajectory or the result of `plan`: .json, .csv, .parquet, .yaml",
    )
    add_scene(explain)
    add_model(explain, gp.ImpactCost().model)
    explain.add_argument(
        "--exposure", default="time", help="what the impact is integrated over: time (default), length, waypoints"
    )
    explain.add_argument("--output", type=FilePath, metavar="FILE", help="draw it: FILE.png, .pdf or .svg")

    impact_map = add_command(commands, "map", _map, "map what it would do to let the carried object go")
    add_scene(impact_map)
    add_model(impact_map, "footprint")
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


def _explain(args: argparse.Namespace) -> int:
    check_file(args.output, _PICTURES)
    scene = chosen_task(args)[0]
    motion = motion_in(args.motion, scene)
    objective = gp.Objective(impact=gp.ImpactCost(model=args.model), exposure=args.exposure)
    with ProgressLine(args.json, "explaining"), blamed_on(args.motion):
        explanation = gp.explain(motion, scene, objective)
    text = str(explanation)
    if args.output is not None:
        from graceful_plan.viz.explanation import draw_explanation

        draw_explanation(explanation, args.output)
        text += f"\n\nwrote {args.output}"
    show(args, explanation.to_document(), text)
    return DONE


def _map(args: argparse.Namespace) -> int:
    check_file(args.output, _PICTURES)
    scene = chosen_task(args)[0]
    q = None if args.at is None else joint_values(scene, "--at", args.at)
    with ProgressLine(args.json, "mapping"):
        found = gp.impact_map(
            scene,
            gp.ImpactCost(model=args.model),
            height=args.height,
            speed=args.speed,
            direction=args.direction,
            q=q,
            surface=args.surface,
            resolution=args.resolution,
        )
    text = str(found)
    if args.output is not None:
        from graceful_plan.viz.impact_maps import draw_impact_map

        draw_impact_map(found, scene, args.output)
        text += f"\n\nwrote {args.output}"
    show(args, found.to_document(), text)
    return DONE
