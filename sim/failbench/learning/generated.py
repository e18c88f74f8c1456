"""Random scenes for learning: boards at various heights, many kinds of things on them, odd carried objects.

They share only the robot with the bundled scenes, so that all bundled scenes remain for tests.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import mujoco
import numpy as np

import graceful_plan as gp
from failbench.learning.things import MassPart, Taken, extent, free_spot, thing, with_asymmetry
from graceful_plan.exceptions import SceneError, UnknownNameError
from graceful_plan.scene.elements import EntityAnnotation, Notes, ObjectNote, TaskNote

PREFIX = "generated_"
"""Prefix of the scenes' names; the seed follows."""
CARRIED = 2
"""Carried objects per scene, one task each."""
_BASE = "desk"
"""Bundled scene from which the robot is taken."""
_CATEGORIES = ("laptop", "phone", "glass", "robust", "paper", "textile", "mains", "adult", "pet", "heirloom")
_STAND = 0.74
"""Height of the robot's base [m]."""
_BOARD = 0.012
"""Half thickness of a board [m]."""
_GRIP = 0.07
"""Greatest object width between the fingers [m]."""
_BELOW = 0.015
"""Distance of wider objects below the tool point [m]."""
_TRIES = 60


class Board(NamedTuple):
    """A table or shelf, seen from above."""

    x: float
    y: float
    a: float
    b: float
    top: float


@lru_cache(maxsize=4)
def generated_scene(name: str) -> gp.Scene:
    """Generate the scene of a name such as "generated_17", reproducibly.

    Raises:
        UnknownNameError: If the name has another form.
    """
    number = name.removeprefix(PREFIX)
    if number == name or not number.isdecimal() or len(number) > 9:
        raise UnknownNameError("generated scene", name, (f"{PREFIX}0", f"{PREFIX}1", ".."))
    for attempt in range(_TRIES):
        rng = np.random.default_rng((int(number), attempt))
        made = _scene(name, rng)
        if made is not None:
            return made
    raise SceneError(f"{name}: no collision-free start and goal found")


def scene_names(count: int, first: int = 0) -> list[str]:
    """Return the names of `count` generated scenes."""
    return [f"{PREFIX}{number}" for number in range(first, first + count)]


def _scene(name: str, rng: np.random.Generator) -> gp.Scene | None:
    base = gp.load_scene(_BASE)
    spec = base.spec.copy()
    for body in list(spec.worldbody.bodies):
        if not body.name.startswith(base.notes.robot):
            spec.delete(body)
    boards = _boards(rng)
    entities = _furnish(spec, boards, rng)
    objects = {f"load{i}": _carried(spec, f"load{i}", i, rng) for i in range(CARRIED)}
    notes = Notes(
        name=name,
        robot=base.notes.robot,
        tool=base.notes.tool,
        severity=base.notes.severity,
        entities=entities,
        objects=objects,
        velocity=base.notes.velocity,
        acceleration=base.notes.acceleration,
        fingers=base.notes.fingers,
    )
    scene = gp.Scene.build(spec, notes)
    tasks: dict[str, TaskNote] = {}
    for key in objects:
        ends = _ends(scene.attach(key), boards[0], rng)
        if ends is None:
            return None
        tasks[f"carry_{key}"] = TaskNote(start=tuple(ends[0]), goal=(tuple(ends[1]),), object_name=key)
    return gp.Scene.build(spec, replace(notes, tasks=tasks))


# --- surroundings -----------------------------------------------------------------------------------------------------


def _boards(rng: np.random.Generator) -> list[Board]:
    """Return a table in front of the robot, and with probability 0.6 a lower or higher board at its side."""
    main = Board(rng.uniform(0.45, 0.65), rng.uniform(-0.1, 0.1), rng.uniform(0.2, 0.4), rng.uniform(0.3, 0.7), 0.0)
    main = main._replace(top=_STAND + rng.uniform(-0.2, 0.1))
    if rng.random() < 0.4:
        return [main]
    side = rng.choice([-1.0, 1.0])
    b = rng.uniform(0.12, 0.3)
    y = main.y + side * (main.b + b + rng.uniform(0.0, 0.15))
    return [main, Board(rng.uniform(0.35, 0.6), y, rng.uniform(0.15, 0.35), b, main.top + rng.uniform(-0.35, 0.15))]


