"""Speed of the kernels on one thread, for every instruction set, compared with MuJoCo on the same configurations."""

from __future__ import annotations

import time
from collections.abc import Callable

import mujoco
import numpy as np

from benchmarks import impact_rates, report, suite
from graceful_plan.core.compile import CompiledScene, compile_scene
from graceful_plan.core.kernels import CHECK_STEP, COST_STEP, Kernels, instruction_sets
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.models.drop.constants import DropSettings
from graceful_plan.costs.models.drop.kernel import ROWS, DropKernel
from graceful_plan.costs.models.drop.tables import drop_tables
from graceful_plan.scene.loading.robot_models import robot_file
from graceful_plan.scene.roles import FROM_ABOVE
from graceful_plan.scene.scene import Scene

Array = np.ndarray

TITLE = "Kernels: configurations per second on one thread"
QUESTION = "How many configurations per second do the kernels and impact models evaluate on one thread?"
HEADLINE = "free edges"
DEPENDS_ON = (
    "src/graceful_plan/core",
    "src/graceful_plan/costs",
    "src/graceful_plan/scene",
    "benchmarks/impact_rates.py",
)
N_BOXES = 20
CARGO = 0.03
"""Half side of the carried box [m]."""
EDGE_LENGTH = 1.03
"""Length of the edges [rad], not a multiple of any block, so that rounding does not change the number of checks."""
MEASURED = f"""\
A Panda that carries a 6 cm box among {N_BOXES} random oriented boxes. "Free edges": free straight edges of
{EDGE_LENGTH:g} rad, checked every {CHECK_STEP:g} rad; all configurations that the kernel checks are counted. "Uniform":
configurations drawn uniformly within the joint limits. Clearance is signed and is that of the covering spheres.
Algorithm 1 runs on `tabletop` with the green cube in the gripper: "impact" is the sum of P S of the carried object and
its contents, "interaction" all P including those of the links. "Edge costs" counts the samples of `edge_costs`, one
every {COST_STEP:g} rad. The drop model runs on the same scene, at random joint velocities up to the limits and along
edges; its pairs are those of a configuration and an entity. MuJoCo is `mj_kinematics` and `mj_collision`, called from
Python, with the box fixed to the hand. Best of several repetitions, in millions of configurations per second.
"""


Work = dict[str, tuple[int, Callable[[], object]]]
"""By name: the number of configurations, and the function to time."""
WANTED = {
    "free edges": 6.0,
    "uniform": 3.0,
    "clearance": 1.0,
    "clearance and gradient": 0.5,
    "impact": 3.0,
    "drop model, pairs": 20.0,
}
"""Targets with AVX-512, in millions of configurations or pairs per second."""


def run(options: suite.Options) -> str:
    """Measure every kernel with every instruction set, MuJoCo, and the impact models in every scene."""
    uniform, count, repetitions = options.pick((200_000, 10_000, 7), quick=(20_000, 1000, 2))
    # Slower kernels and MuJoCo run on fewer configurations.
    heavy, few = options.pick((50_000, 20_000), quick=(5000, 1000))
    rng = np.random.default_rng(0)
    boxes = compile_scene(boxes_scene(np.random.default_rng(0)))
    tabletop = _carrying(suite.scene("tabletop"))
    lower, upper = boxes.robot.lower, boxes.robot.upper
    q = rng.uniform(lower, upper, (uniform, len(lower)))
    edges = free_edges(boxes.kernels, q, count, rng)
    rates = {
        isa: _measured(
            _work(Kernels(boxes.robot, boxes.world, boxes.impact_tables, isa=isa), q, q[:heavy], edges)
            | _impact_work(tabletop, isa, q[:heavy], edges)
            | _drop_work(tabletop, isa, q[:heavy], edges),
            repetitions,
        )
        for isa in instruction_sets()
    }
    rates["MuJoCo"] = _mujoco_rates(q[:few], edges, repetitions)
    impact = impact_rates.measure(options)
    targets = report.targets([*_targets(rates), *impact_rates.targets(impact)])
    kernels, models = _table(rates), impact_rates.table(impact)
    return "\n".join([MEASURED, _facts(boxes, q), "", targets, kernels, impact_rates.MEASURED, models])


