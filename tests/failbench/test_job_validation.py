"""Harm per executed job: parts add up, and the order that the planner prefers does less harm in simulation."""

from __future__ import annotations

import pytest
from order_jobs import job_scene, ordered

import failbench as fb
import graceful_plan as gp
from graceful_plan.exceptions import SettingError
from graceful_plan.job.job_result import JobFailed


@pytest.mark.long
def test_the_careful_job_does_less_harm() -> None:
    ordinary, careful = (fb.validate_job(ordered(w), n=120) for w in (0.0, 3.0))
    assert careful.observed.mean < 0.5 * ordinary.observed.mean
    for one in (ordinary, careful):
        assert one.observed.mean == pytest.approx(sum(part.mean for part in one.by_step))
        assert one.observed.low <= one.observed.mean <= one.observed.high
        assert {motion.label for motion in one.motions} == {"lift", "carry", "lower"}
        assert one.duration > sum(motion.report.duration for motion in one.motions)


def test_unsolved_jobs_are_refused() -> None:
    failed = gp.plan_job(gp.Job(job_scene("order")).place("crate", at=[1.5, 0.0, 0.4]), iterations=2)
    with pytest.raises(JobFailed):
        fb.validate_job(failed)


def test_faults_that_strike_nothing_are_refused() -> None:
    arrived = gp.Job(job_scene("order")).place("crate", at=[0.5, -0.2, 0.4])  # where it is: nothing is carried
    with pytest.raises(SettingError, match="strike"):
        fb.validate_job(gp.plan_job(arrived, 0.0, iterations=2))
