"""Commands for single scenarios: list them, run one, show a rollout."""

from __future__ import annotations

import argparse
from pathlib import Path as FilePath
from typing import Any

from failbench.basics.chunks import Rows
from failbench.commands.options import add_scenario, single
from failbench.commands.output import Answer, Bar
from failbench.fault.registry import to_document
from failbench.pictures.playback import replay
from failbench.report import loudly
from failbench.scenario import scenarios
from failbench.sweeps import summary
from failbench.sweeps.definition import scene_of
from failbench.sweeps.sweep import read_sweep
from failbench.sweeps.work import execution_of, jobs_of, run_chunk
from graceful_plan.tools.console import add_command


def add(commands: Any) -> None:
    """Add the commands to the parser."""
    listing = add_command(
        commands, "scenarios", _scenarios, "list scenarios: a fault of some degree in a task of a scene"
    )
    listing.add_argument(
        "pattern", nargs="?", help="name or tag with * and ?, such as 'drop/*' (default: list the families)"
    )

    run = add_command(commands, "run", _run, "simulate one scenario a number of times")
    add_scenario(run)

    show = add_command(commands, "replay", _replay, "show a rollout of a scenario, or of a sweep")
    add_scenario(show, "name of the scenario, or folder of a sweep")
    show.add_argument(
        "--rollout", type=int, default=0, help="number of the rollout in the sweep, or in `run` (default 0)"
    )
    show.add_argument(
        "--output", type=FilePath, help="folder for PNG frames, or .gif, .webp, .apng, .mp4 (default: a viewer)"
    )
    show.add_argument("--slow", type=float, default=1.0, help="slow-down factor (default 1)")
    show.add_argument("--camera", help="name of a camera of the scene")


def _scenarios(args: argparse.Namespace) -> Answer:
    found = scenarios(args.pattern or "*")
    text = "\n".join(scenario.name for scenario in found) if args.pattern else summary.families(found)
    return Answer([{"name": s.name, "tags": s.tags, "fault": to_document(s.fault)} for s in found], text)


def _run(args: argparse.Namespace) -> Answer:
    sweep = single(args).planned()
    rows: Rows = {"rollouts": [], "contacts": []}
    with Bar(args) as bar:
        for chunk in sweep.chunks:
            for table, found in run_chunk(sweep, chunk).items():
                rows[table] += found
            bar.show(len(rows["rollouts"]), sweep.rollouts)
    healthy = execution_of(sweep, 0).healthy
    document = {
        "schema": "failbench.run_rollouts",
        "version": 2,
        "healthy": healthy.to_document(),
        "sweep": sweep.to_document(),
        **rows,
    }
    text = summary.rollouts(rows, scene_of(sweep.motions[0].scene, sweep.motions[0].task))
    loud = loudly(healthy)
    return Answer(document, f"{loud}\n\n{text}" if loud else text)


def _replay(args: argparse.Namespace) -> Answer:
    folder = FilePath(args.scenario)
    sweep = read_sweep(folder) if folder.is_dir() else single(args).planned()
    motion, fault, i = sweep.place(args.rollout)
    files = replay(
        execution_of(sweep, motion),
        jobs_of(sweep, motion, fault)[i],
        output=args.output,
        horizon=sweep.horizon,
        slow=args.slow,
        camera=args.camera,
    )
    names = [str(file) for file in files]
    return Answer({"files": names}, f"wrote {args.output}" if files else "")
