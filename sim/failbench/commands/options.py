"""Options that several commands share, and what they mean: how a scenario is run, and along which motion."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path as FilePath
from typing import Any

import graceful_plan as gp
from failbench.commands.output import Answer
from failbench.fault.registry import to_document
from failbench.scenario import scenarios
from failbench.simulated.world import SimSettings
from failbench.sweeps.work import PlanSettings, Sweep, SweepMotion, scene_of
from graceful_plan import documents
from graceful_plan.exceptions import SettingError


def add_command(
    commands: Any, name: str, run: Callable[[argparse.Namespace], Answer], text: str
) -> argparse.ArgumentParser:
    """Add a command that `run` answers."""
    parser: argparse.ArgumentParser = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    parser.set_defaults(run=run)
    return parser


def add_scenario(parser: argparse.ArgumentParser, text: str = "its name, SCENE/TASK/FAULT/DEGREE") -> None:
    """Add what says which scenario, how often, and along which motion."""
    parser.add_argument("scenario", help=text)
    parser.add_argument("-n", type=int, default=32, help="number of rollouts (default 32)")
    add_motion(parser)


def add_motion(parser: argparse.ArgumentParser) -> None:
    """Add what says along which motion the robot fails, and how that is simulated."""
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
    add_grasp(parser)
    parser.add_argument("--control", choices=("servo", "torque"), default=settings.control, help="what drives the arm")


def add_grasp(parser: argparse.ArgumentParser) -> None:
    """Add the option that says what holds the object."""
    usual = SimSettings().grasp
    parser.add_argument(
        "--grasp", choices=("fingers", "weld"), default=usual, help=f"what holds the object (default {usual})"
    )


def sim_settings(args: argparse.Namespace) -> SimSettings:
    """Return how the scenes are simulated."""
    return SimSettings(control=args.control, grasp=args.grasp)


def plan_settings(args: argparse.Namespace) -> PlanSettings:
    """Return how a motion is planned."""
    return PlanSettings(w=args.w, iterations=args.iterations, seed=args.seed, speed=args.speed)


def motion_of(args: argparse.Namespace, scene: str, task: str | None) -> SweepMotion:
    """Return the motion that was given in a file, or how to plan it."""
    name = f"{scene}/{task}"
    if args.trajectory is None:
        return SweepMotion(name=name, scene=scene, task=task, plan=plan_settings(args))
    motion = documents.read_motion(args.trajectory)
    if isinstance(motion, gp.Path):
        held = scene_of(scene, task)
        motion = gp.retime(motion, held.limits, held.joints)
    return SweepMotion(name=name, scene=scene, task=task, trajectory=motion)


def single(args: argparse.Namespace) -> Sweep:
    """Return the sweep that does a single scenario."""
    scenario, *others = scenarios(args.scenario)
    if others:
        raise SettingError("scenario", args.scenario, f"one scenario, not {1 + len(others)}; `generate` does many")
    return Sweep(
        motions=(motion_of(args, scenario.scene, scenario.task),),
        faults=(to_document(scenario.fault),),
        rollouts=args.n,
        horizon=args.horizon,
        seed=args.seed,
        settings=sim_settings(args),
    )
