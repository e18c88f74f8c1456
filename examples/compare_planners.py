"""Compare planners on a list of problems: total costs, and the gap of each to the best."""

import sys

import graceful_plan as gp

PROBLEMS = {"tabletop": "lift_to_goal", "tabletop_l1": "far_to_near"}
PLANNERS = ("auto", "rrt_connect", "prm_star", "stomp")


def main(planners: tuple[str, ...] = PLANNERS, iterations: int | None = None) -> dict[str, dict[str, float]]:
    """Plan each problem with each planner and the same budget; return total costs by problem and planner.

    `graceful-plan bench` does the same with several seeds, statistics and a report.
    """
    found: dict[str, dict[str, float]] = {}
    for scene, name in PROBLEMS.items():
        task = gp.load_scene(scene).tasks[name]
        totals = {}
        for planner in planners:
            result = gp.plan(task.start, task.goal, task.scene, w=1.0, planner=planner, iterations=iterations)
            totals[planner] = result.cost.total  # infinite if not solved
        best = min(totals.values())
        for planner, total in totals.items():
            print(f"{scene}/{name} {planner:12s} {total:6.2f}  +{100.0 * (total / best - 1.0):.0f} %")
        found[f"{scene}/{name}"] = totals
    return found


if __name__ == "__main__":
    main(tuple(sys.argv[1:]) or PLANNERS)
