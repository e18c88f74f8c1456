"""Is it hard to break: interruptions at any moment, many goals, a hundred thousand motions, broken files and calls."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import graceful_plan as gp
from benchmarks import report, suite
from graceful_plan.core.compile import compile_scene
from graceful_plan.mobile.planners import DRIVING

Array = np.ndarray

TITLE = "Hardening: interruptions, many goals, many motions, broken files and calls"
ROOT = Path(__file__).parents[2]
WITHIN = 0.05
"""Of an interruption, until the call is over [s]."""
MEASURED = """\
"Interruptions": `plan` with 60 s to go is told to stop at a random moment, by `cancelled` or by Ctrl-C: of its first
half second for every planner for arms in turn, on a task of `tabletop` and where a wall makes the goal unreachable; of
its first two seconds for every planner for bases, in `warehouse_aisle`, where that is walled off, where one more walks
across, and with base and arm of `kitchen`. "Late" is how long the call took from then on. What is returned is either
SOLVED and judged anew, or CANCELLED; Ctrl-C raises KeyboardInterrupt.
"Goals": configurations of which a tenth or one is free, and poses of which all but one cannot be reached or not freely,
`time_limit=.3`. "Motions": the log of `benchmarks/many_motions.py`, which judges by its own means. "Files" and "calls":
`.ci/fuzz_readers.py` and `.ci/fuzz_native.py` (the latter with ASan and UBSan in CI, here without), all at once.
"""
WALLED = """<mujoco model="walled">
  <compiler angle="radian"/>
  <worldbody>
    <body name="wall" pos="0 0 0"><geom type="box" size=".05 2 2"/></body>
    <body name="cart/x">
      <joint name="cart/x" type="slide" axis="1 0 0" range="-1 1"/>
      <joint name="cart/y" type="slide" axis="0 1 0" range="-1 1"/>
      <joint name="cart/z" type="slide" axis="0 0 1" range="-1 1"/>
      <geom type="sphere" size=".05" mass="1"/><site name="cart/tool"/>
    </body>
  </worldbody>
