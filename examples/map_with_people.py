"""Drive over a floor map past a standing and a walking person, with and without a prediction of the second.

`graceful-plan plan --map` does the same from the shell with a map of ROS's map_server. See `docs/floor-maps.md`.
"""

import sys
from pathlib import Path

import numpy as np

import graceful_plan as gp

START, GOAL = [1.0, 1.0, 0.0], gp.BasePose(1.0, 4.0)


def office() -> gp.OccupancyGrid:
    """Make a floor of 10 x 5 m: two rooms, the passage between them, and a person who stands beside it."""
    occupied = np.zeros((100, 200), dtype=bool)  # [row, column], cells of 5 cm
    occupied[48:52, :120] = occupied[20:30, 60:70] = occupied[70:85, 140:150] = True
    ann = gp.StaticBody(name="ann", kind="cylinder", size=[0.25, 0.85], pose=[6.8, 1.4, 0.85], entity="adult")
    return gp.OccupancyGrid(occupancy=occupied, resolution=0.05, entities=(ann,), name="office")


def ben() -> gp.MovingEntity:
    """Return the prediction of a pedestrian in the passage, at about 0.9 m/s."""
    ends = [[9.3, 3.2, 0.85], [6.8, 2.3, 0.85], [4.0, 1.8, 0.85]]
    return gp.MovingEntity(
        "ben", "adult", size=[0.25, 0.85], t=[0.0, 3.0, 6.0], position=ends, spread=0.05, growth=0.05
    )


def main(picture: Path | None = None, iterations: int | None = None) -> dict[str, gp.PlanResult]:
    """Plan both ways, print the expected harm to each person, and draw the second plan; return the results."""
    budget = {"time_limit": 10.0} if iterations is None else {"iterations": iterations}
    floor = office()
    still = floor.to_scene("jackal")
    scene = still.with_moving(ben())
    results = {
        "as if ben were not there": gp.plan(START, GOAL, still, **budget),
        "with regard for time": gp.plan(START, GOAL, scene, max_wait=3.0, **budget),
    }
    for name, result in results.items():
        trajectory = result.unwrap()
        cost, passing = gp.evaluate(trajectory, scene), gp.verify(trajectory, scene).checks["passing_by"]
        print(
            f"{name:>24}: {trajectory.duration:4.1f} s, harm to ann {cost.impact_by_entity['ann']:5.2f}, "
            f"to ben {cost.impact_by_entity['ben']:5.2f}; {passing.detail}"
        )
    if picture is not None:
        from graceful_plan.mobile.floor_pictures import draw_floor

        draw_floor(scene, results["with regard for time"].trajectory, picture, floor=floor)
    return results


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
