"""Jobs in the scenes of benchmarks/jobs; those in the scene `order` are planned once for all tests of a module."""

from __future__ import annotations

from functools import cache

from places import ROOT

import graceful_plan as gp
from graceful_plan.job.job_planning import JobSession
from graceful_plan.job.job_result import JobResult
from graceful_plan.job.job_state import JobState
from graceful_plan.job.motions import Motions
from graceful_plan.scene.scene import Scene

JOBS = ROOT / "benchmarks" / "jobs"


@cache
def job_scene(name: str) -> Scene:
    return gp.load_scene(JOBS / f"{name}.yaml")


def order_job() -> gp.Job:
    return gp.Job(job_scene("order")).place("dome", at=[0.5, 0.12, 0.4]).place("crate", at=[0.5, 0.48, 0.4])


@cache
def ordered(w: float) -> JobResult:
    return gp.plan_job(order_job(), w, grasps=1, iterations=40)


def action_state(job: gp.Job) -> tuple[JobState, Motions]:
    """Return the state at the start of a job and its motions, to try a single action."""
    search = JobSession(job, gp.Objective(w=0.3), grasps=3).search()
    return search.start, search.motions
