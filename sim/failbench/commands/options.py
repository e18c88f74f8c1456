"""Options that several commands share: for the simulation of a scenario, and for its motion."""

from __future__ import annotations

import argparse
from pathlib import Path as FilePath

import graceful_plan as gp
from failbench.fault.registry import to_document
from failbench.scenario import scenarios
from failbench.simulated.world import SimSettings
from failbench.sweeps.definition import PlanSettings, Sweep, SweepMotion, scene_of
from graceful_plan import documents
from graceful_plan.exceptions import SettingError


def add_scenario(parser: argparse.ArgumentParser, text: str = "name of the scenario, SCENE/TASK/FAULT/DEGREE") -> None:
    """Add the arguments for a scenario, its number of rollouts, and its motion."""
    parser.add_argument("scenario", help=text)
    parser.add_argument("-n", type=int, default=32, help="number of rollouts (default 32)")
    add_motion(parser)


def add_motion(parser: argparse.ArgumentParser) -> None:
    """Add the arguments for the motion and its simulation."""
    plan, settings = PlanSettings(), SimSettings()
    parser.add_argument(
        "--trajectory", type=FilePath, metavar="FILE", help="JSON file with the motion (default: it is planned)"
    )
    parser.add_argument("--w", type=float, default=plan.w, help=f"safety weight of the planner (default {plan.w:g})")
    parser.add_argument(
        "--iterations", type=int, default=plan.iterations, help=f"iterations of the planner (default {plan.iterations})"
    )
    parser.add_argument(
        "--speed", type=float, default=plan.speed, help=f"fraction of the limits (default {plan.speed:g})"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of all random numbers (default 0)")
    parser.add_argument("--horizon", type=float, default=1.0, metavar="S", help="seconds after the onset (default 1)")
    add_grasp(parser)
    parser.add_argument(
        "--control", choices=("servo", "torque"), default=settings.control, help="how the arm is controlled"
    )


def add_grasp(parser: argparse.ArgumentParser) -> None:
    """Add the option for the grasp."""
    usual = SimSettings().grasp
    parser.add_argument(
        "--grasp", choices=("fingers", "weld"), default=usual, help=f"how the object is held (default {usual})"
    )


def sim_settings(args: argparse.Namespace) -> SimSettings:
    """Return the settings of the simulation."""
    return SimSettings(control=args.control, grasp=args.grasp)


def plan_settings(args: argparse.Namespace) -> PlanSettings:
    """Return the planning settings of a motion."""
    return PlanSettings(w=args.w, iterations=args.iterations, seed=args.seed, speed=args.speed)


def motion_of(args: argparse.Namespace, scene: str, task: str | None) -> SweepMotion:
    """Return the motion given in a file, or the settings to plan it."""
    name = f"{scene}/{task}"
    if args.trajectory is None:
        return SweepMotion(name=name, scene=scene, task=task, plan=plan_settings(args))
    motion = documents.read_motion(args.trajectory)
    if isinstance(motion, gp.Path):
        held = scene_of(scene, task)
        motion = gp.retime(motion, held.limits, held.joints)
    return SweepMotion(name=name, scene=scene, task=task, trajectory=motion)


def single(args: argparse.Namespace) -> Sweep:
    """Return the sweep of a single scenario."""
    scenario, *others = scenarios(args.scenario)
    if others:
        raise SettingError("scenario", args.scenario, f"one scenario, not {1 + len(others)}; `generate` runs many")
    return Sweep(
        motions=(motion_of(args, scenario.scene, scenario.task),),
        faults=(to_document(scenario.fault),),
        rollouts=args.n,
        horizon=args.horizon,
        seed=args.seed,
        settings=sim_settings(args),
    )
