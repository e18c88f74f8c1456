"""Fixed arms need nothing of the mobile package; a mobile base without it gives an error that names the package."""

from __future__ import annotations

import subprocess
import sys

ARM = """
task = gp.load_scene("tabletop_l1").tasks["green_to_blue"]
scene = task.scene.with_moving(
    gp.MovingEntity("guest", "adult", size=[0.25, 0.85], t=[0, 4], position=[[-1, 1, 0.85], [1, 1, 0.85]], spread=0.05)
)
results = [
    gp.plan(task.start, task.goal, task.scene, iterations=40),
    gp.plan(task.start, task.goal, task.scene, iterations=40, w=0.0, planner="rrt_connect"),
    gp.plan(task.start, task.goal, scene, iterations=40),
]
assert all(result.status is gp.PlanStatus.SOLVED for result in results), [result.detail for result in results]
"""
BLOCKED = """
import sys

class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[2].partition(".")[0] == "mobile":
            raise ImportError(f"{name} is blocked")

sys.meta_path.insert(0, Blocked())
"""
LOADED = """
import sys
loaded = [name for name in sys.modules if name.startswith(("graceful_plan.mobile", "failbench.mobile"))]
assert not loaded, loaded
"""
EXECUTED = """
import failbench
failbench.validate(results[0], task.scene, "power/*/severe", n=4, horizon=0.1)
"""


def run(code: str) -> None:
    """Run a program in a new process."""
    code = f"import graceful_plan as gp\n{code}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_fixed_arm_is_planned_for_and_simulated_without_the_mobile_package():
    base = 'gp.plan("ready", gp.BasePose(2.0, 0.0), gp.load_scene("hallway"), w=0.0, iterations=1)'
    run(f"{ARM}{EXECUTED}{LOADED}{base}\nassert any(name.startswith('graceful_plan.mobile') for name in sys.modules)")


def test_without_the_package_the_error_names_it_and_its_planners_are_not_listed():
    run(
        BLOCKED
        + """
from graceful_plan.exceptions import UnsupportedError
for w in (0.3, 0.0):
    try:
        gp.plan("ready", gp.BasePose(2.0, 0.0), gp.load_scene("hallway"), w=w)
    except UnsupportedError as error:
        assert "graceful_plan.mobile" in str(error), error
    else:
        raise AssertionError("nothing was raised")
task = gp.load_scene("tabletop_l1").tasks["green_to_blue"]
try:
    gp.plan(task.start, task.goal, task.scene, planner="drive_lattice")
except gp.GracefulPlanError as error:
    assert error.valid == tuple(sorted(gp.PLANNERS)), error
else:
    raise AssertionError("nothing was raised")
"""
    )
