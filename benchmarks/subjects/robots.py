"""Robots from URDF as their makers publish them: do they load, how long does it take, and what is planned?"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

import graceful_plan as gp
from benchmarks import report, suite
from graceful_plan.core import covers
from graceful_plan.core.compile import compile_scene
from graceful_plan.judge.exact import Judge
from graceful_plan.scene.urdf.reading import Packages

TITLE = "Robots from URDF"
FOLDER = "ROBOT_DATA"
"""Variable that names the folder with the models: `share` of the package example-robot-data."""
ROBOTS = (
    ("Panda", "panda_description/urdf/panda.urdf", "panda_hand_tcp", 0.03),
    ("UR5", "ur_description/urdf/ur5_robot.urdf", "tool0", None),
    ("UR3", "ur_description/urdf/ur3_robot.urdf", "tool0", None),
    ("xArm 7", "xarm_description/urdf/xarm7.urdf", "link_eef", None),
    ("SO-101", "so_arm_description/urdf/so101.urdf", "gripper_frame_link", None),
    ("Z1", "z1_description/urdf/z1.urdf", "gripperStator", None),
    ("Jaco 2", "kinova_description/robots/kinova.urdf", "j2s6s200_end_effector", None),
    ("TIAGo", "tiago_description/robots/tiago_no_hand.urdf", "arm_tool_link", None),
)
"""Name, file, link of the tool, position of the fingers."""
OTHERS = "ROBOT_WHEELS"
"""Variable that names a folder with the content of the packages airo-models 0.0.12 and rtb-data 2.0.0, if it is set."""
_IIWA = "rtbdata/xacro/kuka_description/kuka_lbr_iiwa"
OTHER_ROBOTS = (
    ("UR5e", "airo_models/arms/ur5e/ur5e.urdf", "tool0", {}),
    ("iiwa 14", f"{_IIWA}/urdf/lbr_iiwa_14_r820.urdf", "tool0", {"kuka_lbr_iiwa_support": _IIWA}),
)
"""Name, file, link of the tool, folders of packages by name."""
ACCELERATION = 5.0
CONFIGURATIONS, QUERIES = 600, 25
MEASURED = f"""\
Models of the package `example-robot-data` 6.0.0, one line of code each, nothing changed in them; robots alone,
without surroundings. "Load" reads the URDF, looks for links that always touch, and divides meshes where their hulls
touch too often; "compile" covers the links with spheres; both with nothing kept on disk. "Again": both in another
process that finds what the first one kept. Of {CONFIGURATIONS} configurations
drawn evenly within the limits, "free" are those that exact geometry on convex hulls calls so, and "called free" is
which share of them the kernels call free. "Wrongly": of the others, the share that the kernels call free. Queries:
{QUERIES} pairs of free configurations, w = 0, first motion within 1 s. Robots that are not in the table cannot be
read; why is below. UR5e and iiwa 14 are of the packages airo-models 0.0.12 and rtb-data 2.0.0. Arms of UR never
point down through their own foot, so that half of the pairs of a UR5 or UR5e have no path between them: the joint
of the shoulder turns by two turns, and goals are on the other side of where it would have to pass.
"""

Array = np.ndarray


@dataclass(frozen=True, kw_only=True)
class RobotFigures:
    """What came of one robot."""

    joints: int
    load: float
    compile: float
    again: float
    spheres: int
    free: float
    called: float
    wrongly: float
    solved: int
    first: float


def run(options: suite.Options) -> str:
    """Try every robot."""
    folder = Path(os.environ.get(FOLDER, ""))
    if not (folder / "example-robot-data").is_dir():
        return (
            f"{MEASURED}\nNot measured: the variable {FOLDER} does not name a folder with example-robot-data in it.\n"
        )
    rows, told = [], []
    for name, load in _loads(folder)[: options.pick(len(ROBOTS) + len(OTHER_ROBOTS), quick=1)]:
        try:
            one = examine(load)
        except gp.GracefulPlanError as error:
            told.append(f"{name}: {type(error).__name__}, {str(error).replace(str(folder), '')}")
            continue
        rows.append([
            name, one.joints, report.quantity(one.load, " s"), report.quantity(one.compile, " s"),
            report.quantity(one.again, " s"), one.spheres,
            report.percent(one.free), report.percent(one.called), report.percent(one.wrongly),
            f"{one.solved} of {QUERIES}", report.quantity(1e3 * one.first, " ms"),
        ])  # fmt: skip
    header = (
        "robot",
        "joints",
        "load",
        "compile",
        "again",
        "spheres",
        "free",
        "called free",
        "wrongly",
        "solved",
        "first, median",
    )
    others = f"Not read: {'; '.join(told)}.\n" if told else ""
    return f"{MEASURED}\n{report.table(header, rows)}\n{others}"


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


def _loads(folder: Path) -> list[tuple[str, Callable[[], gp.Scene]]]:
    """Return names of robots, and what loads each."""
    robots = folder / "example-robot-data" / "robots"
    loads: list[tuple[str, Callable[[], gp.Scene]]] = [
        (name, partial(_load, robots / file, tool, [folder], fingers)) for name, file, tool, fingers in ROBOTS
    ]
    others = os.environ.get(OTHERS)
    for name, file, tool, packages in OTHER_ROBOTS if others else ():
        places = {package: Path(others or "") / place for package, place in packages.items()}
        loads.append((name, partial(_load, Path(others or "") / file, tool, places, None)))
    return loads


def _load(path: Path, tool: str, packages: Packages, fingers: float | None) -> gp.Scene:
    return gp.Scene.from_urdf(path, tool=tool, acceleration=ACCELERATION, packages=packages, fingers=fingers)


def examine(load: Callable[[], gp.Scene]) -> RobotFigures:
    """Load a robot and plan for it."""
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
    solved, first = 0, []
    for start, goal in pairs:
        begun = time.perf_counter()
        result = gp.plan(start, goal, scene, w=0.0, time_limit=1.0, callback=lambda _: True)
        first.append(time.perf_counter() - begun)
        solved += result.status is gp.PlanStatus.SOLVED
    return RobotFigures(
        joints=len(scene.joints),
        load=loaded - started,
        compile=done - loaded,
        again=again,
        spheres=len(compiled.robot.sphere),
        free=float(free.mean()),
        called=float(called[free].mean()),
        wrongly=float(called[~free].mean()) if (~free).any() else 0.0,
        solved=solved,
        first=float(np.median(first)),
    )
