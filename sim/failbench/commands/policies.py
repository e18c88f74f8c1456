"""The command that evaluates a policy under faults."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from typing import Any

import graceful_plan as gp
from failbench.commands.output import Answer, Bar
from failbench.report import FAILURES_PER_HOUR
from graceful_plan.tools.console import add_command

_RECOVERIES = ("none", "stop", "replan")


def add(commands: Any) -> None:
    """Add the command to the parser."""
    usual = "plan, plan0 (w = 0), scripted, reach (trained), or your own package.module:factory"
    judge = add_command(commands, "policy", _policy, "evaluate a policy on a task, healthy and with faults")
    judge.add_argument("policy", help=usual)
    judge.add_argument(
        "patterns",
        nargs="*",
        default=["*/*/severe"],
        help="patterns of scenarios, of which the faults are used (default */*/severe)",
    )
    judge.add_argument("--scene", default="tabletop", help="bundled scene or scene file (default tabletop)")
    judge.add_argument("--task", help="task of the scene (default: its first)")
    judge.add_argument("-n", type=int, default=20, help="episodes without failure, and with each fault (default 20)")
    judge.add_argument("--seed", type=int, default=0, help="seed of all random numbers (default 0)")
    judge.add_argument("--horizon", type=float, default=1.0, metavar="S", help="seconds after the onset (default 1)")
    judge.add_argument("--period", type=float, default=0.02, metavar="S", help="time between actions")
    judge.add_argument("--noise", type=float, default=0.02, metavar="RAD", help="standard deviation of the start")
    judge.add_argument(
        "--limit", type=float, metavar="S", help="time limit of an episode (default: from the straight path)"
    )
    judge.add_argument("--speed", type=float, default=0.5, help="fraction of the limits (default 0.5)")
    judge.add_argument(
        "--camera", action="append", default=[], help="camera whose pictures the policy gets; may be repeated"
    )
    judge.add_argument("--recovery", choices=_RECOVERIES, default="none", help="reaction to a detected fault")
    judge.add_argument("--delay", type=float, default=0.1, metavar="S", help="detection delay after the onset")
    judge.add_argument(
        "--rate", type=float, default=FAILURES_PER_HOUR, help=f"failures per hour (default {FAILURES_PER_HOUR:g})"
    )
    judge.add_argument("--grasp", choices=("fingers", "weld"), default="fingers", help="how the object is held")


def _policy(args: argparse.Namespace) -> Answer:
    # Imported here, since no other command needs them.
    from failbench import policies
    from failbench.simulated.world import SimSettings

    tasks = gp.load_scene(args.scene).tasks
    name = f"{args.scene}/{args.task or next(iter(tasks), '')}"
    settings = policies.PolicySettings(
        period=args.period,
        limit=args.limit,
        horizon=args.horizon,
        noise=args.noise,
        speed=args.speed,
        cameras=tuple(args.camera),
        simulation=SimSettings(grasp=args.grasp),
    )
    recoveries: Mapping[str, policies.Recovery | None] = {
        "none": None,
        "stop": policies.StopOnFailure(),
        "replan": policies.ReplanOnFailure(),
    }
    known: Mapping[str, Callable[[], policies.PolicyFactory]] = {
        "plan": policies.planned,
        "plan0": lambda: policies.planned(0.0),
        "scripted": lambda: policies.scripted,
        "reach": lambda: policies.reach,
    }
    factory = known[args.policy]() if args.policy in known else policies.imported_policy(args.policy)
    with Bar(args, "episodes") as bar:
        report = policies.evaluate(
            policies.policy_task(name, settings),
            factory,
            args.patterns,
            n=args.n,
            seed=args.seed,
            recovery=recoveries[args.recovery],
            delay=args.delay,
            rate=args.rate,
            progress=bar.show,
        )
    return Answer(report.to_document(), str(report))
