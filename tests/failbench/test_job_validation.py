"""Harm per executed job: parts add up, and the order that the planner prefers does less harm in simulation."""

from __future__ import annotations

import pytest
from order_jobs import job_scene, ordered

import failbench as fb
import graceful_plan as gp
from failbench.basics.statistics import Estimate
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
        assert len(one.steps) == len(one.starts) == len(one.by_step) and list(one.starts) == sorted(one.starts)
        assert one.duration > sum(motion.report.duration for motion in one.motions)


def test_the_timeline_shows_the_share_of_each_step() -> None:
    parts = (Estimate(1.0, 0.5, 2.0, 10), Estimate(3.0, 2.0, 5.0, 10))
    one = fb.JobValidation(
        observed=Estimate(4.0, 3.0, 6.0, 20),
        by_step=parts,
        steps=("pick vase", "place vase"),
        starts=(0.0, 2.5),
        motions=(),
        duration=5.0,
    )
    _, pick, place = str(one).splitlines()
    assert "0.0 s  pick vase" in pick and "2.5 s  place vase" in place
    assert (pick.count("#"), place.count("#")) == (5, 15) and "25 %" in pick and "75 %" in place


def test_unsolved_jobs_are_refused() -> None:
    failed = gp.plan_job(gp.Job(job_scene("order")).place("crate", at=[1.5, 0.0, 0.4]), iterations=2)
    with pytest.raises(JobFailed):
        fb.validate_job(failed)


def test_faults_that_strike_nothing_are_refused() -> None:
    arrived = gp.Job(job_scene("order")).place("crate", at=[0.5, -0.2, 0.4])  # where it is: nothing is carried
    with pytest.raises(SettingError, match="strike"):
        fb.validate_job(gp.plan_job(arrived, 0.0, iterations=2))
