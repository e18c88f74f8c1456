"""Run every native kernel and search loop once on every bundled scene, under the sanitizers."""

from pathlib import Path

import numpy as np

import graceful_plan as gp
from graceful_plan.core import _native
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import Kernels, instruction_sets
from graceful_plan.judge import _pendulum
from graceful_plan.mobile.coast.coast import Coast
from graceful_plan.planners.native import native_space
from graceful_plan.planners.scene_problem import SceneProblem

COUNTS = (1, 7, 65)  # batch sizes: below one SIMD block, a partial block, several blocks
ITERATIONS = 200  # of each plan: two rounds of candidates


def drive(scene: gp.Scene, isa: str) -> None:
    tables = compile_scene(scene)
    kernels = Kernels(tables.robot, tables.world, tables.impact_tables, isa=isa)
    severity = tables.impact_tables.severity
    low, high = scene.limits.position.T
    rng = np.random.default_rng(0)
    for count in COUNTS:
        q0, q1 = rng.uniform(low, high, (2, count, len(low)))
        kernels.tool_pose(q0)
        kernels.free(q0)
        kernels.clearance(q0)
        kernels.clearance_gradient(q0)
        kernels.interaction(q0)
        kernels.impact(q0, severity)
        kernels.edges_free(q0, q1)
        kernels.edge_costs(q0, q1, severity)


def descend(task: gp.Task) -> None:
    """Run descents from a straight line, with few and with many pieces, and the gradients of edges."""
    objective = gp.Objective().bind(task.scene)
    low, high = task.scene.limits.position.T
    path = np.stack([np.asarray(task.start), np.random.default_rng(0).uniform(low, high)])
    assert objective.edge_gradients(path[:1], path[1:]) is not None
    problem = SceneProblem(kernels=objective.kernels, start=path[0], goals=path[1:])
    for pieces in (1, 2, 20):
        run = _native.Descent(native_space(problem, objective), path, pieces, 0.1)
        run.run(20)
        run.harden()
        run.run(5)
        assert np.isfinite(run.path).all() and np.isfinite(run.value)


def roll(task: gp.Task) -> None:
    """Run the impact of a failing base, its derivatives, and a plan."""
    impact = gp.ImpactCost(Coast())
    kernel = gp.Objective(impact=impact).bind(task.scene).kernel
    rng = np.random.default_rng(0)
    for count in COUNTS:
        q = np.tile(np.asarray(task.start), (count, 1)) + rng.normal(size=(count, len(task.scene.joints)))
        qd = rng.normal(size=q.shape)
        gp.interaction_probability(q, task.scene, Coast(), qd)
        if kernel is not None:  # with moving entities, the objective calls the model in Python
            kernel.state_slopes(q, qd)
            kernel.edges(q, q + 0.3 * qd)
    # Only one scene keeps its moving entities: NumPy, which has no sanitizers, takes most of that time.
    scene = task.scene.without_moving() if "truck" in task.scene.moving else task.scene
    gp.plan(task.start, task.goal, scene, iterations=ITERATIONS)


def main() -> None:
    assert "libasan" in Path("/proc/self/maps").read_text(), "the sanitizers are not loaded"
    for module in (_native, _pendulum):
        print(module.__file__)
        assert b"__asan_report" in Path(module.__file__).read_bytes(), "a native module was built without sanitizers"
    for count in COUNTS:
        _pendulum.swung(np.tile([1.0, 0.0, 9.81], (count, 1)), dt=0.003, length=0.02, drag=0.5)
    for name in gp.scenes():
        scene = gp.load_scene(name)
        for task in [*scene.tasks.values()][:1]:
            for isa in instruction_sets():
                drive(task.scene, isa)
            descend(task)
            for planner in ("rrt_connect", "anytime", "auto"):
                result = gp.plan(task.start, task.goal, task.scene, w=1.0, planner=planner, iterations=ITERATIONS)
                print(f"{name} {task.name} {planner}: {result.status.name}", flush=True)
    for name in gp.mobile_scenes():
        for task in [*gp.load_scene(name).tasks.values()][:1]:
            roll(task)
            print(f"{name} {task.name}: rolled", flush=True)


if __name__ == "__main__":
    main()
