"""Does planning with the impact prevent damage? What failures do along motions planned with it and without."""

from __future__ import annotations

from collections.abc import Iterable

from benchmarks import suite
from benchmarks.prevention.runs import ALL_FAULTS, SECONDS, SEED, HeadlineJob, do_headline
from benchmarks.prevention.tables import DROPS, MIXED, headline_sections
from benchmarks.prevention.work import fill, found, headline_jobs, kept, task_names
from failbench.report import FAILURES_PER_HOUR

TITLE = "Damage prevented: failures along motions planned with and without regard for them"
MEASURED = f"""\
Every task of every bundled scene and of those in `benchmarks/unseen/`, on which no constant was fitted (the constants
were fitted on rollouts in the bundled scenes, along other motions). All are planned at half of the velocity limits, in
{SECONDS:g} s. Then the robot fails: "drops", the gripper lets go; "mixed", each of the 19 faults, severe, equally
often. All motions of a task have the same faults at the same fractions of their time, with the same random numbers;
fingers hold the object where they can along all of them, otherwise a weld. Impact: sum of the severities of what is
touched within 1 s.
**Per failure**: its mean. **Per task**: failures come per hour, so harm per executed task is failure rate x duration x
mean impact of a failure; absolute figures are for one failure in {1.0 / FAILURES_PER_HOUR:g} h and a million tasks,
ratios do not depend on the rate. "x less": harm at w = 0 over that of the planner. Where n failures hit nothing, one of
them counts as a hit of the least severity of the scene: there is no ratio to nothing. Medians and geometric means are
over tasks, the latter with the 95 % interval between percentiles of resampled tasks. "Worse": tasks with more harm per
task than at w = 0 beyond the 95 % interval of the paired difference; "better" likewise. "{ALL_FAULTS}": the default
model with that prior of faults. Harm counts what the fall does to the carried object itself; "others only" leaves that
out, for motions that were planned with it.

What a healthy robot does harm to on its way, such as by spilling, is in harm per task with probability 1, whatever the
rate. It is no failure's harm, and what has left before a failure cannot be spilt by it. Tasks of which a motion at
w = 0 or of the default loses more than 1 % are left out of the groups "nothing spilt on the way", which are not shown
where they are all tasks.

Targets are for {DROPS:,} drops and {MIXED} mixed failures a motion on all tasks; what holds with fewer is "not
measured".
"""


def run(options: suite.Options) -> str:
    """Do what is left to do, and report on all that is done."""
    job = asked_job(options)
    names = task_names(options)
    with kept(options) as folder:
        heads = folder / f"headline.{SEED}.{job.drops}.{job.mixed}.jsonl"
        fill(heads, headline_jobs(names, heads, job), do_headline, options, "prevention")
        done = found(names, heads)
    asked: Iterable[str] = (name for all_of in names.values() for name in all_of)
    return "\n".join([MEASURED, *headline_sections(done, list(asked), job)])


def asked_job(options: suite.Options) -> HeadlineJob:
    """Return what is done for each task."""
    drops, mixed = options.pick((DROPS, MIXED), quick=(16, 19))
    return HeadlineJob(drops=options.drops or drops, mixed=options.mixed or mixed)
