"""Drive every native kernel and search loop on every bundled scene once; the sanitizers watch."""

from pathlib import Path

import numpy as np

import graceful_plan as gp
from graceful_plan import _native
from graceful_plan.compile import compile_scene
from graceful_plan.kernels import Kernels, instruction_sets

COUNTS = (1, 7, 65)  # less than a block of lanes, a ragged block, several


def drive(scene: gp.Scene, isa: str) -> None:
    tables = compile_scene(scene)
    kernels = Kernels(tables.robot, tables.world, tables.hazards, isa=isa)
    severity = tables.hazards.severity
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


def main() -> None:
    print(_native.__file__)
    assert "libasan" in Path("/proc/self/maps").read_text(), "the sanitizers are not there to watch"
    assert b"__asan_report" in Path(_native.__file__).read_bytes(), "the native core was built without sanitizers"
    for name in gp.scenes():
        scene = gp.load_scene(name)
        for task in [*scene.tasks.values()][:1]:
            for isa in instruction_sets():
                drive(task.scene, isa)
            for planner in ("rrt_connect", "anytime"):
                result = gp.plan(task.start, task.goal, task.scene, w=1.0, planner=planner, iterations=300)
                print(f"{name} {task.name} {planner}: {result.status.name}", flush=True)


if __name__ == "__main__":
    main()
