"""Motions along which robots fail, and the jobs for them."""

from __future__ import annotations

import numpy as np
import pytest

import graceful_plan as gp
from failbench.calibrations import failure_jobs
from failbench.calibrations.failure_jobs import MotionKind
from failbench.calibrations.failures import Failures

SCENE, TASK = "tabletop_l1", "green_to_blue"


@pytest.fixture(scope="module")
def task() -> gp.Task:
    return gp.load_scene(SCENE).tasks[TASK]


@pytest.mark.parametrize("seed", [0, 1])
def test_via_points_make_free_motions_that_repeat(task: gp.Task, seed: int) -> None:
    kind = MotionKind(way="via", speed=0.8)
    made, again = (failure_jobs.make_motion(task, kind, seed) for _ in range(2))
    assert made is not None and again is not None
    assert np.array_equal(made.q, again.q)
    assert gp.verify(made, task.scene).passed
    assert np.array_equal(made.q[0], task.start)
    straight = np.linalg.norm(task.goal[0] - task.start)
    assert made.path.length > 1.01 * straight


def test_a_job_for_every_kind_of_motion_and_every_task_with_an_object() -> None:
    jobs = failure_jobs.failure_jobs(gp.load_scene, [SCENE], n=2, seed=5, kinds=failure_jobs.KINDS[:2])
    assert len(jobs) == 2 * len(gp.load_scene(SCENE).tasks)
    assert len({job.seed for job in jobs}) == len(jobs)
    made = failure_jobs.run_job(jobs[0])
    assert isinstance(made, Failures)
    assert (made.scene, made.task, made.motion, len(made)) == (SCENE, jobs[0].task, str(jobs[0].kind), 2)


def test_failed_jobs_give_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    (job, *_) = failure_jobs.failure_jobs(gp.load_scene, [SCENE], n=2, kinds=[MotionKind(way="via", iterations=1)])
    monkeypatch.setattr(failure_jobs, "make_motion", lambda *_: None)
    assert failure_jobs.run_job(job) == f"{SCENE}/{job.task}, via, w 0, speed 0.5: no motion"
