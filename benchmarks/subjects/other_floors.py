"""What `harmless` of coast.yaml rests on: harm of FailBench's faults on floors that serve for nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import failbench as fb
import graceful_plan as gp
from benchmarks import report, suite
from benchmarks.subjects.mobile_prevention import FAILURES, HORIZON, SECONDS, asked, examine
from graceful_plan.mobile.coast.coast import Coast
from graceful_plan.mobile.coast.constants import CoastSettings

Array = np.ndarray

TITLE = "Robots that drive: floors that were not looked at"
FLOORS = range(100, 112)
"""Seeds of `floor_plan`, beside those of `mobile_prevention`."""
ERRING = 64
"""Failures of an encoder along each motion."""
RARE = 0.05
"""Share of failures that lead astray when the model is asked for that alone: its P are rates, and end at 1."""
MEASURED = f"""\
The floors, motions, faults and figures of `mobile_prevention`, on {len(FLOORS)} other floors. One constant was
fitted on these, `harmless` of `coast.yaml`, by predicted over observed along all motions; and nothing else was tried on
them, while those of `mobile_prevention` were looked at when the model was made.

Apart, {ERRING} failures of an encoder that reads too much (`scale_error`, severe) along each motion, planned anew: what
the model says of bases that go astray, and what they hit; the correlation is over motions.
"""


def run(options: suite.Options) -> str:
    """Measure harm that is predicted and observed along motions of w = 0 and of the default."""
    floors, each = (FLOORS[:2], 1) if options.quick else (FLOORS, FAILURES)
    jobs = [(f"floor {k}", options.seconds or SECONDS, each) for k in floors]
    found = [one for one in suite.spread(examine, jobs, options.processes, "floors") if not one.note]
    predicted, observed = (np.array([getattr(one, name) for one in found]) for name in ("predicted", "harm"))
    rows = [
        [name, f"{p.mean():.3f}", f"{o.mean():.3f}", f"{p.sum() / o.sum():.2f}"]
        for name, p, o in (
            ("w = 0", predicted[:, 0], observed[:, 0]),
            ("default", predicted[:, 1], observed[:, 1]),
            ("both", predicted, observed),
        )
    ]
    erring = [(name, seconds, ERRING if each > 1 else 4) for name, seconds, _ in jobs]
    p, o = np.concatenate(list(suite.spread(astray, erring, options.processes, "floors"))).T
    level = f"{p.sum() / o.sum():.2f}, correlation {np.corrcoef(p, o)[0, 1]:.2f}"
    rows.append(["astray alone, both", f"{p.mean():.3f}", f"{o.mean():.3f}", level])
    less, longer = np.median([[one.times_less, one.longer] for one in found], axis=0)
    plain, ours = np.mean([np.multiply(one.harm, one.duration) for one in found], axis=0)
    target = report.Target(
        what="harm per executed task at the default w against w = 0, median",
        wanted="5 x less, <= 15 % longer",
        measured=f"{less:.2f} x less, {100 * (longer - 1):+.1f} % (by the means {plain / ours:.2f})",
        met=bool(less >= 5.0 and longer <= 1.15),
    )
    header = (f"harmless {CoastSettings.shipped().harmless:g}", "predicted", "observed", "predicted / observed")
    return f"{MEASURED}\n{report.targets([target])}\n{report.table(header, rows)}"


def astray(job: tuple[str, float, int]) -> Array:
    """Return the harm of a base that goes astray, predicted and observed, along motions of w = 0 and the default."""
    name, seconds, failures = job
    scene, start, goal, faults = asked(name)
    erring = [fault for fault in faults if fault.NAME == "scale_error"]
    rarely = replace(CoastSettings.shipped(), ways={}, harmless=1.0 - RARE)
    model = gp.ImpactCost(model=Coast(rarely))
    gp.plan(start, goal, scene, iterations=1)  # compiles
    found = []
    for w in (0.0, None):
        result = gp.plan(start, goal, scene, w=w, time_limit=seconds)
        if result.trajectory is not None:
            seen = fb.validate(result, scene, erring, n=failures, horizon=HORIZON, threads=1, prediction=model)
            found.append((seen.predicted / RARE, seen.observed.mean))
    return np.array(found).reshape(-1, 2)
