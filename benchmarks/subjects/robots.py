"""Robots as their makers publish them: do they load, how long does it take, and what is planned?"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

import graceful_plan as gp
from benchmarks import package_robots, report, suite
from benchmarks.exact_ompl import finds_path
from graceful_plan.core import covers
from graceful_plan.core.compile import compile_scene
from graceful_plan.judge.exact import Judge
from graceful_plan.scene.contacts import unchecked_links

TITLE = "Robots from URDF"
CONFIGURATIONS, QUERIES = 2000, 50
ASKED, SECONDS = 10, 10.0
"""Of the queries that are not solved, how many OMPL is asked, and for how long [s]."""
SOON, CALLED = 3.0, 0.95
"""What is to be: first motion from nothing [s], and the share of free configurations that are called so."""
MEASURED = f"""\
Models of the packages `example-robot-data` 6.0.0, `airo-models` 0.0.12 (UR5e), `rtb-data` 2.0.0 (iiwa 14), `robosuite`
1.5.2 (MJCF) and `gymnasium-robotics` 1.4.2 (Fetch), nothing changed in them but that Fetch's base stands still; robots
alone, without surroundings, but for Fetch's floor and table. The filters of robosuite's models let all links of most
arms pass through each other: they are loaded with `self_collision="links"`. "Load" reads a model, looks for links that
always touch, and of URDFs divides meshes where their hulls
touch too often; "compile" covers the links with spheres; both with nothing kept on disk. "Again": both in another
process that finds what the first one kept. Of {CONFIGURATIONS} configurations
drawn evenly within the limits, "free" are those that exact geometry on convex hulls calls so, and "called free" is
which share of them the kernels call free. "Wrongly": of the others, the share that the kernels call free. Queries:
{QUERIES} pairs of free configurations, w = 0, first motion within 1 s; all motions are verified. "OMPL": of at most
{ASKED} queries that are not solved, for how many OMPL's RRT-Connect finds a path within {SECONDS:g} s by exact geometry
alone; where it is none, there may be none: upper arms of UR cannot pass their own foot, so
that joint angles of the shoulder, which turns by two turns, come in three ranges without a path between them. "First":
a motion, the median. "Pairs": of links that may not touch. Robots that are not in the table cannot be read; why is
below it. Targets are for UR5e, UR5, iiwa, Kinova3, Panda, SO-101, Fetch and TIAGo.
"""

Array = np.ndarray


@dataclass(frozen=True, kw_only=True)
class RobotFigures:
    """What came of one robot."""

    joints: int
    pairs: int
    load: float
    compile: float
    again: float
    spheres: int
    free: float
    called: float
    wrongly: float
    solved: int
    first: float
    asked: int
    ompl: int


def run(options: suite.Options) -> str:
    """Try every robot."""
    there = package_robots.loads()
    if not there:
        return f"{MEASURED}\nNot measured: there is none of the packages; {package_robots.FOLDER} may name a folder.\n"
    rows, told, wanted = [], [], {}
    for robot, load in there[: options.pick(len(there), quick=1)]:
        try:
            one = examine(load, seconds=options.pick(SECONDS, quick=1.0))
        except gp.GracefulPlanError as error:
            told.append(f"{robot.name}: {type(error).__name__}, {error}")
            continue
        if robot.of_issue:
            wanted[robot.name] = one
        rows.append([
            robot.name, one.joints, one.pairs, report.quantity(one.load, " s"), report.quantity(one.compile, " s"),
            report.quantity(one.again, " s"), one.spheres,
            report.percent(one.free), report.percent(one.called), report.percent(one.wrongly),
            f"{one.solved} of {QUERIES}", f"{one.ompl} of {one.asked}", report.quantity(1e3 * one.first, " ms"),
        ])  # fmt: skip
    header = (
        "robot",
        "joints",
        "pairs",
        "load",
        "compile",
        "again",
        "spheres",
        "free",
        "called free",
        "wrongly",
        "solved",
        "OMPL",
        "first",
    )
    others = f"Not read: {'; '.join(told)}.\n" if told else ""
    return "\n".join([MEASURED, report.targets(_targets(wanted)), report.table(header, rows), others])


def _targets(robots: dict[str, RobotFigures]) -> Iterator[report.Target]:
    reached = {
        f"robots that have a first motion within {SOON:g} s of nothing": [
            name for name, one in robots.items() if one.load + one.compile + one.first <= SOON
        ],
        f"robots of whose free configurations {CALLED:.0%} are called free": [
            name for name, one in robots.items() if one.called >= CALLED
        ],
        "robots with a motion for all queries for which OMPL finds a path": [
            name for name, one in robots.items() if one.ompl == 0
        ],
    }
    for what, names in reached.items():
        missing = ", ".join(name for name in robots if name not in names)
        measured = f"{len(names)} of {len(robots)}" + (f", not {missing}" if missing else "")
        yield report.Target(what=what, wanted=f"all {len(robots)}", measured=measured, met=len(names) == len(robots))


@contextmanager
def _cache_in(folder: str) -> Generator[None]:
    before = os.environ.get("XDG_CACHE_HOME")
    os.environ["XDG_CACHE_HOME"] = folder
    try:
        yield
    finally:
        os.environ.pop("XDG_CACHE_HOME")
        if before is not None:
            os.environ["XDG_CACHE_HOME"] = before


def examine(load: Callable[[], gp.Scene], seconds: float = SECONDS) -> RobotFigures:
    """Load a robot and plan for it; OMPL has so many seconds for a query that is not solved."""
    with tempfile.TemporaryDirectory() as empty, _cache_in(empty):
        started = time.perf_counter()
        scene = load()
        loaded = time.perf_counter()
        compiled = compile_scene(scene)
        done = time.perf_counter()
        covers.forget()
        compile_scene(load())
        again = time.perf_counter() - done
    lower, upper = scene.limits.position.T
    q = np.random.default_rng(0).uniform(lower, upper, (CONFIGURATIONS, len(scene.joints)))
    judge = Judge(scene)
    touched = {touch.sample for touch in judge.touches(q) if judge.is_violation(touch, at_end=False)}
    free = np.array([k not in touched for k in range(len(q))])
    called = compiled.kernels.free(q)
    pairs = q[free][: 2 * QUERIES].reshape(-1, 2, q.shape[1])
    unsolved, first = [], []
    for start, goal in pairs:
        begun = time.perf_counter()
        result = gp.plan(start, goal, scene, w=0.0, time_limit=1.0, callback=lambda _: True)
        first.append(time.perf_counter() - begun)
        if result.status is not gp.PlanStatus.SOLVED:
            unsolved.append((start, goal))
    return RobotFigures(
        joints=len(scene.joints),
        pairs=unchecked_links(scene.model, scene.robot_bodies, scene.collision_pairs(), scene.allowed_contacts)[0],
        load=loaded - started,
        compile=done - loaded,
        again=again,
        spheres=len(compiled.robot.sphere),
        free=float(free.mean()),
        called=float(called[free].mean()),
        wrongly=float(called[~free].mean()) if (~free).any() else 0.0,
        solved=len(pairs) - len(unsolved),
        first=float(np.median(first)),
        asked=len(unsolved[:ASKED]),
        ompl=sum(finds_path(start, goal, scene, seconds) for start, goal in unsolved[:ASKED]),
    )
