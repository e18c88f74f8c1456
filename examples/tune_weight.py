"""The safety weight from what you can afford: the front of motion against impact, and the weight of a point on it."""

import graceful_plan as gp

MAX_DETOUR = 0.1
"""How much longer than the shortest motion the robot may take, as a share."""


def main(iterations: int | None = None) -> tuple[gp.ParetoFront, float | None]:
    """Find the front of a task, choose from it, and return the front and the weight to plan with from now on."""
    task = gp.load_scene("tabletop").tasks["lift_to_goal"]
    front = gp.pareto(task.start, task.goal, task.scene, iterations=iterations, points=8)
    for point in front.points:
        weights = "none leads there" if point.weights is None else "w from {:.3g} to {:.3g}".format(*point.weights)
        print(f"motion {point.motion:.2f} rad, impact {point.impact:.2f}: {weights}")
    choice = front.choose(max_detour=MAX_DETOUR)
    print(f"at most {MAX_DETOUR:.0%} longer: {choice.status.value} w = {choice.w}")
    return front, choice.w


if __name__ == "__main__":
    main()
