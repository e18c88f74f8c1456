"""Scenes as depth cameras see them: what that costs, and what motions that are planned among points are worth."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import cache

import mujoco
import numpy as np

import graceful_plan as gp
from benchmarks import report, suite
from graceful_plan.core.compile import compile_scene

TITLE = "What sensors see: clouds of bundled and unseen scenes"
SIZE = (180, 186)
"""Rows and columns of an image: three of them have 100,000 pixels."""
VIEWS = ((0.0, 0.0, 1.3), (-0.6, 0.9, 0.7), (-0.6, -0.9, 0.7))
"""Where cameras are, from what they look at [m]."""
OPENING = float(np.deg2rad(70.0))
NOISE = 0.002
"""Of a depth [m], standard deviation."""
RESOLUTION = 0.02
INFLATION = 0.01
EDGES = 4000
REACH = 0.5
"""Length of an edge [rad]."""
ROUNDS = 7
"""Of which the fastest counts."""
WANTED_SECONDS, WANTED_RATE = 0.1, 2e6
MEASURED = f"""\
Three cameras look at each scene, {SIZE[0]} x {SIZE[1]} pixels each, with noise of {NOISE * 1e3:g} mm (standard
deviation) along the ray; the robot stands at the start of a task and hides what is behind it. Points on the robot
and on what it carries are left out; a segmentation without errors gives every thing a cloud of its own, with its
class if it is an entity. Cells of {RESOLUTION * 100:g} cm, inflation {INFLATION * 100:g} cm. Everything but the
robot is taken out of the scene, and the clouds are put in. "Points to boxes" makes the clouds, "edit" and "compile"
make the scene and its tables; medians over tasks. "Free edges": configurations per second along free edges of
{REACH:g} rad, a thread, the best of {ROUNDS} rounds; "modelled" the same in the scene as it is. "Solved": motions
of the default planner, 1 s. "In the modelled scene": of those, the ones that the judge passes there, too: what no
camera saw is not in the clouds. "J": there, over that of a plan in the modelled scene, among motions that both
pass.
"""

Array = np.ndarray


@dataclass(frozen=True, kw_only=True)
class CloudFigures:
    """What came of one task; NaN where there is none."""

    scene: str
    points: int
    boxes: int
    to_boxes: float
    edit: float
    compile: float
    rate: float
    modelled_rate: float
    status: str
    first: float
    passes: bool = False
    ratio: float = float("nan")


def run(options: suite.Options) -> str:
    """Measure every task of the bundled scenes and of `unseen/`."""
    names = [*suite.task_names(options), *suite.unseen_task_names(options)]
    # One process: rates are those of a machine that does nothing else.
    found = list(suite.spread(examine, names[:2] if options.quick else names, 1, "clouds"))
    header = (
        "scene", "tasks", "points", "boxes", "points to boxes [ms]", "edit [ms]", "compile [ms]", "free edges [M/s]",
        "modelled [M/s]", "first motion, w = 0 [ms]", "solved", "in the modelled scene", "J, median",
    )  # fmt: skip
    scenes = list(dict.fromkeys(one.scene for one in found))
    rows = [_row(name, [one for one in found if one.scene == name]) for name in scenes]
    others = [f"{one.scene}: {one.status}" for one in found if one.status != "SOLVED"]
    told = f"Not solved: {'; '.join(others)}.\n" if others else ""
    return f"{MEASURED}\n{report.targets(_targets(found))}\n{report.table(header, [*rows, _row('all', found)])}\n{told}"


def examine(name: str) -> CloudFigures:
    """Look at one task's scene, and plan in what was seen."""
    task = suite.task(name)
    seen = _points(name)
    clouds_of(seen)  # warms up
    started = time.perf_counter()
    clouds = clouds_of(seen)
    boxes = sum(len(cloud.boxes[0]) for cloud in clouds)
    to_boxes = time.perf_counter() - started
    compile_scene(task.scene)
    started = time.perf_counter()
    scene = task.scene.edit(remove=_surroundings(task.scene), add=clouds)
    edited = time.perf_counter()
    kernels = compile_scene(scene).kernels
    compiled = time.perf_counter()
    figures = {
        "scene": name.split("/")[0],
        "points": sum(len(points) for points in seen.values()),
        "boxes": boxes,
        "to_boxes": to_boxes,
        "edit": max(0.0, edited - started - to_boxes),
        "compile": compiled - edited,
        "rate": _rate(kernels),
        "modelled_rate": _rate(compile_scene(task.scene).kernels),
    }
    started = time.process_time()
    gp.plan(task.start, task.goal, scene, w=0.0, callback=lambda _: True)
    first = time.process_time() - started
    result = gp.plan(task.start, task.goal, scene, w=0.3)
    if result.trajectory is None:
        return CloudFigures(**figures, status=f"{result.status.name} ({result.detail})", first=first)
    passes = gp.verify(result.trajectory, task.scene).passed
    modelled = gp.plan(task.start, task.goal, task.scene, w=0.3)
    ratio = np.nan
    if passes and modelled.trajectory is not None:
        both = (gp.evaluate(one, task.scene).total for one in (result.trajectory, modelled.trajectory))
        ratio = float(np.divide(*both))
    return CloudFigures(**figures, status=result.status.name, first=first, passes=passes, ratio=ratio)


def clouds_of(seen: dict[str, Array]) -> list[gp.PointCloud]:
    """Make a cloud of each entity's points, and one of the others'."""
    return [
        gp.PointCloud(
            name=name.split(":")[0],
            points=points,
            resolution=RESOLUTION,
            inflation=INFLATION,
            entity=name.split(":")[1] or None,
        )
        for name, points in seen.items()
    ]


