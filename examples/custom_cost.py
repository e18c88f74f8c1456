"""A custom cost in ten lines of NumPy: keep the carried object away from a point.

Pass the object; there is no registration. Every planner accepts it.
"""

from dataclasses import dataclass

import numpy as np

import graceful_plan as gp


@dataclass(frozen=True)
class Nearness(gp.Cost):
    """Closeness of the carried object to a point: 1 at the point, decaying over `radius` [m]."""

    point: tuple[float, float, float]
    radius: float = 0.25

    def state(self, batch: gp.StateBatch) -> np.ndarray:
        """Return the closeness at each state."""
        offset = batch.object_poses[:, :3, 3] - self.point
        return np.exp(-np.sum(offset**2, axis=1) / (2.0 * self.radius**2))


def main(planner: str = "auto", iterations: int | None = None) -> dict[str, gp.PlanResult]:
    """Plan with and without the cost, within the default time limit or `iterations`; return both results."""
    task = gp.load_scene("desk").tasks["bring_coffee"]
    laptop = task.scene.data_at(task.start).geom_xpos[task.scene.entities["laptop"].geoms[0]]
    away = gp.Objective(impact=Nearness(tuple(laptop)), exposure="length")  # independent of the speed
    results, how = {}, {"planner": planner, "iterations": iterations}
    for name, w in {"shortest": 0.0, "away": 5.0}.items():
        found = gp.plan(task.start, task.goal, task.scene, objective=away.with_weight(w), **how)
        print(f"{name}: {found.status.name}, motion {found.cost.motion:.2f}, nearness {found.cost.impact:.2f}")
        results[name] = found
    return results


if __name__ == "__main__":
    main()
