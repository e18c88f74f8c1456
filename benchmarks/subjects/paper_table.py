"""The paper's experiment; `python benchmarks/paper_table.py` runs it with its own options."""

from __future__ import annotations

from benchmarks import suite

TITLE = "The paper's four trajectories: predicted and observed impact"
QUESTION = "Are the costs and impacts that the paper reports for its four trajectories reproduced?"
HEADLINE = "motion cost"
DEPENDS_ON = (
    *suite.SIMULATION,
    "src/graceful_plan/costs",
    "src/graceful_plan/scene",
    "src/graceful_plan/timing",
    "benchmarks/paper_table.py",
    "benchmarks/paper_cost.py",
)
MEASURED = """\
Scene `tabletop`. The object is carried by friction along straight pieces in joint space, with a stop at the via point,
at half of the joint limits. "Motion": length of the arm's path [rad]. "Safety as coded": the paper's cost, as its code
computes it. "Algorithm 1": the paper's algorithm on the carried object, mean over time. "Paper's protocol": 60 runs,
each with a failure with probability 25 % at a uniform time; mean over all runs of the severity of the first hit. All
other columns are severity per gripper failure; 30 % of the failures are before the via point, 70 % after it. "At stops"
is explained below the table. Intervals are 95 %.
"""


def run(options: suite.Options) -> str:
    """Compute the costs of the trajectories and simulate failures along them."""
    from benchmarks import paper_table

    drops = 30 if options.quick else paper_table.DROPS
    rows = paper_table.measure(drops, threads=options.processes)
    return f"{MEASURED}\n{drops} failures of each trajectory.\n\n{paper_table.markdown(rows)}"
