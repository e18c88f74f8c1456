"""The judge of straight motions: exact on motions with known deviation."""

from __future__ import annotations

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.judge.straightness import straightness
from graceful_plan.path import Path
from graceful_plan.scene.scene import Scene

_GANTRY = """
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <body name="arm/x"><joint name="arm/x" type="slide" axis="1 0 0" range="-2 2"/>
      <geom name="arm/x" size=".02" mass="1"/>
      <body name="arm/y"><joint name="arm/y" type="slide" axis="0 1 0" range="-2 2"/>
        <geom name="arm/y" size=".02" mass="1" pos="0 0 .1"/>
        <body name="arm/turn"><joint name="arm/turn" axis="0 0 1" range="-3 3"/>
          <geom name="arm/turn" size=".02" mass="1" pos="0 0 .2"/>
          <site name="arm/tool" pos="0 0 .2"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.fixture(scope="module")
def gantry() -> Scene:
    return Scene.from_mjcf(_GANTRY, robot="arm/", tool="arm/tool", velocity=[1.0] * 3, acceleration=[1.0] * 3)


def _checks(gantry, q, **bounds):
    goal = gp.PoseGoal.from_tool(q[-1], gantry)
    return straightness(Path(np.array(q)), goal, gantry, **({"deviation": 1e-3, "angle": 1e-2} | bounds))


def test_a_straight_motion_passes(gantry):
    checks = _checks(gantry, [[0.0, 0.0, 0.0], [1.0, 0.5, 0.0]])
    assert all(check.passed and check.worst < 1e-9 for check in checks.values())


@pytest.mark.parametrize("off", [5e-4, 2e-3, 0.1])
def test_distance_from_the_line(gantry, off):
    check = _checks(gantry, [[0.0, 0.0, 0.0], [0.5, off, 0.0], [1.0, 0.0, 0.0]])["deviation"]
    assert check.worst == pytest.approx(off, rel=0.05) and check.passed == (off < 1e-3)
    assert (check.first is None) == check.passed


@pytest.mark.parametrize("off", [5e-3, 2e-2, 0.3])
def test_angle_to_the_orientation_due(gantry, off):
    check = _checks(gantry, [[0.0, 0.0, 0.0], [0.5, 0.0, off + 0.2], [1.0, 0.0, 0.4]])["orientation"]
    assert check.worst == pytest.approx(off, rel=0.05) and check.passed == (off < 1e-2)


def test_turning_on_the_spot(gantry):
    checks = _checks(gantry, [[0.0, 0.0, 0.0], [0.0, 0.0, 2.0]])
    assert all(check.passed for check in checks.values())
    checks = _checks(gantry, [[0.0, 0.0, 0.0], [0.01, 0.0, 1.0], [0.0, 0.0, 2.0]])
    assert checks["orientation"].passed and checks["deviation"].worst == pytest.approx(0.01, rel=0.05)


def test_going_on_beyond_the_goal_is_a_deviation(gantry):
    q = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    goal = gp.PoseGoal.from_tool([0.9, 0.0, 0.0], gantry)
    check = straightness(Path(q), goal, gantry, deviation=1e-3, angle=1e-2)["deviation"]
    assert check.worst == pytest.approx(0.1) and not check.passed


def test_free_yaw_looks_at_the_axis_alone(gantry):
    q = Path(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 2.0]]))
    goal = gp.PoseGoal.from_tool(q.q[-1], gantry, rotation=[0.0, 0.0, -1.0], free_yaw=True)
    assert straightness(q, goal, gantry, deviation=1e-3, angle=1e-2)["orientation"].worst < 1e-9
