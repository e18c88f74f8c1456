"""A pedestrian walks past the end of the table to which the robot carries a block: go now, or wait?

A prediction gives the position of the pedestrian over time and its uncertainty. It contributes to the impact and is not
an obstacle: see `docs/moving.md`.
"""

import graceful_plan as gp

OBJECTIVE = gp.Objective(impact=gp.ImpactCost(model="mixture"))


def walking_person() -> gp.MovingEntity:
    """Return the prediction of a pedestrian at 1.4 m/s, with a spread of 3 cm that grows by 10 cm per second."""
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
    """Plan without the person, with the person and no waiting, and with up to 3 s of waiting; return the results.

    Each plan has a time limit of 2 s, or the given number of iterations.
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
