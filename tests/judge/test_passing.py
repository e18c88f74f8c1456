"""The judge of poses on the way: motions with known passing times and errors."""

from __future__ import annotations

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.judge.passing import NEAR, passing
from graceful_plan.path import Path
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.retiming import retime
from graceful_plan.timing.trajectory import Trajectory

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


def straight_on(end: tuple[float, float, float]) -> Trajectory:
    """Return a motion from zero to `end` at constant speed within 1 s."""
    q = np.array([np.zeros(3), end])
    return Trajectory(np.array([0.0, 1.0]), q, np.repeat(q[1:], 2, axis=0), np.zeros((2, 3)), ("x", "y", "turn"))


def out_and_back(gantry: Scene) -> Trajectory:
    """Return a motion to x = 1 and back, at the limits: 2 s each way, symmetric in time."""
    return retime(Path(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])), gantry.limits, deviation=0.0)


@pytest.mark.parametrize("share", [0.0371, 0.25, 0.5003, 0.9999])
def test_a_configuration_is_passed_when_the_motion_is_nearest(gantry, share):
    """Also between two samples; the least error is exact to rounding, the time to its square root."""
    motion = straight_on((1.0, -0.4, 0.3))
    check, times = passing(motion, [share * motion.q[1]], gantry)
    assert check.passed and check.worst < 1e-3 and check.limit == 1.0
    assert times == pytest.approx((share,), abs=1e-6)
    assert check.detail.endswith(f"passed at {share:.3f} s")


@pytest.mark.parametrize("off", [0.5, 0.99, 1.01, 2.0, 30.0])
def test_a_configuration_may_be_off_by_so_much(gantry, off):
    check, times = passing(straight_on((1.0, 0.0, 0.0)), [np.array([0.4, 0.0, off * NEAR])], gantry)
    assert check.worst == pytest.approx(off, rel=1e-6) and check.passed == (off < 1.0) and check.limit == 1.0
    assert times == (pytest.approx((0.4,), abs=1e-3) if off < 1.0 else ())
    if not check.passed:
        # The minimum is as wide as the error, since the largest joint error counts.
        assert check.first == pytest.approx(0.4, abs=1.01 * off * NEAR)
        assert "via 0 " in check.detail and f"{off:.3g} times" in check.detail


@pytest.mark.parametrize("off", [0.5, 0.99, 1.01, 3.0])
def test_a_pose_may_be_off_by_its_tolerances(gantry, off):
    motion, tolerances = straight_on((1.0, 0.5, 0.4)), {"position_tolerance": 0.004, "orientation_tolerance": 0.02}
    beside = gp.PoseGoal.from_tool(np.array([0.6, 0.3, 0.24]), gantry, **tolerances)
    X_WT = beside.X_WT.copy()
    X_WT[2, 3] += off * 0.004
    check, times = passing(motion, [gp.PoseGoal(X_WT, **tolerances)], gantry)
    assert check.worst == pytest.approx(off, rel=1e-4) and check.passed == (off < 1.0)
    assert times == (pytest.approx((0.6,), abs=1e-3) if off < 1.0 else ())


@pytest.mark.parametrize("off", [0.9, 1.1])
def test_orientation_counts_by_itself(gantry, off):
    motion = straight_on((1.0, 0.0, 0.0))
    via = gp.PoseGoal.from_tool(np.array([0.3, 0.0, off * 0.02]), gantry, orientation_tolerance=0.02)
    check, times = passing(motion, [via], gantry)
    assert check.worst == pytest.approx(off, rel=1e-6) and check.passed == (off < 1.0)
    # Within a millimetre only the angle matters.
    assert times == (pytest.approx((0.3,), abs=2e-3) if off < 1.0 else ())


def test_order_counts(gantry):
    motion = straight_on((1.0, 0.0, 0.0))
    near, far = np.array([0.2, 0.0, 0.0]), np.array([0.7, 0.0, 0.0])
    assert passing(motion, [near, far], gantry)[1] == pytest.approx((0.2, 0.7), abs=1e-6)
    check, times = passing(motion, [far, near], gantry)
    assert not check.passed and "via 1" in check.detail and times == pytest.approx((0.7,), abs=1e-6)
    # After that, the nearest point is where the previous pose was passed.
    assert check.worst == pytest.approx(0.5 / NEAR, rel=1e-3) and check.first == pytest.approx(0.7, abs=1e-3)


def test_a_pose_passed_twice_counts_at_its_first_remaining_time(gantry):
    motion, x = out_and_back(gantry), np.array([0.3, 0.0, 0.0])
    (first,) = passing(motion, [x], gantry)[1]
    assert first < 1.0 < motion.duration - first
    end = np.array([1.0, 0.0, 0.0])
    assert passing(motion, [x, end, x], gantry)[1] == pytest.approx((first, 2.0, motion.duration - first), abs=1e-4)
    assert passing(motion, [x, x], gantry)[1] == pytest.approx((first, first), abs=1e-5)
    assert not passing(motion, [x, end, x, end], gantry)[0].passed


def test_both_ends_count(gantry):
    motion = straight_on((1.0, 0.0, 0.0))
    assert passing(motion, list(motion.q), gantry)[1] == pytest.approx((0.0, 1.0), abs=1e-4)
    assert passing(motion, [], gantry)[0].passed
