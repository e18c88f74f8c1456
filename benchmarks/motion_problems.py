"""Generate problems of the MotionBenchMaker type, from a seed: a Panda that reaches into furniture.

Seven kinds follow the published description, with other sizes: three bookshelves, an open box, a cage, a table from
above and from below. The furniture is rotated about the base and shifted, targets are shifted on their boards, and the
hand reaches for a target with a random tilt. The motion starts at the ready pose or at another such reach and ends in
one configuration. As in the original set, a problem is only kept if a planner solves it in a long time. The files are
in robometrics' YAML, so the usual reader loads them.

References:
    Chamzas et al., "MotionBenchMaker: a tool to generate and benchmark motion planning datasets", RA-L 2022.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

import graceful_plan as gp
from graceful_plan.compare.problems.motion_problem import Obstacle, ProblemFile
from graceful_plan.core.compile import compile_scene
from graceful_plan.judge.exact import state_contacts
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.query.endpoints.ik import solve_ik

Array = np.ndarray

READY = (0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785)
BOARD = 0.02
"""Half of the thickness of boards [m]."""
SOLVABLE_WITHIN = 10.0
"""Time limit of the planner that decides whether a problem is kept [s]."""
_CLEARANCE = 0.003
"""Clearance of starts and goals [m], so that no problem begins or ends in a tight place."""
_HAND = 0.1034
"""Distance of the tool from the hand's origin [m]."""


@dataclass(frozen=True, kw_only=True)
class Grip:
    """A target: position of the tool and directions of approach, in the furniture's frame."""

    position: tuple[float, float, float]
    approach: tuple[float, float, float]
    """Directions of the tool's z axis before tilting."""
    tilt: float = 0.25
    """Largest tilt [rad]."""


@dataclass(frozen=True, kw_only=True)
class Furniture:
    """Boxes, cylinders and targets."""

    shapes: tuple[tuple[str, str, tuple[float, ...], tuple[float, float, float]], ...]
    """Name, kind, size as in `Obstacle`, position."""
    reaches: tuple[Grip, ...]
    place: tuple[float, float, float]
    """Origin of the furniture before rotation and shift [m]."""
    turn: float
    """Largest angle about the robot's base [rad]."""
    shift: tuple[float, float, float] = (0.08, 0.08, 0.08)
    """Largest shift [m]."""


def _can(name: str, x: float, y: float, board: float) -> tuple[str, str, tuple[float, ...], tuple[float, float, float]]:
    return name, "cylinder", (0.03, 0.07), (x, y, board + 0.071)


def _shelf(rng: np.random.Generator, boards: int, gap: float, width: float, dividers: bool) -> Furniture:
    """Boards one above the other, open in front; cans near the front edge of each but the top one."""
    depth, height = 0.3, boards * gap
    shapes: list[Any] = [
        (f"board{k}", "box", (depth, 0.5 * width, BOARD), (depth, 0.0, k * gap)) for k in range(boards + 1)
    ]
    shapes += [
        (f"side{s:+.0f}", "box", (depth, BOARD, 0.5 * height), (depth, s * 0.5 * width, 0.5 * height)) for s in (-1, 1)
    ]
    if dividers:
        shapes.append(("divider", "box", (depth, BOARD, 0.5 * height), (depth, 0.0, 0.5 * height)))
    reaches = []
    for k in range(boards):
        for column in (-1, 0, 1) if not dividers else (-1, 1):
            y = column * width * (0.25 if dividers else 0.3) + rng.uniform(-0.05, 0.05)
            x = rng.uniform(0.06, 0.2)
            shapes.append(_can(f"can{k}{column:+d}", x, y, k * gap + BOARD))
            reaches.append(Grip(position=(x - 0.02, y, k * gap + BOARD + 0.09), approach=(1.0, 0.0, 0.0)))
    return Furniture(shapes=tuple(shapes), reaches=tuple(reaches), place=(0.42, 0.0, 0.0), turn=1.0)


