"""Commands about impact: explain, map and annotate."""

from __future__ import annotations

import argparse
from pathlib import Path as FilePath
from typing import Any

import graceful_plan as gp
from graceful_plan.exceptions import AnnotationError, EndpointError, SettingError
from graceful_plan.tools.console import (
    DEFAULT_SCENE,
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
from graceful_plan.tools.ending import complain
from graceful_plan.tools.parsing import DONE, FAILED
from graceful_plan.tools.progress import ProgressLine

_PICTURES = (".png", ".pdf", ".svg")


def add_to(commands: Any) -> None:
    """Add the commands of this module to the parser."""
    explain = add_command(commands, "explain", _explain, "explain the sources of the impact of a path or trajectory")
    explain.add_argument(
        "motion",
        type=FilePath,
        help="file with a path, a trajectory or the result of `plan`: .json, .csv, .parquet, .yaml",
    )
    add_scene(explain)
    add_model(explain, gp.ImpactCost().model)
    explain.add_argument(
        "--exposure", default="time", help="variable of the integral of the impact: time (default), length, waypoints"
    )
    explain.add_argument("--output", type=FilePath, metavar="FILE", help="draw it: FILE.png, .pdf or .svg")

    impact_map = add_command(commands, "map", _map, "map the impact of releasing the carried object")
    add_scene(impact_map)
    add_model(impact_map, "mixture")
    impact_map.add_argument("--height", type=float, required=True, metavar="M", help="height of its lowest point [m]")
    impact_map.add_argument("--speed", type=float, default=0.0, help="horizontal speed [m/s] (default 0)")
    impact_map.add_argument(
        "--direction", type=float, metavar="RAD", help="direction of the speed, from x towards y; default: all"
    )
    impact_map.add_argument(
        "--at", nargs="+", metavar="Q", help="configuration that sets its orientation; default: upright"
    )
    impact_map.add_argument(
        "--surface", type=float, metavar="Z", help="reference of the height; default: the table top"
    )
    impact_map.add_argument(
        "--resolution", type=float, default=0.02, metavar="M", help="width of a cell (default 0.02)"
    )
    impact_map.add_argument("--output", type=FilePath, metavar="FILE", help="draw it: FILE.png, .pdf or .svg")

    annotate = add_command(commands, "annotate", _annotate, "estimate severities of entities with a language model")
    annotate.add_argument(
        "--scene", default=DEFAULT_SCENE, help=f"bundled scene or scene file (default {DEFAULT_SCENE})"
    )
    annotate.add_argument("--endpoint", metavar="URL", help="base URL of an OpenAI-compatible server")
    annotate.add_argument("--model", help="name of the model")
    annotate.add_argument(
        "--key-variable", metavar="NAME", help="environment variable with the API key, if it needs one"
    )
    annotate.add_argument("--no-pictures", action="store_true", help="send names and sizes only")
    annotate.add_argument(
        "--timeout", type=float, default=60.0, metavar="S", help="seconds for each answer (default 60)"
    )
    annotate.add_argument("--output", type=FilePath, metavar="FILE", help="file to write: FILE.yaml")
    annotate.add_argument(
        "--dry-run", action="store_true", help="print what would be sent, without pictures; send nothing"
    )


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


def _annotate(args: argparse.Namespace) -> int:
    scene = gp.load_scene(args.scene)
    if args.dry_run:
        return _dry_run(args, scene)
    for option in ("endpoint", "model", "output"):
        if getattr(args, option) is None:
            raise SettingError(f"--{option}", None, "given, unless --dry-run is")
    check_file(args.output, (".yaml", ".yml"))
    try:
        with ProgressLine(args.json, "asking"):
            said = gp.annotate(
                scene,
                args.model,
                endpoint=args.endpoint,
                key_variable=args.key_variable,
                pictures=not args.no_pictures,
                timeout=args.timeout,
            )
    except (AnnotationError, EndpointError) as error:
        return complain(f"graceful-plan {args.command}", error, FAILED, as_json=args.json)
    from graceful_plan.annotation.agreement import compared

    said.save(args.output)
    agreement = compared(said, scene)
    lines = [f"{name}: {row.category}. {row.reason}" for name, row in said.rows.items()]
    lines += ["", f"compared with {scene.name}: {agreement}"]
    if not said.pictures and not args.no_pictures:
        lines.append("without pictures: off-screen OpenGL does not work here")
    lines.append(f"wrote {args.output}: read it before you use it")
    show(args, {"annotations": said.to_document(), "agreement": agreement.to_document()}, "\n".join(lines))
    return DONE


def _dry_run(args: argparse.Namespace, scene: gp.Scene) -> int:
    from graceful_plan.annotation.questions import question

    messages = question(scene, list(scene.entities), None)
    show(args, {"messages": messages}, "\n\n".join(f"{m['role']}:\n{m['content']}" for m in messages))
    return DONE
