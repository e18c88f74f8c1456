"""What `harmless` of coast.yaml rests on: harm of FailBench's faults on floors that serve for nothing else."""

from __future__ import annotations

import numpy as np

from benchmarks import report, suite
from benchmarks.subjects.mobile_prevention import FAILURES, SECONDS, examine
from graceful_plan.costs.models.coast.constants import CoastSettings

Array = np.ndarray

TITLE = "Robots that drive: floors that were not looked at"
FLOORS = range(100, 112)
"""Seeds of `floor_plan`, beside those of `mobile_prevention`."""
MEASURED = f"""\
The floors, motions, faults and figures of `mobile_prevention`, on {len(FLOORS)} other floors. One constant was
fitted on these, `harmless` of `coast.yaml`, by predicted over observed along all motions; and nothing else was tried on
them, while those of `mobile_prevention` were looked at when the model was made.
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
