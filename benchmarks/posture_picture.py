"""The picture of docs/mobile.md: a bottle carried through the hallway, with the arm fixed and with the arm moving.

python -m benchmarks.posture_picture
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

import graceful_plan as gp
from graceful_plan.scene.scene import Scene
from graceful_plan.viz.outlines import draw_entities

Array = np.ndarray

PICTURE = Path(__file__).parents[1] / "docs" / "images" / "posture.png"
TASK, W, SECONDS = "carry_left", 1.0, 4.0
STYLES = {False: ("arm fixed", "#b0413e"), True: ("arm moves on the way", "#2f6690")}
_MOMENTS = 300
"""At which the bottle is drawn."""


def draw(results: dict[bool, gp.PlanResult], scene: Scene, file: Path) -> None:
    """Draw base and bottle from above, and how high the bottle is over time."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (above, height) = plt.subplots(2, 1, figsize=(9.0, 5.2), height_ratios=(3, 2), layout="constrained")
    draw_entities(above, scene)
    for moves_arm, result in results.items():
        _draw(result, scene, STYLES[moves_arm], (above, height))
    for wall in (-1.2, 1.2):
        above.axhline(wall, color="#888888", linewidth=2.0)
    above.set(xlim=(-1.0, 11.0), ylim=(-1.3, 1.3), aspect="equal", xlabel="x [m]", ylabel="y [m]")
    above.set_title("base (thin) and bottle (thick) from above; numbers: severity of what falls on whom", fontsize=9)
    height.set(xlabel="time [s]", ylabel="bottle over the floor [m]", ylim=(0.0, None))
    height.legend(fontsize=8, frameon=False)
    figure.savefig(file, dpi=110)
    plt.close(figure)


def _draw(result: gp.PlanResult, scene: Scene, style: tuple[str, str], axes: tuple[Any, Any]) -> None:
    trajectory, (name, colour) = result.unwrap(), style
    t = np.linspace(0.0, trajectory.duration, _MOMENTS)
    q = trajectory.at(t).q
    assert scene.carried is not None
    bottle = np.array([scene.data_at(one).body(scene.carried.body).xpos for one in q])
    axes[0].plot(q[:, 0], q[:, 1], color=colour, linewidth=0.8)
    axes[0].plot(bottle[:, 0], bottle[:, 1], color=colour, linewidth=2.2)
    impact = result.cost.impact if result.cost is not None else np.nan
    axes[1].plot(t, bottle[:, 2], color=colour, label=f"{name}: impact {impact:.1f}, {trajectory.duration:.1f} s")


def main() -> None:
    """Plan both and draw them."""
    task = gp.load_scene("hallway").tasks[TASK]
    results = {
        moves_arm: gp.plan(
            task.start,
            task.goal,
            task.scene,
            w=W,
            time_limit=SECONDS,
            planner=gp.DriveLattice(moves_arm=moves_arm),
        )
        for moves_arm in STYLES
    }
    draw(results, task.scene, PICTURE)


if __name__ == "__main__":
    main()
