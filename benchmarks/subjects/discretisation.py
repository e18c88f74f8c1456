"""Does J depend on how finely the impact is integrated?"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

import graceful_plan as gp
from benchmarks import planning, report, suite
from graceful_plan.compare.runs.runner import PlannerJob
from graceful_plan.compare.runs.runner import run as run_planner
from graceful_plan.core.kernels import COST_STEP

TITLE = "Discretisation: halving the sub-steps of J"
CHANGE_BELOW = 0.005
FINEST = COST_STEP / 64.0
MEASURED = f"""\
Paths that `plan(w=1)` returns, exposure "length". Edge costs are trapezoid sums with sub-steps of at most
{COST_STEP:g} rad (evenly over an edge, whole blocks of lanes in the kernel). "Halved" is the change of J when these
steps are halved; "error" is the difference to steps of {FINEST:.2g} rad; "both codes" is the difference between the
kernel and `gp.evaluate`, which integrates in NumPy. "Resampled": the change of J when vertices are put in so that no
segment is longer than 0.01 rad, which changes nothing about the geometry.
"""


@dataclass(frozen=True, kw_only=True)
class StepChanges:
    """What came of one task; changes are relative to J, infinite if there was no path."""

    task: str
    status: str
    total: float = np.inf
    halved: float = np.inf
    error: float = np.inf
    codes: float = np.inf
    resampled: float = np.inf


def run(options: suite.Options) -> str:
    """Plan every task and integrate its cost again and again."""
    names = suite.task_names(options)
    jobs = [planning.job(name, seconds=0.3 if options.quick else 1.0) for name in names]
    order = {name: i for i, name in enumerate(names)}
    findings = list(suite.spread(examine, jobs, options.processes, "discretisation"))
    findings.sort(key=lambda finding: order[finding.task])
    rows = [_row(finding) for finding in findings]
    header = ("task", "status", "J", "halved", "error", "both codes", "resampled")
    return f"{MEASURED}\n{report.targets(_targets(findings))}\n{report.table(header, rows)}"


def examine(job: PlannerJob) -> StepChanges:
    """Plan one task and compare the sums."""
    found = run_planner(job)
    if not found.solved:
        return StepChanges(task=found.problem, status=found.status)
    scene = suite.task(found.problem).scene
    q = np.array(found.path)
    total = _total(scene, q, COST_STEP)
    return StepChanges(
        task=found.problem,
        status=found.status,
        total=total,
        halved=_change(_total(scene, q, COST_STEP / 2.0), total),
        error=_change(_total(scene, q, FINEST), total),
        codes=_change(gp.evaluate(gp.Path(q), scene, gp.Objective(w=planning.W)).total, total),
        resampled=_change(_total(scene, gp.Path(q).resampled(0.01).q, COST_STEP), total),
    )


def _total(scene: gp.Scene, q: np.ndarray, step: float) -> float:
    """J of a path by the kernel, integrated at a step [rad]."""
    kernel = gp.Objective(w=planning.W).bind(scene).kernel
    assert kernel is not None  # the default model has one
    motion, impact = kernel.edges(q[:-1], q[1:], step).sum(axis=0)
    return float(motion + planning.W * impact)


def _change(value: float, reference: float) -> float:
    return abs(value - reference) / reference if reference else abs(value)


def _row(finding: StepChanges) -> list[str]:
    changes = (finding.halved, finding.error, finding.codes, finding.resampled)
    return [
        finding.task,
        finding.status,
        report.quantity(finding.total, digits=5),
        *(report.percent(change, 3) for change in changes),
    ]


def _targets(findings: list[StepChanges]) -> Iterator[report.Target]:
    worst = max(findings, key=lambda f: f.halved)
    missing = sum(not np.isfinite(f.halved) for f in findings)
    judged = [f for f in findings if np.isfinite(f.halved)]
    worst = max(judged, key=lambda f: f.halved, default=worst)
    yield report.Target(
        what="change of J when sub-steps are halved, worst task",
        wanted=f"< {report.percent(CHANGE_BELOW)}",
        measured=f"{report.percent(worst.halved, 3)} ({worst.task}); {missing} of {len(findings)} tasks without a path",
        met=worst.halved < CHANGE_BELOW if judged else None,
    )
