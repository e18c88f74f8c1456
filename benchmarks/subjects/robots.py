"""Robot models of public packages: do they load, how fast, and are motions planned for them?"""

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
QUESTION = "Which robots from public packages load, and can motions be planned for them?"
HEADLINE = "robots with a motion"
DEPENDS_ON = (*suite.PLANNING, "benchmarks/package_robots.py", "benchmarks/exact_ompl.py")
CONFIGURATIONS = 2000


@dataclass(frozen=True, kw_only=True)
class Sizes:
    """Numbers of queries of a run, and their limits."""

    queries: int
    asked: int
    """Number of unsolved queries that OMPL gets."""
    seconds: float
    """Time limit of OMPL [s]."""


NORMAL = Sizes(queries=30, asked=5, seconds=4.0)
QUICK, LONG = Sizes(queries=30, asked=5, seconds=1.0), Sizes(queries=50, asked=10, seconds=10.0)
SOON, CALLED = 3.0, 0.95
"""Targets: time to a first motion without caches [s], share of free configurations that the kernels call free."""
MEASURED = """\
Models of the packages `example-robot-data` 6.0.0, `airo-models` 0.0.12 (UR5e), `rtb-data` 2.0.0 (iiwa 14), `robosuite`
1.5.2 (MJCF) and `gymnasium-robotics` 1.4.2 (Fetch), unchanged except that Fetch's base is fixed. The robots stand
alone; only Fetch has a floor and a table. The collision filters of robosuite let most links of an arm pass through each
other, so its models are loaded with `self_collision="links"`. "Load": read the model, find links that always touch, and
divide meshes of URDFs whose hulls touch too often. "Compile": cover the links with spheres. Both run without caches;
"again" is both with the caches of an earlier process. Of {configurations} configurations drawn uniformly within the
limits, "free" are those free by exact geometry on convex hulls, "called free" is the share of these that the kernels
call free, and "wrongly" the share of the others that the kernels call free. Queries: {queries} pairs of free
configurations, w = 0, first motion within 1 s, all verified. "OMPL": number of at most {asked} unsolved queries for
which OMPL's RRT-Connect finds a path by exact geometry alone, within {seconds:g} s.
Without one, a path may not exist: the upper arm of a UR cannot pass its own foot, so its shoulder angle (two turns) has
three disconnected ranges. "First": median time to a motion. "Pairs": pairs of links that may not touch. Robots that
cannot be read are listed below the table. Targets are for UR5e, UR5, iiwa, Kinova3, Panda, SO-101, Fetch and TIAGo.
"""

Array = np.ndarray


@dataclass(frozen=True, kw_only=True)
class RobotFigures:
    """Result for one robot."""

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
    """Measure every robot that is installed."""
    there = package_robots.loads()
    if not there:
        raise report.NotMeasured(f"none of the packages is installed; {package_robots.FOLDER} can name a folder")
    rows, unread, wanted = [], [], {}
    sizes = options.pick(NORMAL, quick=QUICK, long=LONG)
    for robot, load in there[: options.pick(len(there), quick=1)]:
        try:
            one = examine(load, sizes)
        except gp.GracefulPlanError as error:
            unread.append(f"{robot.name}: {type(error).__name__}, {error}")
            continue
        if robot.of_issue:
            wanted[robot.name] = one
        rows.append([
            robot.name, one.joints, one.pairs, report.quantity(one.load, " s"), report.quantity(one.compile, " s"),
            report.quantity(one.again, " s"), one.spheres,
            report.percent(one.free), report.percent(one.called), report.percent(one.wrongly),
            f"{one.solved} of {sizes.queries}", f"{one.ompl} of {one.asked}", report.quantity(1e3 * one.first, " ms"),
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
    others = f"Not read: {'; '.join(unread)}.\n" if unread else ""
    return "\n".join([_measured(sizes), report.targets(_targets(wanted)), report.table(header, rows), others])


def _measured(sizes: Sizes) -> str:
    return MEASURED.format(
        configurations=CONFIGURATIONS, queries=sizes.queries, asked=sizes.asked, seconds=sizes.seconds
    )


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


def examine(load: Callable[[], gp.Scene], sizes: Sizes = NORMAL) -> RobotFigures:
    """Load a robot and plan for it; OMPL gets the queries that are not solved."""
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
    pairs = q[free][: 2 * sizes.queries].reshape(-1, 2, q.shape[1])
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
        asked=len(unsolved[: sizes.asked]),
        ompl=sum(finds_path(start, goal, scene, sizes.seconds) for start, goal in unsolved[: sizes.asked]),
    )
