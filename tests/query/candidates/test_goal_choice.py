"""Several goals: the best one is found, also if another one is easier to reach."""

from __future__ import annotations

import numpy as np
import pytest

import graceful_plan as gp

_BEHIND_A_GAP, _FREE, _ENCLOSED = [0.5, 0.0], [-0.9, 0.3], [0.5, 0.8]
_START = [0.0, 0.3]


@pytest.fixture(scope="module")
def hall() -> gp.Scene:
    """Return a hall with a ball that slides in x and y; a wall has a gap 2 cm wider than the ball."""
    return gp.Scene.from_mjcf(
        """<mujoco><worldbody>
          <body name="walls">
            <geom type="box" size=".02 .5 .2" pos=".3 .53 .1"/><geom type="box" size=".02 .5 .2" pos=".3 -.53 .1"/>
            <geom type="box" size=".5 .02 .2" pos=".8 .5 .1"/>
          </body>
          <body name="ball/x"><joint name="x" type="slide" axis="1 0 0" range="-1 1"/>
            <geom type="sphere" size=".004" pos="0 0 .05" mass=".1"/>
            <body name="ball/y"><joint name="y" type="slide" axis="0 1 0" range="-1 1"/>
              <geom type="sphere" size=".02" pos="0 0 .1" mass="1"/><site name="tool" pos="0 0 .1"/>
            </body>
          </body>
        </worldbody></mujoco>""",
        robot="ball/",
        tool="tool",
        velocity=[1.0, 1.0],
        acceleration=[5.0, 5.0],
    )


@pytest.mark.parametrize("w", [0.0, 0.3])
@pytest.mark.parametrize("seed", [5, 9])  # those of the first ten with which a search stayed at the far goal
def test_a_near_goal_behind_a_gap_wins_over_a_far_one_in_the_open(hall: gp.Scene, seed: int, w: float) -> None:
    result = gp.plan(_START, [_FREE, _BEHIND_A_GAP], hall, w=w, seed=seed, iterations=4000)
    assert result.goal_index == 1
    around_the_corner = np.hypot(0.28, 0.29) + np.hypot(0.22, 0.01)
    assert result.cost is not None and result.cost.total <= 1.03 * around_the_corner


def test_goals_that_cannot_be_reached_do_not_matter(hall: gp.Scene) -> None:
    result = gp.plan(_START, [_ENCLOSED, _FREE], hall, w=0.0, seed=0, iterations=400)
    assert result.goal_index == 1
    assert result.cost is not None
    assert result.cost.total == pytest.approx(np.linalg.norm(np.subtract(_FREE, _START)))
