"""Robots that stand are planned for without the room of what drives; for others it is said that the room is missing."""

from __future__ import annotations

import subprocess
import sys

import pytest

ARM = """
task = gp.load_scene("tabletop_l1").tasks["green_to_blue"]
scene = task.scene.with_moving(
    gp.MovingEntity("guest", "adult", size=[0.25, 0.85], t=[0, 4], position=[[-1, 1, 0.85], [1, 1, 0.85]], spread=0.05)
)
results = [
    gp.plan(task.start, task.goal, task.scene, iterations=200),
    gp.plan(task.start, task.goal, task.scene, iterations=200, w=0.0, planner="rrt_connect"),
    gp.plan(task.start, task.goal, scene, iterations=200),
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
    """Run a program in a process of its own, which has imported nothing."""
    code = f"import graceful_plan as gp\n{code}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_an_arm_is_planned_for_without_any_module_of_the_room():
    run(ARM + LOADED)


def test_an_arm_fails_in_simulation_without_any_module_of_the_room():
    run(ARM + EXECUTED + LOADED)


def test_what_drives_loads_the_room():
    with pytest.raises(AssertionError, match=r"graceful_plan\.mobile\.coast\.coast"):
        run('gp.plan("ready", "far_end", gp.load_scene("hallway"), iterations=1)' + LOADED)


def test_an_arm_is_planned_for_if_the_room_is_missing():
    run(BLOCKED + ARM + EXECUTED)


@pytest.mark.parametrize("w", ["0.3", "0.0"])
def test_who_drives_is_told_that_the_room_is_missing(w):
    run(
        BLOCKED
        + f"""
from graceful_plan.exceptions import UnsupportedError
try:
    gp.plan("ready", gp.BasePose(2.0, 0.0), gp.load_scene("hallway"), w={w})
except UnsupportedError as error:
    assert "graceful_plan.mobile: not installed" in str(error), error
else:
    raise AssertionError("nothing was raised")
"""
    )


def test_planners_for_bases_are_not_named_if_the_room_is_missing():
    run(
        BLOCKED
        + """
task = gp.load_scene("tabletop_l1").tasks["green_to_blue"]
try:
    gp.plan(task.start, task.goal, task.scene, planner="drive_lattice")
except gp.GracefulPlanError as error:
    assert error.valid == tuple(sorted(gp.PLANNERS)), error
else:
    raise AssertionError("nothing was raised")
"""
    )