@cache
def _points(name: str) -> dict[str, Array]:
    """Points that the cameras see [m], by "body:class", where bodies that are no entity have no class."""
    task = suite.task(name)
    scene, rng = task.scene, np.random.default_rng(0)
    model, data = scene.model, scene.data_at(task.start)
    mujoco.mj_forward(model, data)
    tools = gp.StateBatch(scene, np.vstack([task.start, task.goal])).tool_poses[:, :3, 3]
    target = tools.mean(axis=0)
    owner = {g: f"{e}:{note.category}" for e, note in _classes(scene).items() for g in scene.entities[e].geoms}
    root = {g: model.body(model.body_rootid[model.geom_bodyid[g]]).name for g in range(model.ngeom)}
    kept = {0, *_kept(scene)}  # what is fixed to the world itself stays as it is
    own = {g for g in range(model.ngeom) if int(model.geom_bodyid[g]) in kept}
    found: dict[str, list[Array]] = {}
    for view in VIEWS:
        eye = target + view
        rays = _rays(eye, target)
        geom, distance = np.full(len(rays), -1, dtype=np.int32), np.zeros(len(rays))
        mujoco.mj_multiRay(model, data, eye, rays.ravel(), None, True, -1, geom, distance, None, len(rays), 10.0)
        distance = distance + NOISE * rng.normal(size=len(rays))
        for g in np.unique(geom[geom >= 0]).tolist():
            if g not in own:
                mine = geom == g
                found.setdefault(owner.get(g, f"{root[g]}:"), []).append(eye + rays[mine] * distance[mine, None])
    return {key: np.concatenate(parts) for key, parts in found.items()}


def _classes(scene: gp.Scene) -> dict[str, gp.EntityAnnotation]:
    return {name: note for name, note in scene.notes.entities.items() if name in scene.entities and note.category}


def _rays(eye: Array, target: Array) -> Array:
    """Unit vectors through the pixels of a camera."""
    ahead = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(ahead, [0.0, 0.0, 1.0] if abs(ahead[2]) < 0.99 else [1.0, 0.0, 0.0])
    right /= np.linalg.norm(right)
    half = np.tan(0.5 * OPENING)
    v, u = np.meshgrid(*(np.linspace(-half, half, n) for n in SIZE), indexing="ij")
    rays = ahead + u.reshape(-1, 1) * right + v.reshape(-1, 1) * np.cross(right, ahead)
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def _kept(scene: gp.Scene) -> set[int]:
    """Bodies of the robot and of what it carries."""
    model, kept = scene.model, set(scene.robot_bodies)
    if scene.carried is not None:
        kept.add(int(model.body(scene.carried.body).id))
    for body in range(1, model.nbody):
        if int(model.body_parentid[body]) in kept:
            kept.add(body)
    return kept


def _surroundings(scene: gp.Scene) -> list[str]:
    model, kept = scene.model, _kept(scene)
    return [model.body(b).name for b in range(1, model.nbody) if model.body_parentid[b] == 0 and b not in kept]


def _rate(kernels: object) -> float:
    """Configurations a second along free edges."""
    lower, upper = kernels.robot.lower, kernels.robot.upper
    rng = np.random.default_rng(0)
    q0 = rng.uniform(lower, upper, (EDGES, len(lower)))
    step = rng.normal(size=q0.shape)
    q1 = np.clip(q0 + REACH * step / np.linalg.norm(step, axis=1, keepdims=True), lower, upper)
    free = kernels.edges_free(q0, q1)
    q0, q1 = q0[free], q1[free]
    seconds = np.inf
    for _ in range(ROUNDS):
        started = time.perf_counter()
        kernels.edges_free(q0, q1)
        seconds = min(seconds, time.perf_counter() - started)
    configurations = np.ceil(np.linalg.norm(q1 - q0, axis=1) * 32.0) + 1.0
    return float(configurations.sum() / seconds)


def _row(name: str, found: list[CloudFigures]) -> list[object]:
    solved = [one for one in found if one.status == "SOLVED"]
    passed = [one for one in solved if one.passes]

    def median(field: str, scale: float = 1.0) -> str:
        return report.quantity(scale * float(np.median([getattr(one, field) for one in found])))

    ratio = np.array([one.ratio for one in passed if np.isfinite(one.ratio)])
    return [
        name, len(found), median("points", 1.0), median("boxes"), median("to_boxes", 1e3), median("edit", 1e3),
        median("compile", 1e3), median("rate", 1e-6), median("modelled_rate", 1e-6), median("first", 1e3),
        f"{len(solved)} of {len(found)}", f"{len(passed)} of {len(solved)}",
        report.quantity(float(np.median(ratio)) if len(ratio) else np.nan),
    ]  # fmt: skip


def _targets(found: list[CloudFigures]) -> list[report.Target]:
    taken = np.array([1e5 / one.points * (one.to_boxes + one.edit + one.compile) for one in found])
    rate = np.array([one.rate for one in found])
    return [
        report.Target(
            what="100,000 points taken in, compiled, median (slowest) task",
            wanted="<= 100 ms",
            measured=f"{1e3 * np.median(taken):.0f} ms ({1e3 * taken.max():.0f})",
            met=bool(np.median(taken) <= WANTED_SECONDS),
        ),
        report.Target(
            what="edges checked against them, median (slowest) task",
            wanted=">= 2 M configurations/s",
            measured=f"{1e-6 * np.median(rate):.1f} M ({1e-6 * rate.min():.1f})",
            met=bool(np.median(rate) >= WANTED_RATE),
        ),
    ]
