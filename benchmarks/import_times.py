"""Time before the first plan of a new process: imports, the command line, and the first plan; and memory growth."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks import report, suite

MEASURED = """\
**New processes.** Medians; the interpreter's own start is not counted, the system's file cache is warm. "Import":
`import graceful_plan`, whose names are imported on first use; "everything for planning" adds `plan` and `load_scene`,
and includes numpy and MuJoCo, which have a row of their own. "graceful-plan": whole processes. "First plan": after the
imports, `load_scene` and `plan(w=0)` until SOLVED, the first in the process. "Memory": growth of the process over plans
of 300 iterations on the tasks of `tabletop`, after 100 plans.
"""
IMPORT_WITHIN, SAID_WITHIN, FIRST_PLAN_WITHIN = 0.3, 0.3, 0.2  # [s]
GROWTH_BELOW = 5.0  # [MB]
FIRST_PLANS = (("tabletop/lift_to_goal", "rrt_connect"), ("tabletop/lift_to_goal", "anytime"))
ROOT = Path(__file__).parents[1]
_IMPORT = "import time; t = time.perf_counter(); {}; print(time.perf_counter() - t)"
_IMPORTS = {
    "import": ("import graceful_plan", IMPORT_WITHIN),
    "import, everything for planning": ("import graceful_plan as gp; gp.plan; gp.load_scene", IMPORT_WITHIN),
    "import of FailBench": ("import failbench", IMPORT_WITHIN),
    "import of numpy and MuJoCo": ("import numpy, mujoco", None),
}
_COMMAND = """
import subprocess, sys, time
t = time.perf_counter()
subprocess.run([sys.executable, "-m", "graceful_plan.tools.cli", *sys.argv[1:]], check=True, stdout=subprocess.DEVNULL)
print(time.perf_counter() - t)
"""
_FIRST_PLAN = """
import sys, time
import graceful_plan as gp
gp.plan, gp.load_scene
stop = (lambda point: True) if sys.argv[2] == "anytime" else None
started = time.perf_counter()
scene_name, task_name = sys.argv[1].split("/")
task = gp.load_scene(scene_name).tasks[task_name]
result = gp.plan(task.start, task.goal, task.scene, w=0.0, planner=sys.argv[2], callback=stop)
print(time.perf_counter() - started if result.status is gp.PlanStatus.SOLVED else float("inf"))
"""
_GROWTH = """
import gc, sys
import graceful_plan as gp
from graceful_plan.compare.runs.machine import resident_megabytes
tasks = list(gp.load_scene("tabletop").tasks.values())
def plan(seed):
    task = tasks[seed % len(tasks)]
    gp.plan(task.start, task.goal, task.scene, w=1.0, iterations=300, seed=seed)
for seed in range(int(sys.argv[2])): plan(seed)
gc.collect()
before = resident_megabytes()
for seed in range(int(sys.argv[1])): plan(seed)
gc.collect()
print(resident_megabytes() - before)
"""


def targets(options: suite.Options) -> Iterator[report.Target]:
    """Measure everything in new processes."""
    processes, plans, warm_up = options.pick((7, 300, 100), quick=(1, 2, 2), long=(9, 1000, 100))
    for what, (code, limit) in _IMPORTS.items():
        yield _within(what, limit, [_number(_IMPORT.format(code)) for _ in range(processes + 1)])
    for command in ("--version", "scenes"):
        seconds = [_number(_COMMAND, command) for _ in range(processes + 1)]
        yield _within(f"graceful-plan {command}", SAID_WITHIN, seconds)
    for task, planner in FIRST_PLANS:
        seconds = [_number(_FIRST_PLAN, task, planner) for _ in range(processes + 1)]
        yield _within(f"first plan, {task}, {planner}", FIRST_PLAN_WITHIN, seconds)
    growth = _number(_GROWTH, str(plans), str(warm_up))
    yield report.Target(
        what=f"memory growth over {plans} plans",
        wanted=f"< {GROWTH_BELOW:g} MB",
        measured=f"{growth:.1f} MB",
        met=growth < GROWTH_BELOW,
    )


def _within(what: str, limit: float | None, seconds: list[float]) -> report.Target:
    """Judge by the median; the first process warms the file cache and does not count."""
    median, slowest = float(np.median(seconds[1:])), max(seconds[1:])
    measured_text = f"{report.quantity(median, ' s')}, slowest {report.quantity(slowest, ' s')}"
    wanted, met = ("-", None) if limit is None else (f"< {limit:g} s", median < limit)
    return report.Target(what=what, wanted=wanted, measured=measured_text, met=met)


def _number(code: str, *arguments: str) -> float:
    """Run code in a new process and return the number it prints; infinite if it fails."""
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if done.returncode:
        print(done.stderr, file=sys.stderr)
        return np.inf
    return float(done.stdout)
