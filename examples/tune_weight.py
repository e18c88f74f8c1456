"""Choose the safety weight by the longest acceptable detour, from the Pareto front of motion against impact."""

import graceful_plan as gp

MAX_DETOUR = 0.1
"""Accepted increase of the motion cost over the shortest motion, as a fraction."""


def main(iterations: int | None = None) -> tuple[gp.ParetoFront, float | None]:
    """Compute the front of a task and choose a point; return the front and the weight of that point."""
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
