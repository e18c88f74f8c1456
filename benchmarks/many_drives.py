"""Plan ten thousand motions of bases on generated floors and judge each by means of its own.

python benchmarks/many_drives.py [--motions 10000] [--seed 0] [--log FILE]

A Jackal or a Fetch with its arm tucked crosses generated floors (`floor_plan`) with people and things on them, between
random free poses, at w = 0 and one time in four .3, at up to 1.5 and 1 m/s. What SOLVED motions have to be is worked
out here from the samples t, q and qd, without the library's judge: the cubics between samples never move sideways by
more than 1 mm/s and keep what body and wheels can do to 1 %, MuJoCo finds no contact deeper than a micrometre every
4 ms, and the ends are those that were asked for. One motion in fifty is driven in MuJoCo on wheels that turn. Budgets
are iterations. The log has a line every hundred motions, and one for everything that is wrong; a run goes on where its
log ends.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

import graceful_plan as gp  # noqa: E402
from benchmarks.many_motions import Checker, cubics  # noqa: E402
from failbench.mobile.driving import drive_base  # noqa: E402
from graceful_plan.compare.runs import machine  # noqa: E402
from graceful_plan.mobile.floor.generated import floor_plan  # noqa: E402

Array = np.ndarray

SAME_FLOOR = 20
"""Motions planned on one floor."""
SPEED = {"jackal": 0.75, "fetch": 1.0}
"""Share of what each can do: 1.5 and 1 m/s."""
ITERATIONS = 4000
"""Of searches, so that a busy machine plans the same motions as an idle one."""
SHARE = 0.25
"""Of motions that are planned with regard for failures."""
SIDEWAYS = 1e-3
"""[m/s]"""
BEYOND = 1.01
"""Share of a limit."""
ROOM = 0.005
"""Clearance of starts and goals [m]."""
TUCKED = (0.35, 1.32, 1.4, -0.2, 1.72, 0.0, 1.66, 0.0)
"""Arm of a Fetch."""
DRIVEN = 50
"""One motion in so many is driven on wheels."""
BETWEEN = 9
"""Moments that are looked at on each piece of a motion, its ends among them."""


def main() -> int:
    """Return how many motions were wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--motions", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--log", type=Path, default=Path(__file__).with_name("many_drives.jsonl"))
    args = parser.parse_args()
    lines = [json.loads(line) for line in args.log.read_text().splitlines()] if args.log.exists() else []
    last = next((line for line in reversed(lines) if "driven" in line), {})
    seen: Counter[str] = Counter(last.get("so far", {}))
    worst: dict[str, float] = dict(last.get("worst", {}))
    driven: dict[str, list[float]] = dict(last.get("driven", {}))
    floor = int(last.get("floors", 0))
    with args.log.open("a") as log:
        if not lines:
            log.write(json.dumps({"machine": machine.described()}) + "\n")
        told, begun = seen["SOLVED"] // 100, time.perf_counter()
        while seen["SOLVED"] < args.motions:
            for wrong in judged(np.random.default_rng((args.seed, floor)), seen, worst, driven):
                log.write(json.dumps({**wrong, "floor": floor}) + "\n")
                log.flush()
            floor += 1
            if seen["SOLVED"] // 100 > told or seen["SOLVED"] >= args.motions:
                told, took = seen["SOLVED"] // 100, time.perf_counter() - begun
                so_far = {"so far": dict(seen), "floors": floor, "worst": worst, "driven": driven}
                log.write(json.dumps({**so_far, "seconds": round(took)}) + "\n")
                log.flush()
    print(f"{dict(seen)} on {floor} floors; worst {worst}")
    return seen["wrong"]


