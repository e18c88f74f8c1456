"""Plan a whole task: bottle and teapot go to the other side of a table, in the order that does the least harm."""

import sys

import graceful_plan as gp
from graceful_plan.job.job_result import JobResult

LEFT = [[0.3, 0.2, 0.7], [0.7, 0.5, 0.8]]
"""Lower and upper corner in W of where they shall stand [m]."""


def main(iterations: int | None = None) -> JobResult:
    """Plan the job, print its steps, and compare with the opposite order."""
    scene = gp.load_scene("dining_table")
    job = gp.Job(scene).place("bottle", in_region=LEFT, n=2).place("teapot", in_region=LEFT, n=2)
    result = gp.plan_job(job, w=0.3, grasps=2, iterations=iterations)
    print(result)
    if result.steps:
        print(result.why(order=result.order[::-1], iterations=iterations))
    return result


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))
