"""Transports in exported scenes of LIBERO and robosuite: classes by name, a grasp, and the place to put the object.

Scenes are unchanged except that the floor becomes a body, so that it can be an entity, and that geoms that do not
collide are left out.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

import graceful_plan as gp
from benchmarks.libero.grasps import boxes, extent, geoms_of, grasps, moved, pose_of, turned
from graceful_plan.query.endpoints.ik import solve_ik
from graceful_plan.scene.model_parts import subtree

Array = np.ndarray

CLASSES = (
    (r"plate|bowl|ramekin|mug|porcelain|wine_bottle", "glass"),
    (r"book", "paper"),
    (r"table|cabinet|shelf|rack|caddy|tray|basket|bin|Door", "table"),
    (r"floor", "floor"),
    (r".*", "robust"),
)
"""Class of an entity by its name, the first pattern that is found: ceramics and glass; books; furniture and containers;
the floor; groceries in cans and boxes, pans, pots, stove and microwave."""
KINDS = (
    (r"floor", "floor"),
    (r"rack|shelf|caddy|tray|basket|bin", "racks and containers"),
    (r"table|cabinet|stove|microwave", "furniture"),
    (r"plate|bowl|ramekin|mug|porcelain", "bowls, plates, mugs"),
    (r".*", "groceries, books, pans"),
)
"""Kind of an entity in the tables of the predictions."""
_TOOL, _ROBOT = "gripper0_grip_site", "robot0_"
_VELOCITY = (2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61)
_ACCELERATION = (15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0)
"""Limits of the Panda, from its data sheet [rad/s and rad/s2]."""
ABOVE = 0.02
"""Height above its support at which the object is taken over and put down [m]."""
_GOAL_YAWS = 8
_TRIED = 36
"""Greatest number of grasps for which configurations are sought."""
_BESIDE = 0.06
"""Width beside the object's outline that the hand needs [m]: it stays above a basket."""
_FREE = 0.003
"""Least clearance at both ends [m]."""
_CENTRED = 0.03
"""Horizontal distance within which an object counts as on another one, as in LIBERO [m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Transport:
    """A transport: scene with the object in the gripper, configurations, and the entity it is put on.

    `place` is the site or body that the task names, and `inside` whether the object belongs into it instead of onto it.
    `region` has the lower and upper corner of a box in W for the object's origin, in tasks that have one.
    """

    name: str
    scene: gp.Scene
    start: Array
    goal: Array
    target: str
    place: str
    inside: bool
    region: Array | None = None


class NoTransport(Exception):
    """Raised if a task has no grasp or no reachable place."""


def class_of(name: str) -> str:
    """Return the class of an entity."""
    return _found(CLASSES, name)


def kind_of(name: str) -> str:
    """Return the kind of an entity."""
    return _found(KINDS, name)


def transport(folder: Path) -> Transport:
    """Build the transport of an exported task.

    Raises:
        NoTransport: If no grasp or no place was found.
    """
    state = json.loads((folder / "state.json").read_text(encoding="utf-8"))
    relation, carried, place = next(g for g in state["goal"] if len(g) == 3 and g[1] in state["objects"])
    body = state["objects"][carried]
    empty = load(folder, state)
    things = {**state["objects"], **state["fixtures"]}
    target = max((name for name in things if place.startswith(name)), key=len, default="")
    reference = next(iter(empty.keyframes.values()))
    region = state.get("regions", {}).get(place)
    if region is not None:
        region = np.array([region["low"], region["high"]])
        places = _inside(region)
    else:
        places = [np.array(state["sites"][place][:2]) if place in state["sites"] else _middle(empty, things[place])]
    for X_WT, fingers in islice(grasps(empty, body), _TRIED):
        X_TO = np.linalg.inv(X_WT) @ pose_of(empty, body)
        scene = empty.attach(
            body,
            X_TO=X_TO,
            fingers={"gripper0_finger_joint1": fingers, "gripper0_finger_joint2": -fingers},
            object_class="glass" if class_of(carried) == "glass" else None,
        )
        lifted = moved(X_WT, [0.0, 0.0, ABOVE])
        starts = _reached(scene, lifted, reference)
        if not len(starts):
            continue
        by_origin = region is not None
        found = (_goals(empty, scene, body, X_TO, at, starts[0], by_origin=by_origin) for at in places)
        goals = next((goals for goals in found if len(goals)), np.zeros((0, 7)))
        if len(goals):
            return Transport(
                name=folder.name,
                scene=scene,
                start=starts[0],
                goal=goals,
                target=things.get(target, _table(empty)),
                place=things.get(place, place),
                inside=relation == "in",
                region=region,
            )
    raise NoTransport(f"{folder.name}: no grasp of {carried} from which {place} is reached")


def arrived(carry: Transport, model: mujoco.MjModel, data: mujoco.MjData) -> bool:
    """Whether the object lies where the task wants it: in or on a box of the scene, or in the middle of a body."""
    assert carry.scene.carried is not None
    p_WO = data.body(carry.scene.carried.body).xpos
    if carry.region is not None:
        return bool((carry.region[0] < p_WO).all() and (p_WO < carry.region[1]).all())
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, carry.place)
    if site < 0:
        offset = p_WO - data.body(carry.place).xpos
        return bool(np.linalg.norm(offset[:2]) < _CENTRED and offset[2] > 0.0)
    offset, half = data.site_xmat[site].reshape(3, 3).T @ (p_WO - data.site_xpos[site]), model.site_size[site]
    lowest, highest = (-half[2] - 0.01, half[2]) if carry.inside else (half[2] - 0.005, half[2] + 0.1)
    return bool((np.abs(offset[:2]) < half[:2]).all() and lowest < offset[2] < highest)


def load(folder: Path, state: Mapping[str, Any]) -> gp.Scene:
    """Load a scene with its settled state and an empty gripper."""
    spec = mujoco.MjSpec.from_file(str(folder / "model.xml"))
    for geom in [geom for geom in spec.worldbody.geoms if geom.name == "floor"]:
        body = spec.worldbody.add_body(name="floor")
        body.add_geom(name="floor_top", type=geom.type, size=geom.size, pos=geom.pos, quat=geom.quat)
        spec.delete(geom)
    return as_it_comes(spec, spec.compile(), state, folder.name)


def as_it_comes(source: mujoco.MjSpec | Path, model: mujoco.MjModel, state: Mapping[str, Any], name: str) -> gp.Scene:
    """Load a scene from a file or specification, whose model tells the bodies."""
    arm = [f"{_ROBOT}joint{k}" for k in range(1, 8)]
    others = {joint: x if len(x) > 1 else x[0] for joint, x in state["joints"].items() if joint not in arm}
    return gp.Scene.from_mjcf(
        source,
        robot=_ROBOT,
        tool=_TOOL,
        entities={name: class_of(name) for name in _bodies(model)},
        state=others,
        velocity=_VELOCITY,
        acceleration=_ACCELERATION,
        keyframes={"exported": np.concatenate([state["joints"][joint] for joint in arm])},
        self_collision="links",
        convex="hull",
        visuals=False,
        folder="/",
        name=name,
    )


def _bodies(model: mujoco.MjModel) -> Iterator[str]:
    """Yield the bodies of the world that collide, or below which something does; without the robot."""
    collides = model.geom_contype != 0
    for b in range(1, model.nbody):
        name = model.body(b).name
        if int(model.body_parentid[b]) == 0 and not name.startswith(_ROBOT):
            if collides[np.isin(model.geom_bodyid, list(subtree(model, b)))].any():
                yield name


def _found(table: Sequence[tuple[str, str]], name: str) -> str:
    return next(value for pattern, value in table if re.search(pattern, name))


# --- places -----------------------------------------------------------------------------------------------------------


def _middle(scene: gp.Scene, body: str) -> Array:
    low, high = extent(scene, geoms_of(scene, body), scene.data_at(scene.keyframes["exported"]))
    return 0.5 * (low + high)[:2]


def _inside(region: Array) -> list[Array]:
    """Return points inside of a box, seen from above: its middle, and points halfway to its corners."""
    middle, half = region.mean(axis=0)[:2], 0.5 * (region[1] - region[0])[:2]
    return [middle, *(middle + 0.5 * half * [x, y] for x in (-1.0, 1.0) for y in (-1.0, 1.0))]


def _table(scene: gp.Scene) -> str:
    """Return the table that everything stands on, or the floor."""
    return next((name for name in scene.entities if "table" in name), "floor")


def _reached(scene: gp.Scene, X_WT: Array, reference: Array, count: int = 2) -> Array:
    """Return free configurations with the tool at a pose."""
    found = solve_ik(gp.PoseGoal(X_WT), scene, reference, count=4)
    free = [q for q in found.q if gp.clearance(q, scene) >= _FREE]
    return np.array(free[:count]).reshape(-1, len(reference))


def _goals(
    empty: gp.Scene, scene: gp.Scene, body: str, X_TO: Array, at: Array, start: Array, *, by_origin: bool
) -> Array:
    """Return configurations that hold the object straight above a place, turned about the vertical.

    The middle of the object is above the place, or its origin.
    """
    X_WO, data = pose_of(empty, body), empty.data_at(empty.keyframes["exported"])
    geoms = geoms_of(empty, body)
    low, high = extent(empty, geoms, data)
    top = _highest(empty, geoms, data, at, 0.5 * float(np.max((high - low)[:2])) + _BESIDE)
    found = []
    for k in range(_GOAL_YAWS):
        X_WG = turned(X_WO, 2.0 * np.pi * k / _GOAL_YAWS)
        centre = X_WG[:3, :3] @ X_WO[:3, :3].T @ (0.5 * (low + high) - X_WO[:3, 3])
        if by_origin:
            centre = np.zeros(3)
        X_WG[:3, 3] = [*(at - centre[:2]), top + ABOVE + X_WO[2, 3] - low[2]]
        found += list(_reached(scene, X_WG @ np.linalg.inv(X_TO), start, count=1))
        if len(found) >= 4:
            break
    return np.array(found).reshape(-1, len(start))


def _highest(scene: gp.Scene, own: Sequence[int], data: mujoco.MjData, at: Array, half: float) -> float:
    """Return the greatest height of boxes around geoms over a square, of everything but robot and object [m]."""
    model = scene.model
    ignored = {int(model.geom_bodyid[g]) for g in own} | set(scene.robot_bodies)
    geoms = [
        g for g in range(model.ngeom)
        if int(model.geom_bodyid[g]) not in ignored and int(model.geom_type[g]) != int(mujoco.mjtGeom.mjGEOM_PLANE)
    ]  # fmt: skip
    low, high = boxes(scene, geoms, data)
    over = ((low[:, :2] <= at + half) & (high[:, :2] >= at - half)).all(axis=1)
    return float(high[over, 2].max(initial=0.0))
