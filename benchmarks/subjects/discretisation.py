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
from graceful_plan.costs.objective import trajectory_batch

TITLE = "Discretisation: halving the sub-steps of J"
CHANGE_BELOW = 0.005
FINEST = COST_STEP / 64.0
SPARSE = 5
"""Samples of a motion to an edge of the polyline: edges are then about as long as those of paths in search."""
MEASURED = f"""\
Motions that `plan(w=1)` returns. The impact over their time is a trapezoid sum over the samples of the motion, with
sub-steps of at most {COST_STEP:g} rad between them. "Halved" is the change of J when these steps are halved; "error" is
the difference to steps of {FINEST:.2g} rad. "As a path": the change of J of the polyline through every fifth sample,
charged as searches charge edges, when the sub-steps of its edges are halved; "both codes" is the difference between the
kernel and `gp.evaluate`, which integrates in NumPy, on that polyline.
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
    path: float = np.inf


def run(options: suite.Options) -> str:
    """Plan every task and integrate its cost again and again."""
    names = suite.task_names(options)
    jobs = [planning.job(name, seconds=0.3 if options.quick else 1.0) for name in names]
    order = {name: i for i, name in enumerate(names)}
    findings = list(suite.spread(examine, jobs, options.processes, "discretisation"))
    findings.sort(key=lambda finding: order[finding.task])
    rows = [_row(finding) for finding in findings]
    header = ("task", "status", "J", "halved", "error", "as a path", "both codes")
    return f"{MEASURED}\n{report.targets(_targets(findings))}\n{report.table(header, rows)}"


def examine(job: PlannerJob) -> StepChanges:
    """Plan one task and compare the sums."""
    found = run_planner(job)
    if not found.solved:
        return StepChanges(task=found.problem, status=found.status)
    scene = suite.task(found.problem).scene
    trajectory = found.trajectory(scene.joints)
    assert trajectory is not None
    total = _total(scene, trajectory, COST_STEP)
    q = np.concatenate([trajectory.q[:-1:SPARSE], trajectory.q[-1:]])
    polyline = _path_total(scene, q, COST_STEP)
    return StepChanges(
        task=found.problem,
        status=found.status,
        total=total,
        halved=_change(_total(scene, trajectory, COST_STEP / 2.0), total),
        error=_change(_total(scene, trajectory, FINEST), total),
        path=_change(_path_total(scene, q, COST_STEP / 2.0), polyline),
        codes=_change(gp.evaluate(gp.Path(q), scene, gp.Objective(w=planning.W)).total, polyline),
    )


def _total(scene: gp.Scene, trajectory: gp.Trajectory, step: float) -> float:
    """J of a motion, its impact integrated at a step [rad]."""
    pieces = np.maximum(1, np.ceil(trajectory.path.segment_lengths / step)).astype(int)
    place = np.append(np.concatenate([k + np.arange(n) / n for k, n in enumerate(pieces)]), len(pieces))
    t = np.interp(place, np.arange(len(trajectory)), trajectory.t)
    density = gp.Objective().impact.state(trajectory_batch(scene, trajectory, t))
    return trajectory.path.length + planning.W * float(np.trapezoid(density, t))


def _path_total(scene: gp.Scene, q: np.ndarray, step: float) -> float:
    """J of a path by the kernel, integrated at a step [rad]."""
    kernel = gp.Objective(w=planning.W).bind(scene).kernel
    assert kernel is not None  # the default model has one
    motion, impact = kernel.edges(q[:-1], q[1:], step).sum(axis=0)
    return float(motion + planning.W * impact)


def _change(value: float, reference: float) -> float:
    return abs(value - reference) / reference if reference else abs(value)


def _row(finding: StepChanges) -> list[str]:
    changes = (finding.halved, finding.error, finding.path, finding.codes)
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
