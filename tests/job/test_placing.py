"""Placements stand on the surface, inside the region, apart from everything; MuJoCo is the oracle."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.exceptions import SettingError, UnknownNameError, UnsupportedError
from graceful_plan.job.placing import support_of
from graceful_plan.scene.scene import Scene


@pytest.fixture(scope="module")
def dining() -> Scene:
    return gp.load_scene("dining_table")


@pytest.mark.parametrize("name", ["bottle", "wine_glass_left", "teapot"])
def test_placements_touch_only_their_support(dining: Scene, name: str) -> None:
    found = gp.placements(dining, name, on="table", n=8, seed=1)
    assert len(found) == 8
    for X_WO in found:
        placed = dining.edit(move={name: X_WO})
        assert support_of(placed, name) == "table"
        data = mujoco.MjData(placed.model)
        data.qpos[:] = placed.home_qpos
        mujoco.mj_forward(placed.model, data)
        bodies = placed.model.geom_bodyid[data.contact.geom]
        mine = placed.model.body(name).id
        met = {placed.model.body(b).name for pair in bodies.tolist() if mine in pair for b in pair} - {name}
        assert met <= {"table"}


def test_a_region_holds_the_feet(dining: Scene) -> None:
    region = np.array([[0.3, 0.0, 0.7], [0.5, 0.25, 0.8]])
    found = gp.placements(dining, "bottle", in_region=region, n=5)
    assert len(found) == 5
    radius = 0.037
    assert (found[:, :2, 3] > region[0, :2] + 0.9 * radius).all()
    assert (found[:, :2, 3] < region[1, :2] - 0.9 * radius).all()


def test_same_seed_same_placements(dining: Scene) -> None:
    one, other = (gp.placements(dining, "bottle", on="table", n=4, seed=7) for _ in range(2))
    np.testing.assert_array_equal(one, other)


def test_where_there_is_no_space_nothing_is_found(dining: Scene) -> None:
    assert len(gp.placements(dining, "bottle", in_region=[[0.3, 0.0, 0.7], [0.32, 0.02, 0.8]])) == 0


def test_misuse_is_named(dining: Scene) -> None:
    with pytest.raises(SettingError, match="horizontal top"):
        gp.placements(dining, "bottle")
    with pytest.raises(SettingError, match="corner"):
        gp.placements(dining, "bottle", in_region=[[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    with pytest.raises(UnknownNameError):
        gp.placements(dining, "bottle", on="shelf")
    with pytest.raises(UnsupportedError, match="horizontal top"):
        gp.placements(dining, "bottle", on="person_head")
