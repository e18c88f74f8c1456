"""Healthy bases follow the tightest and fastest curves of plans."""

import numpy as np
import pytest

from failbench.mobile.slipping import fitted_tracking, steady_drive
from failbench.rollouts.execution import execute
from failbench.simulated.world import build_world
from graceful_plan.mobile.motions.drive import Drive
from graceful_plan.mobile.motions.drive_limits import drive_limits
from graceful_plan.mobile.motions.rolling_spline import RollingSpline
from graceful_plan.timing.retiming import timed
from jackals import jackal

HOOK = [[0, 0], [0.2, 0], [0.4, 0], [0.6, 0], [0.75, 0.1], [0.75, 0.4], [0.6, 0.5], [0.6, 0.8], [0.8, 0.9], [1.1, 0.9],
        [1.4, 0.9], [1.7, 0.9]]  # fmt: skip


def test_a_skid_steer_drives_a_hook_there_and_back():
    """When the heading was held at the pivot's drift angle, it was off by 0.35 rad and the motion was refused."""
    scene, controls = jackal(), np.array(HOOK)
    curve = RollingSpline(np.column_stack([controls, np.zeros(len(controls))]), True, 0.0)
    motion = timed(Drive((curve,)), scene.limits, scene.joints, restraint=lambda grid: drive_limits(scene.base, grid))
    error = execute(motion, build_world(scene)).tracking_error
    assert error[2] < 0.27 and error[:2].max() < 0.1


@pytest.mark.parametrize(
    ("v", "omega"), [(1.5, 1.0), (-1.5, 1.0), *(pytest.param(v, 1.0, marks=pytest.mark.long) for v in (-1.0, -0.5))]
)
def test_where_nothing_moves_sideways_is_known_in_both_gears(v, omega):
    """At 1.5 m/s backwards, the point without lateral motion is 13 cm behind the origin; forwards, 9 cm."""
    drives = steady_drive(jackal(), v, omega)
    assert fitted_tracking(jackal()).pivot.ahead(v, omega) == pytest.approx(-drives.sideways / drives.omega, abs=0.02)
