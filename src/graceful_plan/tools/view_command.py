"""Command `view`, which opens the viewer."""

from __future__ import annotations

import argparse
import webbrowser
from typing import Any

import graceful_plan as gp
from graceful_plan import documents
from graceful_plan.costs.objective import DEFAULT_WEIGHT
from graceful_plan.tools.console import add_command, chosen_task, show
from graceful_plan.tools.parsing import DONE
from graceful_plan.viewer.opening import HOST, PORT


def add_to(commands: Any) -> None:
    """Add the command to the parser."""
    parser = add_command(commands, "view", _view, "show a scene with its motions or failures in a browser")
    what = (
        "bundled scene or scene file, a JSON file with a motion, such as the output of `plan --json`, or the folder of"
        " a FailBench dataset (default tabletop)"
    )
    parser.add_argument("what", nargs="?", default="tabletop", metavar="SCENE|RESULT.json|DATASET", help=what)
    parser.add_argument("--scene", default="tabletop", help="scene of a motion: bundled scene or scene file")
    parser.add_argument("--task", help="task of the scene; default: its first")
    parser.add_argument(
        "--w", type=float, default=DEFAULT_WEIGHT, help=f"initial safety weight (default {DEFAULT_WEIGHT:g})"
    )
    parser.add_argument("--time-limit", type=float, metavar="S", help="seconds for each motion (default 1; driving 5)")
    parser.add_argument("--host", default=HOST, help=f"address to listen at (default {HOST}: this machine only)")
    parser.add_argument("--port", type=int, default=PORT, help=f"port (default {PORT}, or the next free one)")
    parser.add_argument("--dark", action="store_true", help="dark theme")
    parser.add_argument("--open", action="store_true", help="open the page in the default browser")


def _view(args: argparse.Namespace) -> int:
    settings = {"w": args.w, "time_limit": args.time_limit, "host": args.host, "port": args.port, "dark": args.dark}
    if args.what.endswith(".json"):
        motion = documents.read_motion(args.what)
        viewer = gp.view(motion, chosen_task(args)[0], **settings)
    else:
        viewer = gp.view(args.what, task=args.task, **settings)
    with viewer:
        show(args, {"url": viewer.url}, f"{viewer.url}   (end with Ctrl-C)")
        if args.open:
            webbrowser.open(viewer.url)
        viewer.wait()
    return DONE
