"""What users wait for before planning: import, first plan, build; and whether memory grows."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks import report, suite

TITLE = "Start-up: import, first plan, memory, build"
ROOT = Path(__file__).parents[2]
IMPORT_WITHIN, SAID_WITHIN, FIRST_PLAN_WITHIN, BUILD_WITHIN = 0.3, 0.3, 0.2, 90.0
GROWTH_BELOW = 5.0
"""Memory growth allowed over 1,000 plans [MB]."""
MEASURED = """\
"Import": `import graceful_plan` in a new process, files in the cache of the system; the interpreter's own start is
not in it. Names are imported when they are first asked for, so that this says little: "everything for planning" is the
same with `plan` and `load_scene` asked for, numpy and MuJoCo in it, which are a line of their own: nothing that plans
can be had sooner. "Version" and "scenes" are whole processes of `graceful-plan --version` and `scenes`, which loads
all of them. "First plan": from the import on, in the same process, `load_scene`, the task's scene with its object, and
`plan(w=0)` until SOLVED, so everything compiled, timed and verified for the first time; "anytime" is stopped at its
first path by a callback. "Memory": what the process holds after many plans on all tasks of `tabletop` in turn, above
what it held after 100 of them; 300 iterations each. "Build": `pip wheel` of the source tree, without isolation and
without an earlier build.
"""

_IMPORT = "import time; t = time.perf_counter(); {}; print(time.perf_counter() - t)"
_IMPORTS = {
    "import": "import graceful_plan",
    "import, everything for planning": "import graceful_plan as gp; gp.plan; gp.load_scene",
    "import of FailBench": "import failbench",
}
_UNDERNEATH = "import numpy, mujoco"
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
for seed in range(100): plan(seed)
gc.collect()
before = resident_megabytes()
for seed in range(int(sys.argv[1])): plan(seed)
gc.collect()
print(resident_megabytes() - before)
"""


FIRST_PLANS = (("tabletop/lift_to_goal", "rrt_connect"), ("tabletop/lift_to_goal", "anytime"))


def run(options: suite.Options) -> str:
    """Measure everything, each in new processes."""
    processes, plans = options.pick((9, 1000), quick=(2, 20))
    lines = list(_targets(processes, plans, build=not options.quick))
    return f"{MEASURED}\n{processes} processes for each of the first rows; medians.\n\n{report.targets(lines)}"


def _targets(processes: int, plans: int, *, build: bool) -> Iterator[report.Target]:
    for what, code in _IMPORTS.items():
        yield _within(what, IMPORT_WITHIN, [_number(_IMPORT.format(code)) for _ in range(processes + 1)])
    yield _within(
        "import of numpy and MuJoCo", None, [_number(_IMPORT.format(_UNDERNEATH)) for _ in range(processes + 1)]
    )
    for command in ("--version", "scenes"):
        seconds = [_number(_COMMAND, command) for _ in range(processes + 1)]
        yield _within(f"graceful-plan {command}", SAID_WITHIN, seconds)
    for task, planner in FIRST_PLANS:
        seconds = [_number(_FIRST_PLAN, task, planner) for _ in range(processes + 1)]
        yield _within(f"first plan, {task}, {planner}", FIRST_PLAN_WITHIN, seconds)
    growth = _number(_GROWTH, str(plans))
    yield report.Target(
        what=f"memory growth over {plans} plans",
        wanted=f"< {GROWTH_BELOW:g} MB",
        measured=f"{growth:.1f} MB",
        met=growth < GROWTH_BELOW,
    )
    if build:
        seconds = _build_seconds()
        yield report.Target(
            what="build from source",
            wanted=f"< {BUILD_WITHIN:g} s",
            measured=report.quantity(seconds, " s"),
            met=seconds < BUILD_WITHIN,
        )


def _within(what: str, limit: float | None, seconds: list[float]) -> report.Target:
    """Judge by the median; the first process has warmed the file cache and does not count."""
    median, slowest = float(np.median(seconds[1:])), max(seconds[1:])
    told = f"{report.quantity(median, ' s')}, slowest {report.quantity(slowest, ' s')}"
    wanted, met = ("-", None) if limit is None else (f"< {limit:g} s", median < limit)
    return report.Target(what=what, wanted=wanted, measured=told, met=met)


def _number(code: str, *arguments: str) -> float:
    """Run code in a new process and return the number that it prints; infinite if it fails."""
    command = [sys.executable, "-c", code, *arguments]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        print(done.stderr, file=sys.stderr)
        return np.inf
    return float(done.stdout)


def _build_seconds() -> float:
    """Build a wheel in an empty folder; infinite if that fails."""
    with tempfile.TemporaryDirectory() as folder:
        pip = [
            sys.executable,
            "-m",
            "pip",
            "--disable-pip-version-check",
            "wheel",
            "-q",
            "--no-deps",
            "--no-build-isolation",
        ]
        into = [f"--config-settings=build-dir={folder}/build", "--wheel-dir", folder, str(ROOT)]
        started = time.perf_counter()
        done = subprocess.run([*pip, *into], capture_output=True, text=True, check=False)
        seconds = time.perf_counter() - started
    if done.returncode:
        print(done.stderr, file=sys.stderr)
        return np.inf
    return seconds