def judged(
    rng: np.random.Generator, seen: Counter[str], worst: dict[str, float], driven: dict[str, list[float]]
) -> Iterator[dict[str, Any]]:
    """Plan on one floor, count what came of it, and yield what is wrong."""
    robot, number = str(rng.choice(list(SPEED))), int(rng.integers(2**31))
    scene = floor_plan(number, people=int(rng.integers(13))).floor.to_scene(robot)
    checker, base = Checker(scene), scene.base
    assert base is not None
    for start, goal in pairs(scene, rng):
        w, seed = 0.3 * float(rng.random() < SHARE), int(rng.integers(2**31))
        result = gp.plan(start, goal, scene, w=w, seed=seed, speed=SPEED[robot], iterations=ITERATIONS)
        seen[result.status.name] += 1
        if result.trajectory is None:
            continue
        motion = result.trajectory
        shares = rolling(motion, base)
        for name, value in shares.items():
            worst[name] = max(worst.get(name, 0.0), value)
        problems = [f"{name} is {far:.2g} away" for name, far in ends(motion, start, goal) if far > 1e-9]
        problems += [f"{name}: {value:.4g}" for name, value in shares.items() if value > BEYOND]
        problems += checker.touching(motion)
        seen["wrong"] += bool(problems)
        if problems:
            yield {"wrong": problems, "plan": number, "robot": robot, "w": w, "seed": seed}
        if seen["SOLVED"] % DRIVEN == 0:
            rolled = drive_base(motion, scene)
            driven.setdefault(robot, []).append(round(float(rolled.error.max()), 5))
            seen["touched while driven"] += bool(rolled.touched)


def pairs(scene: gp.Scene, rng: np.random.Generator) -> Iterator[tuple[Array, Array]]:
    """Yield starts and goals at random free poses of the base."""
    (lower, upper), n = scene.limits.position[:2].T, 400
    base = np.column_stack([rng.uniform(lower, upper, (n, 2)), rng.uniform(-np.pi, np.pi, n)])
    q = np.hstack([base, np.tile(TUCKED[: len(scene.joints) - 3], (n, 1))])
    free = q[gp.clearance(q, scene) > ROOM]
    for k in range(min(SAME_FLOOR, len(free) // 2)):
        yield free[2 * k], free[2 * k + 1]


def ends(motion: gp.Trajectory, start: Array, goal: Array) -> Iterator[tuple[str, float]]:
    """Yield how far the ends are from those that were asked for; headings a turn apart are one."""
    for name, has, wanted in (("start", motion.q[0], start), ("goal", motion.q[-1], goal)):
        off = has - wanted
        off[2] = np.remainder(off[2] + np.pi, 2.0 * np.pi) - np.pi
        yield name, float(np.abs(off).max())


def rolling(motion: gp.Trajectory, base: gp.DiffDrive) -> dict[str, float]:
    """Return the greatest shares of what is allowed: sideways speed, and limits of body and wheels."""
    s = np.linspace(0.0, 1.0, BETWEEN)[None, :, None]
    h, a, va, c, d = (part[:, None, :3] for part in cubics(motion))
    yaw = (a + s * (va + s * (c + s * d)))[..., 2]
    rate = (va + s * (2.0 * c + 3.0 * s * d)) / h
    push = (2.0 * c + 6.0 * s * d) / h**2
    cos, sin, omega = np.cos(yaw), np.sin(yaw), rate[..., 2]
    v, side = rate[..., 0] * cos + rate[..., 1] * sin, rate[..., 1] * cos - rate[..., 0] * sin
    gain = push[..., 0] * cos + push[..., 1] * sin + omega * side
    left, right = ((v + sign * omega * 0.5 * base.slip * base.track) / base.radius for sign in (-1.0, 1.0))
    shares = {
        "sideways": np.abs(side) / SIDEWAYS,
        "speed": np.abs(v) / base.v_max,
        "turning": np.abs(omega) / base.omega_max,
        "acceleration": np.abs(gain) / base.a_max,
        "acceleration of turning": np.abs(push[..., 2]) / base.alpha_max,
        "acceleration across": np.abs(v * omega) / base.lateral_max,
        "wheels": np.maximum(np.abs(left), np.abs(right)) * base.radius / base.rim_max,
    }
    return {name: float(value.max(initial=0.0)) for name, value in shares.items()}


if __name__ == "__main__":
    sys.exit(min(main(), 100))