def bookshelf_small(rng: np.random.Generator) -> Furniture:
    """One compartment, wide and low, at the height of the shoulder."""
    one = _shelf(rng, 1, 0.3, 0.9, dividers=False)
    return Furniture(shapes=one.shapes, reaches=one.reaches, place=(0.42, 0.0, rng.uniform(0.15, 0.45)), turn=one.turn)


def bookshelf_tall(rng: np.random.Generator) -> Furniture:
    """Three compartments, wide."""
    return _shelf(rng, 3, 0.32, 0.8, dividers=False)


def bookshelf_thin(rng: np.random.Generator) -> Furniture:
    """Three rows of two narrow compartments."""
    return _shelf(rng, 3, 0.34, 0.7, dividers=True)


def _open_box(
    rng: np.random.Generator, half: float, height: float, front: tuple[tuple[float, float], ...], lid: bool
) -> Furniture:
    """Bottom, three walls, obstacles in front and above; a can on the bottom."""
    walls: list[Any] = [
        ("bottom", "box", (half, half, BOARD), (0.0, 0.0, 0.0)),
        ("left", "box", (half, BOARD, 0.5 * height), (0.0, half, 0.5 * height)),
        ("right", "box", (half, BOARD, 0.5 * height), (0.0, -half, 0.5 * height)),
        ("back", "box", (BOARD, half, 0.5 * height), (half, 0.0, 0.5 * height)),
    ]
    walls += [
        (f"front{k}", "box", (BOARD, half, 0.5 * (high - low)), (-half, 0.0, 0.5 * (low + high)))
        for k, (low, high) in enumerate(front)
    ]
    if lid:
        walls.append(("lid", "box", (half, half, BOARD), (0.06, 0.0, height)))
    x, y = rng.uniform(-0.08, 0.08, size=2)
    walls.append(_can("can", x, y, BOARD))
    from_above = Grip(position=(x, y, 0.18), approach=(0.0, 0.0, -1.0), tilt=0.2)
    from_front = Grip(position=(x - 0.02, y, BOARD + 0.1), approach=(1.0, 0.0, -0.4), tilt=0.3)
    return Furniture(
        shapes=tuple(walls),
        reaches=(from_front,) if lid else (from_above,),
        place=(0.6, 0.0, -0.1) if lid else (0.62, 0.0, 0.05),
        turn=1.2,
        shift=(0.06, 0.06, 0.06),
    )


def box(rng: np.random.Generator) -> Furniture:
    """A box that is open above."""
    return _open_box(rng, 0.28, 0.4, ((0.0, 0.3),), lid=False)


def cage(rng: np.random.Generator) -> Furniture:
    """A closed box with bars in front, between which the arm reaches."""
    return _open_box(rng, 0.33, 0.55, ((0.04, 0.08), (0.42, 0.46)), lid=True)


def _table(rng: np.random.Generator, height: float) -> list[Any]:
    half_x, half_y = 0.3, 0.5
    legs = [
        (f"leg{a:+d}{b:+d}", "box", (BOARD, BOARD, 0.5 * height), (a * 0.27, b * 0.47, 0.5 * height - BOARD))
        for a in (-1, 1)
        for b in (-1, 1)
    ]
    del rng
    return [("top", "box", (half_x, half_y, BOARD), (0.0, 0.0, height)), *legs]


def table_pick(rng: np.random.Generator) -> Furniture:
    """Cans and boxes on a table; the target is reached from above."""
    height = 0.2
    shapes, reaches = _table(rng, height), []
    places = [(x, y) for x in (-0.16, 0.0, 0.16) for y in (-0.3, -0.1, 0.1, 0.3)]
    for k, index in enumerate(rng.choice(len(places), size=7, replace=False)):
        x, y = np.array(places[index]) + rng.uniform(-0.03, 0.03, size=2)
        if k < 4:
            shapes.append(_can(f"can{k}", x, y, height + BOARD))
        else:
            shapes.append((f"box{k}", "box", (0.05, 0.05, 0.12), (x, y, height + BOARD + 0.121)))
        if k < 2:
            reaches.append(Grip(position=(x, y, height + BOARD + 0.13), approach=(0.0, 0.0, -1.0), tilt=0.15))
    return Furniture(
        shapes=tuple(shapes), reaches=tuple(reaches), place=(0.55, 0.0, 0.0), turn=1.0, shift=(0.05, 0.1, 0.1)
    )


