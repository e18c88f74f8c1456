"""The paper's experiment as a section of the results; on its own it is `python benchmarks/paper_table.py`."""

from __future__ import annotations

from benchmarks import suite

TITLE = "The paper's four trajectories: predicted and observed impact"
MEASURED = """\
Scene `tabletop`, the object carried by friction, straight pieces in joint space with a stop at the via point, half of
the joints' limits. "Motion": length of the arm's path [rad]. "Safety as coded": the paper's, as its code computes it.
"Algorithm 1": that of the paper on the carried object, mean over time. "Paper's protocol": 60 runs, a failure in each
with a probability of 25 % at a uniform time; mean over all runs of what the object touches first. The rest is severity
per failure of the gripper, which happens before the via point in 30 % and after it in 70 %; "at stops" is explained
below. Intervals are 95 %.
"""


def run(options: suite.Options) -> str:
    """Cost and break the trajectories."""
    from benchmarks import paper_table

    drops = 30 if options.quick else paper_table.DROPS
    rows = paper_table.measure(drops, threads=options.processes)
    return f"{MEASURED}\n{drops} failures of each trajectory.\n\n{paper_table.markdown(rows)}"
