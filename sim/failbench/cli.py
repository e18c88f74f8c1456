"""The command line, `failbench`. Thin: it calls the public API, prints, and turns outcomes into exit codes.

0: done. 1: no motion, or a part of a sweep failed. 2: misuse. 130: interrupted.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path as FilePath
from typing import Any

import graceful_plan as gp
from failbench.basics.chunks import Rows
from failbench.basics.errors import SweepFailed
from failbench.calibrations.body_fit import BodyCalibration, calibrate_body
from failbench.calibrations.calibrate import Calibration
from failbench.calibrations.drop_fit import calibrate_footprint
from failbench.calibrations.effects_fit import EffectsCalibration, calibrate_effects
from failbench.calibrations.spill_fit import SpillCalibration, calibrate_spill
from failbench.fault.registry import to_document
from failbench.front_validation import validate_front
from failbench.pictures.playback import replay
from failbench.scenario import scenarios, usual_grasp
from failbench.simulated.world import SimSettings
from failbench.sweeps import summary
from failbench.sweeps.executors import Executor, LocalExecutor
from failbench.sweeps.sweep import JOURNAL, Generated, Progress, generate, read_sweep, resume, sweep_of
from failbench.sweeps.work import Motion, PlanSettings, Sweep, execution_of, jobs_of, run_chunk, scene_of
from failbench.validation import validate
from graceful_plan import GracefulPlanError, PlanningFailed, SettingError, documents

DONE, FAILED, MISUSE, INTERRUPTED = 0, 1, 2, 130


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    args = _parser().parse_args(argv)
    try:
        return args.run(args)
    except (GracefulPlanError, OSError, ImportError) as error:
        if isinstance(error, BrokenPipeError):
            # The reader went away, as `head` does; a second complaint at shutdown is kept from it.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return DONE
        print(f"failbench {args.command}: {error}", file=sys.stderr)
        return FAILED if isinstance(error, SweepFailed | PlanningFailed) else MISUSE
    except KeyboardInterrupt:
        folder = getattr(args, "folder", None)
        begun = folder is not None and (folder / JOURNAL).exists()
        print("interrupted" + (f"; to go on: failbench resume {folder}" if begun else ""), file=sys.stderr)
        return INTERRUPTED


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="failbench", description="Break a simulated robot on its way and see what it hits, and how hard."
    )
    parser.add_argument("--version", action="version", version=gp.__version__)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    listing = _command(commands, "scenarios", _scenarios, "list scenarios: a fault of some degree in a task of a scene")
    listing.add_argument("pattern", nargs="?", help="name or tag with * and ?, such as 'drop/*'; none: the families")

    run = _command(commands, "run", _run, "let one scenario happen a number of times")
    _add_scenario(run)

    judge = _command(commands, "validate", _validate, "compare what failures of a motion hit with what was predicted")
    judge.add_argument(
        "patterns",
        nargs="*",
        default=["drop/*/severe"],
        help="of scenarios, whose faults count (default drop/*/severe)",
    )
    judge.add_argument("--scene", default="tabletop", help="bundled scene or scene file (default tabletop)")
    judge.add_argument("--task", help="task of the scene (default: its first)")
    judge.add_argument("-n", type=int, default=400, help="number of failures (default 400)")
    judge.add_argument("--importance", action="store_true", help="fail more often where harm is predicted")
    _add_motion(judge)

    front = _command(commands, "validate-front", _validate_front, "compare the motions of a Pareto front in that way")
    front.add_argument("front", type=FilePath, help="file of `graceful-plan tune` or of ParetoFront.save")
    front.add_argument("patterns", nargs="*", default=["drop/*/severe"], help="of scenarios (default drop/*/severe)")
    front.add_argument("--scene", default="tabletop", help="bundled scene or scene file (default tabletop)")
    front.add_argument("--task", help="task of the scene (default: its first)")
    front.add_argument("-n", type=int, default=200, help="number of failures along each motion (default 200)")
    front.add_argument("--seed", type=int, default=0, help="of everything random (default 0)")
    front.add_argument("--horizon", type=float, default=1.0, metavar="S", help="seconds after the onset (default 1)")
    front.add_argument("--grasp", choices=("fingers", "weld"), help="what holds the object")

    make = _command(commands, "generate", _generate, "do a sweep over scenarios and write its dataset")
    make.add_argument("folder", type=FilePath, help="where journal and dataset go")
    make.add_argument("patterns", nargs="*", help="of scenarios, such as 'drop/*'; every fault on every task")
    make.add_argument("--sweep", type=FilePath, metavar="FILE", help="sweep as JSON, instead of patterns and options")
    make.add_argument("--dry-run", action="store_true", help="print the sweep as JSON and do nothing")
    make.add_argument("-n", type=int, default=32, help="rollouts of each fault on each task (default 32)")
    _add_motion(make)
    _add_executor(make)

    again = _command(commands, "resume", _resume, "go on with a sweep that was killed, interrupted or failed in part")
    again.add_argument("folder", type=FilePath, help="where it was begun")
    _add_executor(again)

    fit = _command(commands, "calibrate", _calibrate, "fit a model's constants to failures in bundled scenes")
    fit.add_argument("output", type=FilePath, help="YAML file for the constants, with where they come from")
    fit.add_argument("--model", choices=tuple(_CALIBRATIONS), default="footprint", help="which (default footprint)")
    fit.add_argument("--scenes", nargs="+", metavar="SCENE", help="bundled scenes, two or more (default: all)")
    fit.add_argument("-n", type=int, default=30, help="drops along each motion (default 30)")
    fit.add_argument("--repeats", type=int, default=2, help="motions of each kind for each task (default 2)")
    fit.add_argument("--seed", type=int, default=0, help="of everything random (default 0)")
    fit.add_argument("--drops", type=FilePath, metavar="FILE", help="keep the drops here, or take them if it is there")
    fit.add_argument("--workers", type=int, default=0, help="processes (default: one for each core)")

    show = _command(commands, "replay", _replay, "show a rollout of a scenario, or of a sweep")
    _add_scenario(show, "name of the scenario, or folder of a sweep")
    show.add_argument("--rollout", type=int, default=0, help="its number in the sweep, or in `run` (default 0)")
    show.add_argument(
        "--output", type=FilePath, help="folder for PNG frames, or .gif, .webp, .apng, .mp4; none: a viewer"
    )
    show.add_argument("--slow", type=float, default=1.0, help="how many times slower than in reality (default 1)")
    show.add_argument("--camera", help="name of a camera of the scene")
    return parser


def _command(commands: Any, name: str, run: Callable[[argparse.Namespace], int], text: str) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    parser.set_defaults(run=run)
    return parser


def _add_scenario(parser: argparse.ArgumentParser, text: str = "its name, SCENE/TASK/FAULT/DEGREE") -> None:
    parser.add_argument("scenario", help=text)
    parser.add_argument("-n", type=int, default=32, help="number of rollouts (default 32)")
    _add_motion(parser)


def _add_motion(parser: argparse.ArgumentParser) -> None:
    plan, settings = PlanSettings(), SimSettings()
    parser.add_argument(
        "--trajectory", type=FilePath, metavar="FILE", help="JSON file with the motion; else it is planned"
    )
    parser.add_argument("--w", type=float, default=plan.w, help=f"safety weight of the planner (default {plan.w:g})")
    parser.add_argument(
        "--iterations", type=int, default=plan.iterations, help=f"of the planner (default {plan.iterations})"
    )
    parser.add_argument(
        "--speed", type=float, default=plan.speed, help=f"fraction of the limits (default {plan.speed:g})"
    )
    parser.add_argument("--seed", type=int, default=0, help="of everything random (default 0)")
    parser.add_argument("--horizon", type=float, default=1.0, metavar="S", help="seconds after the onset (default 1)")
    parser.add_argument(
        "--grasp", choices=("fingers", "weld"), help="what holds the object (default: a weld where fingers cannot)"
    )
    parser.add_argument("--control", choices=("servo", "torque"), default=settings.control, help="what drives the arm")


def _add_executor(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--workers", type=int, default=0, help="processes (default: one for each core)")
    parser.add_argument("--executor", choices=("local", "ray"), default="local", help="who does it (default local)")


# --- commands --------------------------------------------------------------------------------------------------------


def _scenarios(args: argparse.Namespace) -> int:
    found = scenarios(args.pattern or "*")
    if args.json:
        _print(args, [{"name": s.name, "tags": s.tags, "fault": to_document(s.fault)} for s in found], "")
    elif args.pattern:
        print("\n".join(scenario.name for scenario in found))
    else:
        print(summary.families(found))
    return DONE


def _run(args: argparse.Namespace) -> int:
    sweep = _one(args).planned()
    rows: Rows = {"rollouts": [], "contacts": []}
    with _Bar(args) as bar:
        for chunk in sweep.chunks:
            for table, found in run_chunk(sweep, chunk).items():
                rows[table] += found
            bar.show(len(rows["rollouts"]), sweep.rollouts)
    document = {"schema": "failbench.run", "version": 1, "sweep": sweep.to_document(), **rows}
    _print(args, document, summary.rollouts(rows, scene_of(sweep.motions[0].scene, sweep.motions[0].task)))
    return DONE


def _validate(args: argparse.Namespace) -> int:
    tasks = gp.load_scene(args.scene).tasks
    motion = _motion(args, args.scene, args.task or next(iter(tasks), None))
    trajectory = motion.planned().trajectory
    assert trajectory is not None
    with _Bar(args) as bar:
        report = validate(
            trajectory,
            scene_of(motion.scene, motion.task),
            args.patterns,
            n=args.n,
            horizon=args.horizon,
            seed=args.seed,
            importance=args.importance,
            settings=SimSettings(control=args.control, grasp=motion.grasp or "fingers"),
            progress=bar.show,
        )
    _print(args, report.to_document(), str(report))
    return DONE


def _validate_front(args: argparse.Namespace) -> int:
    task = args.task or next(iter(gp.load_scene(args.scene).tasks), None)
    grasp = args.grasp or usual_grasp(args.scene, task)
    with _Bar(args, "motions") as bar:
        found = validate_front(
            args.front,
            scene_of(args.scene, task),
            args.patterns,
            n=args.n,
            horizon=args.horizon,
            seed=args.seed,
            settings=SimSettings(grasp=grasp),
            progress=bar.show,
        )
    _print(args, found.to_document(), str(found))
    return DONE


def _generate(args: argparse.Namespace) -> int:
    sweep = _sweep(args)
    if args.dry_run:
        print(documents.to_json(sweep.to_document()))
        return DONE
    with _Bar(args) as bar:
        made = generate(sweep, args.folder, executor=_executor(args), callback=bar.sweep)
    return _made(args, made)


def _resume(args: argparse.Namespace) -> int:
    with _Bar(args) as bar:
        made = resume(args.folder, executor=_executor(args), callback=bar.sweep)
    return _made(args, made)


def _made(args: argparse.Namespace, made: Generated) -> int:
    rows = made.manifest["rows"]
    document = {"folder": str(made.folder), "rows": rows, "content": made.manifest["content"]}
    _print(args, document, f"{rows['rollouts']} rollouts with {rows['contacts']} contacts in {made.folder}")
    return DONE


_CALIBRATIONS: Mapping[str, Callable[..., Calibration | SpillCalibration | BodyCalibration | EffectsCalibration]] = {
    "footprint": calibrate_footprint,
    "spill": calibrate_spill,
    "body": calibrate_body,
    "effects": calibrate_effects,
}


def _calibrate(args: argparse.Namespace) -> int:
    with _Bar(args, "motions") as bar:
        found = _CALIBRATIONS[args.model](
            args.scenes or gp.scenes(),
            n=args.n,
            repeats=args.repeats,
            seed=args.seed,
            processes=args.workers or os.cpu_count() or 1,
            drops=args.drops,
            progress=bar.show,
        )
    args.output.write_text(found.to_yaml(), encoding="utf-8")
    _print(args, found.to_document(), str(found))
    return DONE


def _replay(args: argparse.Namespace) -> int:
    folder = FilePath(args.scenario)
    sweep = read_sweep(folder) if folder.is_dir() else _one(args).planned()
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
    _print(args, {"files": names}, f"wrote {args.output}" if files else "")
    return DONE


# --- parts -----------------------------------------------------------------------------------------------------------


def _settings(args: argparse.Namespace) -> SimSettings:
    return SimSettings(control=args.control)


def _plan_settings(args: argparse.Namespace) -> PlanSettings:
    return PlanSettings(w=args.w, iterations=args.iterations, seed=args.seed, speed=args.speed)


def _motion(args: argparse.Namespace, scene: str, task: str | None) -> Motion:
    name, grasp = f"{scene}/{task}", args.grasp or usual_grasp(scene, task)
    if args.trajectory is None:
        return Motion(name=name, scene=scene, task=task, plan=_plan_settings(args), grasp=grasp)
    motion = documents.read_motion(args.trajectory)
    if isinstance(motion, gp.Path):
        held = scene_of(scene, task)
        motion = gp.retime(motion, held.limits, held.joints)
    return Motion(name=name, scene=scene, task=task, trajectory=motion, grasp=grasp)


def _one(args: argparse.Namespace) -> Sweep:
    """Return the sweep that does a single scenario."""
    scenario, *others = scenarios(args.scenario)
    if others:
        raise SettingError("scenario", args.scenario, f"one scenario, not {1 + len(others)}; `generate` does many")
    return Sweep(
        motions=(_motion(args, scenario.scene, scenario.task),),
        faults=(to_document(scenario.fault),),
        rollouts=args.n,
        horizon=args.horizon,
        seed=args.seed,
        settings=_settings(args),
    )


def _sweep(args: argparse.Namespace) -> Sweep:
    if (args.sweep is None) != bool(args.patterns):
        raise SettingError("patterns", " ".join(args.patterns), "patterns of scenarios, or --sweep FILE, and not both")
    if args.sweep is not None:
        return Sweep.from_json(args.sweep)
    sweep = sweep_of(
        args.patterns,
        args.n,
        plans=(_plan_settings(args),),
        horizon=args.horizon,
        seed=args.seed,
        settings=_settings(args),
        grasp=args.grasp,
    )
    if args.trajectory is None:
        return sweep
    motion, *others = sweep.motions
    if others:
        raise SettingError("--trajectory", str(args.trajectory), f"patterns of one task, not {1 + len(others)}")
    return dataclasses.replace(sweep, motions=(_motion(args, motion.scene, motion.task),))


def _executor(args: argparse.Namespace) -> Executor:
    if args.executor == "local":
        return LocalExecutor(workers=args.workers)
    from failbench.sweeps.ray_executor import RayExecutor

    return RayExecutor(workers=args.workers)


def _print(args: argparse.Namespace, document: Any, text: str) -> None:
    print(documents.to_json(document) if args.json else text)


class _Bar:
    """Shows how much is done, if somebody sits at a terminal."""

    def __init__(self, args: argparse.Namespace, unit: str = "rollouts") -> None:
        self.unit = unit
        self.shown = sys.stderr.isatty() and not args.json
        self.started = time.monotonic()

    def __enter__(self) -> _Bar:
        return self

    def __exit__(self, *_: object) -> None:
        if self.shown:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)

    def sweep(self, progress: Progress) -> None:
        """Overwrite the line with how far a sweep has come."""
        failed = f", {progress.failed} chunks FAILED" if progress.failed else ""
        self.show(progress.rollouts_done, progress.rollouts, failed)

    def show(self, done: int, total: int, note: str = "") -> None:
        """Overwrite the line with how many are done."""
        if self.shown:
            bar = "#" * (30 * done // total)
            seconds = time.monotonic() - self.started
            print(
                f"\r\x1b[K[{bar:<30}] {done}/{total} {self.unit}, {seconds:.0f} s{note}",
                end="",
                file=sys.stderr,
                flush=True,
            )


if __name__ == "__main__":
    sys.exit(main())