def table_under_pick(rng: np.random.Generator) -> Furniture:
    """A can on the floor under a table."""
    height = 0.5
    shapes = _table(rng, height)
    x, y = rng.uniform(-0.15, 0.0), rng.uniform(-0.2, 0.2)
    shapes += [_can("can", x, y, 0.02), ("floor", "box", (0.4, 0.6, BOARD), (0.0, 0.0, 0.0))]
    shapes += [(f"obstacle{k}", "box", (0.04, 0.04, 0.1), (0.1, s * 0.33, 0.121)) for k, s in enumerate((-1, 1))]
    reach = Grip(position=(x - 0.02, y, 0.14), approach=(1.0, 0.0, -0.5), tilt=0.3)
    return Furniture(shapes=tuple(shapes), reaches=(reach,), place=(0.65, 0.0, -0.05), turn=1.0)


KINDS: dict[str, Callable[[np.random.Generator], Furniture]] = {
    "bookshelf_small": bookshelf_small,
    "bookshelf_tall": bookshelf_tall,
    "bookshelf_thin": bookshelf_thin,
    "box": box,
    "cage": cage,
    "table_pick": table_pick,
    "table_under_pick": table_under_pick,
}


# --- problems ---------------------------------------------------------------------------------------------------------


def make(kind: str, count: int, seed: int) -> list[ProblemFile]:
    """Generate problems of one kind; they depend only on the kind and the seed."""
    rng = np.random.default_rng([seed, *kind.encode()])
    found: list[ProblemFile] = []
    while len(found) < count:
        problem = _problem(kind, f"{kind}/{len(found)}", rng)
        if problem is not None and _solvable(problem):
            found.append(problem)
    return found


