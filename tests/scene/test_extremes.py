"""Extreme sizes and positions: covered coarsely, or refused by name before anything is built."""

from __future__ import annotations

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import CAPACITY
from graceful_plan.exceptions import SceneError, SettingError

_SCENE = gp.load_scene("tabletop")
_REFUSED = r"single precision takes 10000 m|(mass|inertia) of '.*' is not finite"
_TEXT = """<mujoco><compiler angle="radian" autolimits="true"/>
<custom><numeric name="r/velocity_limit" data="1"/><numeric name="r/acceleration_limit" data="1"/></custom>
<worldbody>
  <geom name="floor" type="plane" size="0 0 .1"/>
  <body name="crate" pos="2 0 {height}"><freejoint/><geom type="box" size="{crate}" mass="1"/></body>
  <body name="r/a" pos="0 0 3"><joint name="j" axis="0 0 1" range="-1 1"/>
    <geom type="box" size="{link}" mass="1"/><site name="t" pos="0 0 1"/></body>
</worldbody></mujoco>"""


def _robot(link: str = ".1 .1 .1", crate: str = ".1 .1 .1", height: float = 0.2) -> gp.Scene:
    return gp.Scene.from_mjcf(_TEXT.format(link=link, crate=crate, height=height), robot="r/", tool="t")


@pytest.mark.parametrize("size", [1e8, 1e30, 1e300])
def test_a_box_larger_than_single_precision_can_hold_is_refused(size: float) -> None:
    with pytest.raises(SceneError, match=_REFUSED):
        _SCENE.add_box("planet", [size] * 3, [0.0, 0.0, -3.0])
    with pytest.raises(SettingError, match="size of planet"):
        gp.MovingEntity("planet", "adult", size=[size] * 3, t=[0.0], position=[[1.0, 1.0, 1.0]])
    with pytest.raises(SceneError, match=_REFUSED):
        _robot(link=f"{size} .1 .1")


@pytest.mark.parametrize("place", [1e5, 1e30, 1e300])
def test_a_place_farther_than_single_precision_can_tell_is_refused(place: float) -> None:
    with pytest.raises(SceneError, match="10000 m"):
        _SCENE.add_box("star", [0.1, 0.1, 0.1], [place, 0.0, 1.0])
    with pytest.raises(SettingError, match="position of star"):
        gp.MovingEntity("star", "adult", size=[0.1, 0.1], t=[0.0], position=[[place, 1.0, 1.0]])


def test_a_kilometre_of_a_beam_fits_into_the_kernels() -> None:
    """It used to be refused only after 2.2 million spheres had been built."""
    assert len(compile_scene(_robot(link="500 .05 .05")).robot.sphere) <= CAPACITY["spheres"]


def test_a_crate_of_sixty_centimetres_can_be_carried() -> None:
    scene = _robot(crate=".3 .3 .3", height=0.3).attach("crate", X_TO=np.eye(4) + 0.0)
    assert len(compile_scene(scene).robot.sphere) <= CAPACITY["spheres"]
    result = gp.plan([-0.5], [0.5], scene, w=0.0, iterations=20, constraints=[])
    assert result.status is gp.PlanStatus.SOLVED, result.detail