</mujoco>"""


@dataclass(frozen=True, kw_only=True)
class Interruption:
    """What came of one."""

    planner: str
    place: str
    how: str
    late: float
    """From the interruption until the call was over [s]; negative if it ended by itself before."""
    ended: str
    honest: bool


def run(options: suite.Options) -> str:
    """Interrupt, plan to many goals, and read logs; return Markdown."""
    # A shell that puts a command in the background has it ignore Ctrl-C, and Python then does, too.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    arms, bases = options.pick((820, 180), quick=(60, 30))
    found = [interrupted(*what) for what in (*draws(ARMS, arms, 0.5), *draws(BASES, bases, 2.0))]
    in_time = [x for x in found if x.late >= 0.0]
    late = np.array([x.late for x in in_time])
    goals = {
        f"{n} goals, {free}": many_goals(n, free)
        for n in options.pick((300, 1000, 20_000), quick=(1000,))
        for free in FREE
    }
    goals |= {
        f"{n} grasps, all but one {where}": many_grasps(n, where)
        for n in options.pick((300, 1000), quick=(300,))
        for where in GRASPS
    }
    rows = [
        report.Target(
            what="interruptions after which there was no verified path, CANCELLED or KeyboardInterrupt",
            wanted="0",
            measured=f"{sum(not x.honest for x in found)} of {len(found)}",
            met=all(x.honest for x in found),
        ),
        report.Target(
            what=f"late by more than {1000 * WITHIN:.0f} ms",
            wanted="0",
            measured=f"{np.sum(late > WITHIN)} of {len(late)}",
            met=bool((late <= WITHIN).all()),
        ),
        *(goal_rows(goals)),
        motions(),
        *fuzzed(options),
    ]
    return "\n".join([MEASURED, report.targets(rows), by_planner(in_time)])


def draws(asked: Asked, count: int, latest: float) -> Iterator[tuple[str, str, str, float, int]]:
    """Yield planner, place, manner, moment and seed of interruptions."""
    rng = np.random.default_rng(0)
    planners, places = asked
    every = [(planner, place, how) for planner in planners for place in places for how in ("cancelled", "Ctrl-C")]
    for i in range(count):
        yield (*every[i % len(every)], float(rng.uniform(0.0, latest)), i)


@cache
def tabletop() -> tuple[Any, Any, gp.Scene]:
    """Return a task that can be solved."""
    task = suite.scene("tabletop").tasks["right_to_left"]
    return task.start, task.goal, task.scene


@cache
def walled() -> tuple[Any, Any, gp.Scene]:
    """Return a task whose goal is behind a wall."""
    given: dict[str, Any] = {"velocity": [1.0] * 3, "acceleration": [2.0] * 3}
    scene = gp.Scene.from_mjcf(WALLED, robot="cart/", tool="cart/tool", entities={"wall": "robust"}, **given)
    return [-0.5, 0.0, 0.0], [0.5, 0.0, 0.0], scene


@cache
def aisle() -> tuple[Any, Any, gp.Scene]:
    """Return a task for a base."""
    task = gp.load_scene("warehouse_aisle").tasks["bring_tools"]
    return task.start, task.goal, task.scene


@cache
def walled_off() -> tuple[Any, Any, gp.Scene]:
    """Return that task with a wall across the aisle."""
    start, goal, scene = aisle()
    return start, goal, scene.add_box("wall across", [0.05, 4.0, 1.0], [4.0, 0.0, 1.0])


@cache
def walked_across() -> tuple[Any, Any, gp.Scene]:
    """Return that task with somebody who walks across the aisle."""
    start, goal, scene = aisle()
    ways = [[4.0, -3.0, 0.85], [4.0, 3.0, 0.85]]
    walker = gp.MovingEntity(
        "walker", "adult", size=[0.25, 0.85], t=[0.0, 6.0], position=ways, spread=0.05, growth=0.05
    )
    return start, goal, scene.with_moving(walker)


@cache
def whole_body() -> tuple[Any, Any, gp.Scene]:
    """Return a task for a base and the arm on it."""
    task = gp.load_scene("kitchen").tasks["drain_pot"]
    return task.start, task.goal, task.scene


Asked = tuple[tuple[str, ...], tuple[str, ...]]
"""Planners, and where each of them is asked."""
PLACES = {
    "tabletop": tabletop,
    "behind a wall": walled,
    "aisle": aisle,
    "aisle, walled off": walled_off,
    "aisle, walked across": walked_across,
    "base and arm": whole_body,
}
ARMS: Asked = (tuple(gp.PLANNERS), ("tabletop", "behind a wall"))
BASES: Asked = (("auto", *DRIVING), ("aisle", "aisle, walled off", "aisle, walked across", "base and arm"))


def interrupted(planner: str, place: str, how: str, moment: float, seed: int) -> Interruption:
    """Interrupt one call."""
    start, goal, scene = PLACES[place]()
    compile_scene(scene)
    event, told = threading.Event(), [np.inf]

    def interrupt() -> None:
        told[0] = time.perf_counter()
        if how == "cancelled":
            event.set()
        else:
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)

    timer = threading.Timer(moment, interrupt)
    try:
        timer.start()
        given: dict[str, Any] = {"max_wait": 5.0} if scene.moving else {}
        given |= {"planner": planner, "seed": seed, "time_limit": 60.0, "cancelled": event.is_set}
        result = gp.plan(start, goal, scene, **given)
        over = time.perf_counter()
        timer.cancel()
        timer.join()
        ended = result.status.name
        solved = ended == "SOLVED" and gp.verify(result.unwrap(), scene, start=start, goal=goal).passed
        honest = solved or ended == "CANCELLED" or over < told[0]
    except KeyboardInterrupt:
        over, ended, honest = time.perf_counter(), "KeyboardInterrupt", how == "Ctrl-C"
        timer.join()
    return Interruption(planner=planner, place=place, how=how, late=over - told[0], ended=ended, honest=honest)


def by_planner(found: list[Interruption]) -> str:
    """Tabulate how late calls were."""
    groups: dict[tuple[str, str], list[Interruption]] = {}
    for x in found:
        groups.setdefault((x.planner, x.place), []).append(x)
    rows = []
    for (planner, place), some in groups.items():
        late = 1000.0 * np.array([x.late for x in some])
        ended = {word: sum(x.ended == word for x in some) for word in sorted({x.ended for x in some})}
        told = ", ".join(f"{n} {word}" for word, n in ended.items())
        rows.append((planner, place, len(some), f"{np.median(late):.1f}", f"{late.max():.1f}", told))
    return report.table(("planner", "place", "n", "late, median [ms]", "most [ms]", "ended"), rows)


FREE = ("a tenth usable", "one usable")


def many_goals(count: int, free: str) -> tuple[str, float]:
    """Plan to the nearest of many goals, a tenth or one of them usable; return the status and the seconds it took."""
    start, _, scene = tabletop()
    low, high = scene.limits.position.T
    q = np.random.default_rng(1).uniform(low, high, (12 * count, len(low)))
    clearance = gp.clearance(q, scene)
    usable = q[clearance > 0.0][: count // 10 if free == FREE[0] else 1]
    blocked = q[clearance < -0.05]  # by so much that they are not free by exact geometry either
    goals = blocked[np.arange(count) % len(blocked)]
    goals[np.linspace(0, count - 1, len(usable) + 2).astype(int)[1:-1]] = usable
    return timed(start, list(goals), scene)


GRASPS = {
    "inside of the table": ((0.55, 0.0, -0.25), (0.02, 0.02, 0.02)),
    "with the hand in its surface": ((0.5, 0.0, -0.01), (0.1, 0.2, 0.004)),
    "out of reach": ((1.3, 0.0, 0.5), (0.1, 0.1, 0.1)),
    "in a closed box": ((0.5, 0.5, 0.5), (0.03, 0.03, 0.03)),
}
"""Where grasps are that do not work, and how far they are spread [m]."""


def many_grasps(count: int, where: str) -> tuple[str, float]:
    """Plan to one of many poses, the last; all the others are somewhere else."""
    start, goal, scene = tabletop()
    middle, spread = GRASPS[where]
    rng = np.random.default_rng(0)
    poses = [gp.PoseGoal.at(rng.normal(middle, spread), rng.normal(size=4)) for _ in range(count)]
    poses[-1] = gp.PoseGoal.from_tool(np.atleast_2d(goal)[0], scene)
    if where == "in a closed box":
        scene = closed_box(scene, np.array(middle))
    compile_scene(scene)
    return timed(start, poses, scene)


def closed_box(scene: gp.Scene, middle: Array) -> gp.Scene:
    """Return a scene with six walls around a place in it."""
    for k in range(6):
        half, centre = np.full(3, 0.15), middle.copy()
        half[k // 2] = 0.01
        centre[k // 2] += 0.15 if k % 2 else -0.15
        scene = scene.add_box(f"wall {k}", half, centre)
    return scene


def timed(start: Any, goals: list[Any], scene: gp.Scene) -> tuple[str, float]:
    """Plan within .3 s; return the status and the seconds it took."""
    begun = time.perf_counter()
    result = gp.plan(start, goals, scene, time_limit=0.3, constraints=[])
    return result.status.name, time.perf_counter() - begun


def goal_rows(goals: dict[str, tuple[str, float]]) -> Iterator[report.Target]:
    """Yield what is said of many goals."""
    for what, (status, seconds) in goals.items():
        yield report.Target(
            what=f"{what}, within .3 s",
            wanted="SOLVED",
            measured=f"{status} after {seconds:.2f} s",
            met=status == "SOLVED" and seconds < 0.35,
        )


def motions() -> report.Target:
    """Say what the log of many motions says."""
    log = ROOT / "benchmarks" / "many_motions.jsonl"
    so_far = json.loads(log.read_text().splitlines()[-1])["so far"] if log.exists() else {}
    solved, wrong = so_far.get("SOLVED", 0), so_far.get("wrong", 0)
    return report.Target(
        what="motions in collision, over a limit by their cubics, or with wrong ends",
        wanted="0 of 100000",
        measured=f"{wrong} of {solved}",
        met=wrong == 0 and solved >= 100_000,
    )


def fuzzed(options: suite.Options) -> Iterator[report.Target]:
    """Break files and calls, and yield how many were taken wrongly."""
    files, calls = options.pick((20_000, 5000), quick=(400, 100))
    half = ["--files", str(files // 2)]
    jobs = {
        f"{files // 2} broken files": ["fuzz_readers.py", *half],
        f"{files // 2} other broken files": ["fuzz_readers.py", *half, "--seed", "1"],
        f"{calls} broken calls for each instruction set": ["fuzz_native.py", "--calls", str(calls)],
    }
    begun = {
        what: subprocess.Popen([sys.executable, str(ROOT / ".ci" / name), *given], stdout=subprocess.PIPE, text=True)
        for what, (name, *given) in jobs.items()
    }
    for what, process in begun.items():
        told = process.communicate()[0]
        last = told.splitlines()[-1:]
        met = bool(last) and last[0].endswith(" 0 wrong") and process.returncode == 0
        if not met:
            print(told, file=sys.stderr)
        yield report.Target(what=what, wanted="0 wrong", measured=last[0][-40:] if last else "crashed", met=met)