def _problem(kind: str, name: str, rng: np.random.Generator) -> ProblemFile | None:
    """Generate a problem; None if no target is reachable."""
    furniture = KINDS[kind](rng)
    angle = rng.uniform(-furniture.turn, furniture.turn)
    X_WB, X_BF = np.eye(4), np.eye(4)
    X_WB[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    X_BF[:3, 3] = np.array(furniture.place) + rng.uniform(-1.0, 1.0, size=3) * furniture.shift
    X_WF = X_WB @ X_BF
    obstacles = [_obstacle(X_WF, *shape) for shape in furniture.shapes]
    stand = np.eye(4)
    stand[:3, 3] = -0.05, 0.0, -0.4
    obstacles.append(Obstacle(name="stand", kind="box", size=(0.15, 0.125, 0.4), X_WO=stand))
    empty = np.zeros((0, 7))
    bare = ProblemFile(
        name=name, group=kind, start=np.array(READY), goals=empty, pose=None, obstacles=tuple(obstacles), fingers=0.04
    )
    goal = _reached(bare, X_WF, furniture.reaches, rng)
    start = np.array(READY) if rng.uniform() < 0.5 else _reached(bare, X_WF, furniture.reaches, rng)
    if goal is None or start is None or not _is_free(bare, start) or np.linalg.norm(goal - start) < 0.5:
        return None
    return ProblemFile(
        name=name, group=kind, start=start, goals=goal[None], pose=None, obstacles=bare.obstacles, fingers=0.04
    )


def _obstacle(
    X_WF: Array, name: str, kind: str, size: tuple[float, ...], position: tuple[float, float, float]
) -> Obstacle:
    X_FO = np.eye(4)
    X_FO[:3, 3] = position
    return Obstacle(name=name, kind=kind, size=size, X_WO=X_WF @ X_FO)


def _reached(problem: ProblemFile, X_WF: Array, reaches: tuple[Grip, ...], rng: np.random.Generator) -> Array | None:
    """Find a free configuration that reaches a target, from random seeds."""
    lower, upper = problem.scene.limits.position.T
    for _ in range(4):
        reach = reaches[rng.integers(len(reaches))]
        X_WT = X_WF @ _tool_pose(reach, rng)
        anywhere = rng.uniform(lower, upper)
        found = solve_ik(
            gp.PoseGoal(X_WT),
            problem.scene,
            anywhere,
            free=lambda q: compile_scene(problem.scene).kernels.clearance(q) > _CLEARANCE,
            count=4,
            rounds=1,
            seeds=16,
            seed=int(rng.integers(2**31)),
        ).q
        if len(found):
            return found[rng.integers(len(found))]
    return None


def _tool_pose(reach: Grip, rng: np.random.Generator) -> Array:
    """Draw a tool pose at a target: its z axis near the approach, its closing axis level or turned over."""
    z = np.array(reach.approach) / np.linalg.norm(reach.approach)
    z = z + np.tan(reach.tilt) * rng.uniform(-1.0, 1.0, size=3)
    z /= np.linalg.norm(z)
    level = np.cross([0.0, 0.0, 1.0], z) if abs(z[2]) < 0.9 else _level(rng)
    y = level - (level @ z) * z
    y *= rng.choice([-1.0, 1.0]) / np.linalg.norm(y)
    X = np.eye(4)
    X[:3, 0], X[:3, 1], X[:3, 2] = np.cross(y, z), y, z
    X[:3, 3] = np.array(reach.position) - rng.uniform(0.0, 0.03) * z
    return X


def _level(rng: np.random.Generator) -> Array:
    angle = rng.uniform(-np.pi, np.pi)
    return np.array([np.cos(angle), np.sin(angle), 0.0])


def _is_free(problem: ProblemFile, q: Array) -> bool:
    clear = float(compile_scene(problem.scene).kernels.clearance(q)) > _CLEARANCE
    return clear and not state_contacts(q, problem.scene)


def _solvable(problem: ProblemFile) -> bool:
    kernels = compile_scene(problem.scene).kernels
    asked = SceneProblem(kernels=kernels, start=problem.start, goals=problem.goals, margin=0.002)
    objective = gp.Objective(w=0.0).bind(problem.scene)
    planner = gp.RRTConnect(shortcut=None, range=0.05)
    budget = Budget(SOLVABLE_WITHIN)
    return next(iter(planner.solve(asked, objective, budget, np.random.default_rng(12345))), None) is not None


# --- files ------------------------------------------------------------------------------------------------------------


def write(problems: list[ProblemFile], file: Path) -> None:
    """Write problems in robometrics' YAML."""
    document: dict[str, list[Any]] = {}
    for problem in problems:
        document.setdefault(problem.group, []).append(_document(problem))
    dumper: type = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
    file.write_text(yaml.dump(document, Dumper=dumper, sort_keys=False))


def _document(problem: ProblemFile) -> dict[str, Any]:
    obstacles: dict[str, dict[str, Any]] = {}
    for obstacle in problem.obstacles:
        pose = {"pose": [*obstacle.X_WO[:3, 3].tolist(), *_wxyz(obstacle.X_WO[:3, :3]).tolist()]}
        if obstacle.kind == "box":
            shape: dict[str, Any] = {"dims": [2.0 * half for half in obstacle.size]}
        elif obstacle.kind == "sphere":
            shape = {"radius": obstacle.size[0]}
        else:
            shape = {"radius": obstacle.size[0], "height": 2.0 * obstacle.size[1]}
        kind = "cuboid" if obstacle.kind == "box" else obstacle.kind
        obstacles.setdefault(kind, {})[obstacle.name] = shape | pose
    X_WT = compile_scene(problem.scene).kernels.tool_pose(problem.goals[0])
    X_WT[:3, 3] -= _HAND * X_WT[:3, 2]
    hand = {
        "frame": "panda_hand",
        "position_xyz": X_WT[:3, 3].tolist(),
        "quaternion_wxyz": _wxyz(X_WT[:3, :3]).tolist(),
    }
    return {
        "start": problem.start.tolist(),
        "goal_ik": problem.goals.tolist(),
        "goal_pose": hand,
        "world_frame": "panda_link0",
        "obstacles": obstacles,
    }


def _wxyz(R: Array) -> Array:
    import mujoco

    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(R).ravel())
    return quaternion
