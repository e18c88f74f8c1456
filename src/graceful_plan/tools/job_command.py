"""The command `job`: plan a whole task from a job file."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Mapping
from pathlib import Path as FilePath
from typing import Any

import graceful_plan as gp
from graceful_plan import documents
from graceful_plan.costs.objective import DEFAULT_WEIGHT
from graceful_plan.job.job_planning import DEFAULT_TIME_LIMIT
from graceful_plan.job.job_result import JobMotion, JobResult, JobStatus
from graceful_plan.job.rejected import Rejected
from graceful_plan.tools.console import add_budget, add_command, budget, check_file, check_folder, show
from graceful_plan.tools.parsing import DONE, FAILED
from graceful_plan.tools.progress import ProgressLine
from graceful_plan.tools.validation import check_failures, validate_job


def add_to(commands: Any) -> None:
    """Add the command to the parser."""
    job = add_command(commands, "job", _job, "plan a whole task: what comes first, by which grasp, to which place")
    job.add_argument("file", type=FilePath, metavar="FILE", help="job file; see docs/jobs.md")
    job.add_argument("--w", type=float, default=DEFAULT_WEIGHT, help=f"safety weight (default {DEFAULT_WEIGHT:g})")
    job.add_argument("--grasps", type=int, default=4, metavar="N", help="grasps of each object (default 4)")
    job.add_argument("--validate", type=int, default=0, metavar="N", help="simulate N failures during the job")
    job.add_argument("--export", type=FilePath, metavar="FOLDER", help="write job.json and a trajectory per motion")
    job.add_argument("--output", type=FilePath, metavar="FILE", help="write a page with the timeline: FILE.html")
    add_budget(job, DEFAULT_TIME_LIMIT)


def _job(args: argparse.Namespace) -> int:
    check_failures(args.validate)
    if args.export is not None:
        check_folder(args.export)
    check_file(args.output, (".html",))
    job = gp.load_job(args.file)
    validation = None
    with ProgressLine(args.json, "planning the job") as progress:
        result = gp.plan_job(job, args.w, grasps=args.grasps, **budget(args))
        solved = result.status is JobStatus.SOLVED
        if solved and args.validate:
            progress.stage(f"FailBench: {args.validate} failures")
            validation = validate_job(result, args.validate, seed=args.seed)
    document, files = _document(result), []
    if validation is not None:
        document["validation"] = validation.document
    if solved and args.export is not None:
        files = _export(result, document, args.export)
    text = [str(result)]
    text += ["", validation.text] if validation is not None else []
    text += ["", f"wrote {len(files)} files to {args.export}"] if files else []
    if args.output is not None:
        from graceful_plan.viz.job_page import write_job_page

        title = f"{job.scene.notes.name}, {args.file.stem}"
        write_job_page(result, args.output, observed=None if validation is None else validation.document, title=title)
        text += ["", f"wrote {args.output}"]
    show(args, document, "\n".join(text))
    return DONE if solved else FAILED


def _document(result: JobResult) -> dict[str, Any]:
    names = iter(_names(result))
    return {
        "schema": "graceful_plan.job",
        "version": 1,
        "status": result.status.name,
        "detail": result.detail,
        "cost": documents.cost_document(result.cost),
        "lower_bound": result.lower_bound,
        "exhaustive": result.exhaustive,
        "duration": result.duration,
        "steps": [
            {
                "kind": step.kind,
                "object": step.name,
                "duration": step.duration,
                "cost": documents.cost_document(step.cost),
                "motions": [_motion(piece, next(names)) for piece in step.pieces],
            }
            for step in result.steps
        ],
        "rejected": [_rejected(one) for one in result.rejected],
        "seconds": dict(result.stats),
    }


def _rejected(one: Rejected) -> dict[str, Any]:
    difference = one.difference
    return {
        "actions": [{"kind": kind, "object": name} for kind, name in one.actions],
        "reason": one.reason.name,
        "why": one.why,
        "complete": one.is_complete,
        "cost": None if one.cost is None else documents.cost_document(one.cost),
        "difference": None if math.isnan(difference) else difference,
        "lower_bound": one.lower_bound,
    }


def _motion(piece: JobMotion, name: str) -> Mapping[str, Any]:
    return {"label": piece.label, "file": name, "duration": piece.trajectory.duration}


def _names(result: JobResult) -> Iterator[str]:
    """Yield the file names of all motions, in their order."""
    pieces = [(step, piece) for step in result.steps for piece in step.pieces]
    for k, (step, piece) in enumerate(pieces):
        yield f"{k + 1:02d}_{step.kind}_{step.name}_{piece.label}.json".replace("/", "_")


def _export(result: JobResult, document: Mapping[str, Any], folder: FilePath) -> list[FilePath]:
    folder.mkdir(parents=True, exist_ok=True)
    pieces = [piece for step in result.steps for piece in step.pieces]
    files = [folder / name for name in _names(result)]
    for piece, file in zip(pieces, files, strict=True):
        documents.write_motion(piece.trajectory, file)
    files.append(folder / "job.json")
    files[-1].write_text(documents.to_json(document) + "\n", encoding="utf-8")
    return files
