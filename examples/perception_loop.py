"""A perception loop: each cycle updates the poses of measured objects in the scene and plans again."""

import time

import numpy as np

import graceful_plan as gp

LIMIT = 0.4
"""Time limit of each plan [s]."""


def measured(scene: gp.Scene, cycle: int) -> dict[str, np.ndarray]:
    """Simulate a camera: a tin moves 4 cm towards the middle per cycle; return X_WB of the moved body."""
    X_WB = np.eye(4)
    X_WB[:3, 3] = scene.data_at(np.zeros(len(scene.joints))).body("red4").xpos + [0.0, 0.04 * cycle, 0.0]
    return {"red4": X_WB}


def main(cycles: int = 3, limit: float = LIMIT, iterations: int | None = None) -> list[gp.PlanResult]:
    """Plan once per cycle from the current configuration; return all results."""
    task = gp.load_scene("tabletop").tasks["lift_to_goal"]
    scene, q, results = task.scene, np.asarray(task.start), []
    for cycle in range(cycles):
        began = time.perf_counter()
        scene = scene.edit(move=measured(task.scene, cycle))  # only the moved body is compiled again
        seen = time.perf_counter() - began
        result = gp.plan(q, task.goal, scene, w=0.5, time_limit=limit, iterations=iterations, seed=cycle)
        print(f"cycle {cycle}: scene {1e3 * seen:.0f} ms, {result.status.name}, impact {result.cost.impact:.2f}")
        results.append(result)
        if result.trajectory is not None:
            q = result.trajectory.positions(np.array([0.1 * result.trajectory.duration]))[0]  # executed meanwhile
    return results


if __name__ == "__main__":
    main()