def _furnish(spec: mujoco.MjSpec, boards: list[Board], rng: np.random.Generator) -> dict[str, EntityAnnotation]:
    """Add boards, floor and things; return the classes of the entities."""
    _add(
        spec,
        "pedestal",
        [MassPart("box", (0.12, 0.12, 0.5 * _STAND), z=0.5 * _STAND)],
        (0.0, 0.0, 0.0),
        0.0,
        free=False,
    )
    _add(spec, "floor", [MassPart("box", (2.0, 2.0, 0.05), z=-0.05)], (0.5, 0.0, 0.0), 0.0, free=False)
    entities = {"floor": EntityAnnotation(category="floor")}
    for i, board in enumerate(boards):
        at = (board.x, board.y, board.top)
        _add(spec, f"board{i}", [MassPart("box", (board.a, board.b, _BOARD), z=-_BOARD)], at, 0.0, free=False)
        entities[f"board{i}"] = EntityAnnotation(category="table")
        taken: list[Taken] = []
        for j in range(int(rng.integers(5, 13) if i == 0 else rng.integers(1, 5))):
            parts = thing(rng)
            spot = free_spot(parts, board.a, board.b, taken, rng)
            if spot is None:
                continue
            x, y, yaw = spot
            key = f"thing{i}_{j}"
            _add(spec, key, parts, (board.x + x, board.y + y, board.top), yaw, free=rng.random() < 0.75, rng=rng)
            if rng.random() < 0.9:  # the others are only obstacles
                entities[key] = EntityAnnotation(category=str(rng.choice(_CATEGORIES)))
    return entities


def _add(
    spec: mujoco.MjSpec,
    name: str,
    parts: list[MassPart],
    at: tuple[float, float, float],
    yaw: float,
    *,
    free: bool,
    rng: np.random.Generator | None = None,
) -> None:
    body = spec.worldbody.add_body(name=name, pos=list(at), quat=[math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)])
    if free:
        body.add_freejoint(name=name)
    density = 500.0 if rng is None else rng.uniform(200.0, 1200.0)
    damping = 0.55 if rng is None else float(rng.choice([0.4, 0.43, 0.55, 1.5]))
    kinds = {
        "box": mujoco.mjtGeom.mjGEOM_BOX,
        "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
        "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
        "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    }
    for part in parts:
        body.add_geom(
            type=kinds[part.kind],
            size=[*part.size, 0.0, 0.0][:3],
            pos=[part.x, part.y, part.z],
            density=density,
            condim=6,
            friction=[1.0, 0.005, 0.0004],
            solref=[0.02, damping],
        )


# --- carried objects, starts and goals --------------------------------------------------------------------------------


def _carried(spec: mujoco.MjSpec, name: str, number: int, rng: np.random.Generator) -> ObjectNote:
    """Add a carried object, placed behind the robot, and return its grasp."""
    parts = with_asymmetry(thing(rng, carried=True), rng)
    _add(spec, name, parts, (-0.8, 0.4 * number, 0.0), 0.0, free=True, rng=rng)
    turn = np.diag([1.0, -1.0, -1.0])  # the tool points down and the object stands,
    if rng.random() < 0.35:  # or the object is held by another side
        angle = 0.5 * math.pi * rng.choice([1.0, -1.0, 2.0, 0.5])
        c, s = math.cos(angle), math.sin(angle)
        turn = turn @ [[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]]
    low, high = extent(parts, turn)
    width, depth = high[1] - low[1], high[2] - low[2]
    # Between the fingers, or just below them and welded if the fingers do not open wide enough.
    above = rng.uniform(0.2, 0.5) * min(depth, 0.08) if width < _GRIP else -_BELOW
    X_TO = np.eye(4)
    X_TO[:3, :3] = turn
    X_TO[:3, 3] = [-0.5 * (low[0] + high[0]), -0.5 * (low[1] + high[1]), -low[2] - above]
    return ObjectNote(body=name, X_TO=X_TO, fingers=float(np.clip(0.5 * width + 0.002, 0.002, 0.04)))


def _ends(scene: gp.Scene, board: Board, rng: np.random.Generator) -> tuple[list[float], list[float]] | None:
    """Return two free configurations over a board, apart from each other, with the tool pointing roughly down."""
    low, high = scene.limits.position.T
    middle = np.array([0.0, 0.1, 0.0, -1.9, 0.0, 2.0, 0.785])
    spread = np.array([0.7, 0.5, 0.25, 0.6, 0.25, 0.5, 0.6])
    q = np.clip(middle + spread * rng.normal(size=(4096, len(low))), low + 0.03, high - 0.03)
    tool = gp.StateBatch(scene, q).tool_poses
    place = tool[:, :3, 3] - [board.x, board.y, board.top]
    fits = (tool[:, 2, 2] < -0.8) & (np.abs(place[:, 0]) < board.a + 0.1) & (np.abs(place[:, 1]) < board.b + 0.1)
    q = q[fits & (place[:, 2] > 0.05) & (place[:, 2] < 0.5)]
    q = q[gp.clearance(q, scene) > 0.02] if len(q) else q
    for goal in q[1:]:
        if np.linalg.norm(goal - q[0]) > 0.9:
            return q[0].tolist(), goal.tolist()
    return None