def boxes_scene(rng: np.random.Generator, *, fixed_cargo: bool = False) -> Scene:
    """Return the arm among boxes; with `fixed_cargo` the carried box is part of the hand, as MuJoCo needs it."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.attach(mujoco.MjSpec.from_file(str(robot_file("panda"))), prefix="panda/", frame=spec.worldbody.add_frame())
    names = [f"box{i}" for i in range(N_BOXES)]
    for name in names:
        body = spec.worldbody.add_body(name=name, pos=_position(rng), quat=_rotation(rng))
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=rng.uniform(0.02, 0.1, 3))
    if fixed_cargo:
        hand, tool = spec.body("panda/hand"), spec.site("panda/tool")
        hand.add_geom(name="cargo", type=mujoco.mjtGeom.mjGEOM_BOX, size=[CARGO] * 3, pos=tool.pos, quat=tool.quat)
        return Scene.from_mjcf(spec, robot="panda/", tool="panda/tool", entities=dict.fromkeys(names, "glass"))
    cargo = spec.worldbody.add_body(name="cargo", pos=[2.0, 2.0, 2.0])
    cargo.add_freejoint()
    cargo.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[CARGO] * 3)
    entities = dict.fromkeys(names, "glass")
    return Scene.from_mjcf(spec, robot="panda/", tool="panda/tool", carried="cargo", X_TO=FROM_ABOVE, entities=entities)


def free_edges(kernels: Kernels, q: Array, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return random free edges of one length that begin at free configurations."""
    first = q[kernels.free(q)]
    direction = rng.normal(size=first.shape)
    second = first + EDGE_LENGTH * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    inside = np.all((second >= kernels.robot.lower) & (second <= kernels.robot.upper), axis=1)
    first, second = first[inside], second[inside]
    free = kernels.edges_free(first, second)
    return first[free][:count], second[free][:count]


def configurations_checked(length: Array, lanes: int) -> int:
    """Return the number of configurations that the kernel checks on free edges, in whole blocks of lanes."""
    return int((((length / CHECK_STEP + 1.0) / lanes).astype(int) + 1).sum()) * lanes


def _position(rng: np.random.Generator) -> Array:
    """Return a random position of a box within reach of the arm and outside its base."""
    while True:
        p = rng.uniform([-0.8, -0.8, 0.0], [0.8, 0.8, 1.1])
        if np.hypot(p[0], p[1]) > 0.25:
            return p


def _rotation(rng: np.random.Generator) -> Array:
    quat = rng.normal(size=4)
    return quat / np.linalg.norm(quat)


def _carrying(scene: Scene) -> Scene:
    return next(task.scene for task in scene.tasks.values() if task.object_name is not None)


def _best_seconds(work: Callable[[], object], repetitions: int) -> float:
    best = np.inf
    for _ in range(repetitions):
        started = time.perf_counter()
        work()
        best = min(best, time.perf_counter() - started)
    return best


def _measured(work: Work, repetitions: int) -> dict[str, float]:
    """Return millions of configurations per second."""
    return {name: n / _best_seconds(task, repetitions) / 1e6 for name, (n, task) in work.items()}


def _work(kernels: Kernels, q: Array, heavy: Array, edges: tuple[Array, Array]) -> Work:
    length = np.linalg.norm(edges[1] - edges[0], axis=1)
    return {
        "free edges": (configurations_checked(length, kernels.core.lanes), lambda: kernels.edges_free(*edges)),
        "uniform": (len(q), lambda: kernels.free(q)),
        "clearance": (len(heavy), lambda: kernels.clearance(heavy)),
        "clearance and gradient": (len(heavy), lambda: kernels.clearance_gradient(heavy)),
        "forward kinematics": (len(heavy), lambda: kernels.link_poses(heavy)),
    }


