"""Somebody walks past the end of the table to which the robot carries a block: go now, or wait a moment?

A prediction is where somebody will be when, and how uncertain that is. It is a hazard, not an obstacle: see
`docs/moving.md`.
"""

import graceful_plan as gp

OBJECTIVE = gp.Objective(impact=gp.ImpactCost(model="footprint"))


def walking_person() -> gp.MovingEntity:
    """Predict a person who walks past at 1.4 m/s, give or take 3 cm, and 10 cm more every second."""
    return gp.MovingEntity(
        "person",
        "adult",
        size=[0.2, 0.85],  # an upright cylinder: radius and half height
        t=[0.0, 3.0],
        position=[[-0.5, -2.0, 0.85], [-0.5, 2.2, 0.85]],
        spread=0.03,
        growth=0.1,
    )


def main(iterations: int | None = None) -> dict[str, gp.PlanResult]:
    """Plan as if nobody were there, past the person at once, and with up to 3 s of patience; return the results.

    Within 2 s each, or so many iterations.
    """
    budget = {"time_limit": 2.0} if iterations is None else {"iterations": iterations}
    task = gp.load_scene("tabletop").tasks["right_to_left"]
    scene = task.scene.with_moving(walking_person())
    results = {}
    for name, where, max_wait in (("alone", task.scene, 0.0), ("at once", scene, 0.0), ("patient", scene, 3.0)):
        result = gp.plan(task.start, task.goal, where, objective=OBJECTIVE, max_wait=max_wait, **budget)
        trajectory = result.unwrap()
        cost = gp.evaluate(trajectory, scene, OBJECTIVE)
        rest = trajectory.t[1] if not trajectory.qd[1].any() else 0.0
        print(
            f"{name:>8}: waits {rest:.2f} s, arrives after {trajectory.duration:.2f} s, J {cost.total:.1f}, "
            f"of which the person {OBJECTIVE.w * cost.impact_by_entity['person']:.2f}"
        )
        results[name] = result
    return results


if __name__ == "__main__":
    main()
