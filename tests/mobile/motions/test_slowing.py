"""Where a base drives slowly: what is asked of its speed is what a motion then has, on stretches of every kind."""

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.mobile.motions.drive_curve import Roll, Straight, connected
from graceful_plan.mobile.motions.slowing import capped
from graceful_plan.mobile.query import answer
from graceful_plan.timing.retiming import timed
from hall import hall

SCENE = hall()


@pytest.mark.parametrize("share", [0.2, 0.6])
def test_shares_of_the_speed_hold_on_every_stretch(share):
    def line(begin, end):
        return begin[:2] + np.linspace(0.0, 1.0, 6)[:, None] * (np.asarray(end[:2]) - begin[:2])

    # A roll, whose parameter is a share of it, and edges, whose parameter is a length.
    a, b, c, d = np.array([[-7.0, 0.0, 0.0], [7.0, 0.0, 0.0], [7.0, 0.0, 3.0], [5.02, 0.283, 3.0]])
    drive = connected([Roll(line(a, b), a, b, True), Straight(b, c), Straight(c, d)])
    fast = timed(drive, SCENE.limits, SCENE.joints, speed=1.0)
    grid = next(g for g in map(drive.grid, (1, 2, 4)) if len(g.q) == len(fast))
    rolls = (fast.q[:, 0] > -2.0) & (fast.q[:, 0] < 0.0)
    slow = timed(
        drive, SCENE.limits, SCENE.joints, speed=1.0, restraint=capped(grid, fast, np.where(rolls, share, 1.0))
    )
    there = (slow.q[:, 0] > -1.95) & (slow.q[:, 0] < -0.05)
    along = slice(np.argmax(fast.q[:, 0] > 6.999))
    wanted = share * np.interp(slow.q[there, 0], fast.q[along, 0], np.abs(fast.qd[along, 0]))
    np.testing.assert_allclose(np.abs(slow.qd[there, 0]), wanted, rtol=0.05, atol=0.01)


def test_it_is_slow_near_others_even_if_there_is_no_time_for_more(monkeypatch):
    monkeypatch.setattr(answer, "wants_it_soon", lambda found: True)
    soon, plain = (gp.plan("west", "east", SCENE, w=w, iterations=4000) for w in (1.0, 0.0))
    assert soon.status is plain.status is gp.PlanStatus.SOLVED
    assert soon.cost.total < 0.98 * gp.evaluate(plain.trajectory, SCENE, gp.Objective(w=1.0)).total