def _kernels(scene: Scene, isa: str) -> Kernels:
    compiled = compile_scene(scene)
    return Kernels(compiled.robot, compiled.world, compiled.impact_tables, isa=isa)


def _impact_work(scene: Scene, isa: str, heavy: Array, edges: tuple[Array, Array]) -> Work:
    kernels, severity = _kernels(scene, isa), ImpactCost().severity(scene)
    length = np.linalg.norm(edges[1] - edges[0], axis=1)
    samples = int(np.ceil(length / COST_STEP).sum()) + len(length)
    return {
        "impact": (len(heavy), lambda: kernels.impact(heavy, severity)),
        "interaction": (len(heavy), lambda: kernels.interaction(heavy)),
        "edge costs": (samples, lambda: kernels.edge_costs(*edges, severity)),
    }


def _drop_work(scene: Scene, isa: str, heavy: Array, edges: tuple[Array, Array]) -> Work:
    tables, limit = drop_tables(scene), scene.limits.velocity
    constants = DropSettings.shipped().of(tables.shape_class)
    drop = DropKernel(tables, constants, _kernels(scene, isa), limit, len(scene.entities))
    length = np.linalg.norm(edges[1] - edges[0], axis=1)
    rates = limit * np.random.default_rng(2).uniform(-1.0, 1.0, heavy.shape)
    weighed = drop.with_severity(np.ones((len(ROWS), len(scene.entities))))
    samples = int(np.ceil(length / COST_STEP).sum()) + len(length)
    return {
        "drop model": (len(heavy), lambda: drop.probability(heavy, rates)),
        "drop model, pairs": (len(heavy) * len(scene.entities), lambda: drop.probability(heavy, rates)),
        "drop model, edge costs": (samples, lambda: weighed.edges(*edges)),
    }


def _mujoco_rates(q: Array, edges: tuple[Array, Array], repetitions: int) -> dict[str, float]:
    scene = boxes_scene(np.random.default_rng(0), fixed_cargo=True)
    model, data, adr = scene.model, scene.data_at(q[0]), scene.qpos_adr
    share = np.random.default_rng(1).uniform(size=(len(edges[0]), 1))
    along = (1.0 - share) * edges[0] + share * edges[1]

    def check(configurations: Array) -> None:
        for configuration in configurations:
            data.qpos[adr] = configuration
            mujoco.mj_kinematics(model, data)
            mujoco.mj_collision(model, data)

    rates = {}
    for name, configurations in (("free edges", along[: len(q)]), ("uniform", q)):
        seconds = _best_seconds(lambda c=configurations: check(c), max(2, repetitions // 2))
        rates[name] = len(configurations) / seconds / 1e6
    return rates


def _facts(boxes: CompiledScene, q: Array) -> str:
    robot = boxes.robot
    free = report.percent(float(boxes.kernels.free(q).mean()))
    return (
        f"{len(robot.sphere)} spheres on {len(np.unique(robot.sphere_link))} links, {len(robot.self_pair)} pairs of "
        f"links, {len(boxes.world.kind)} obstacles; {free} of the uniform configurations are free."
    )


def _targets(rates: dict[str, dict[str, float]]) -> list[report.Target]:
    best = instruction_sets()[0]
    # The targets are for AVX-512; other processors are not judged.
    judged = "v4" in best
    return [
        report.Target(
            what=f"{name}, {best}",
            wanted=f">= {wanted:g} M/s",
            measured=f"{rates[best][name]:.2f} M/s",
            met=rates[best][name] >= wanted if judged else None,
        )
        for name, wanted in WANTED.items()
    ]


def _table(rates: dict[str, dict[str, float]]) -> str:
    best = instruction_sets()[0]
    columns = [*rates, "best / MuJoCo"]
    rows = []
    for name in rates[best]:
        row = [f"{rates[column][name]:.3g}" if name in rates[column] else "" for column in rates]
        ratio = f"{rates[best][name] / rates['MuJoCo'][name]:.0f} x" if name in rates["MuJoCo"] else ""
        rows.append([name, *row, ratio])
    return report.table(["M configurations/s", *columns], rows)
