"""Openings in metres: linkages, jaws and slides; MuJoCo's settled linkage; closing on the object; misuse."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from grippers import CUP, JAW, JAW_DRIVE, LINKAGE, LINKAGE_DRIVE, LINKAGE_TIES, SLIDES, armed, below, linkage

import graceful_plan as gp
from graceful_plan.exceptions import SceneError, SettingError, UnsupportedError

_TILT = 2e-3
"""By how much pads that tilt are nearer at their rim than beside the tool [m]."""


def _gap(scene: gp.Scene, one: str, other: str) -> float:
    data = scene.data_at([0.0])
    a, b = scene.model.geom(one).id, scene.model.geom(other).id
    return float(mujoco.mj_geomDistance(scene.model, data, a, b, 1.0, None))


def _at(scene: gp.Scene, *joints: str) -> list[float]:
    return [float(scene.home_qpos[scene.model.joint(f"g/{joint}").qposadr[0]]) for joint in joints]


@pytest.mark.parametrize("metres", [0.07, 0.05, 0.02])
def test_an_opening_of_a_linkage_is_the_distance_of_its_pads(metres: float) -> None:
    scene = linkage(fingers=gp.Opening(metres))
    assert _gap(scene, "g/left_pad", "g/right_pad") == pytest.approx(metres, abs=_TILT)
    data = scene.data_at([0.0])
    mujoco.mj_fwdPosition(scene.model, data)
    mine = data.efc_type[: data.nefc] == int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
    assert np.abs(data.efc_pos[: data.nefc][mine]).max() < 1e-5  # the chains are closed


def test_springs_decide_where_a_chain_is_free_as_in_mujoco() -> None:
    scene = linkage()
    model, data = scene.model, mujoco.MjData(scene.model)
    model.opt.gravity[:] = 0.0
    data.qpos[:], data.ctrl[1] = scene.home_qpos, 0.4
    for _ in range(3000):
        mujoco.mj_step(model, data)
    names = ["right_driver", "left_driver", "left_coupler", "left_rocker", "left_finger"]
    settled = [float(data.qpos[model.joint(f"g/{name}").qposadr[0]]) for name in names]
    assert settled[0] == pytest.approx(0.4, abs=0.01)
    assert _at(linkage(fingers=settled[0]), *names) == pytest.approx(settled, abs=8e-3)  # joint limits are soft


def test_one_jaw_may_be_fixed() -> None:
    scene = armed(JAW, drive=JAW_DRIVE, fingers=gp.Opening(0.045))
    model, data = scene.model, scene.data_at([0.0])
    tool, distance = data.site("g/tool"), 0.0
    for name, side in (("g/moving", 1.0), ("g/fixed", -1.0)):
        geom, along = model.geom(name), side * tool.xmat.reshape(3, 3)[:, 1]
        there = data.geom(name)
        distance += mujoco.mju_rayGeom(there.xpos, there.xmat, geom.size, tool.xpos, along, int(geom.type[0]))
    assert distance == pytest.approx(0.045, abs=_TILT)


def test_a_stroke_ends_where_the_linkage_does() -> None:
    short = LINKAGE.replace('range="-.9 .9"', 'range="-.4 .9"').replace('range="-1.5 0"', 'range="-.05 0"')
    scene = armed(short, LINKAGE_TIES, LINKAGE_DRIVE, fingers=gp.Opening(0.05))
    with pytest.raises(SettingError, match=r"opening = 0\.003"):
        armed(short, LINKAGE_TIES, LINKAGE_DRIVE, fingers=gp.Opening(0.003))
    assert _gap(scene, "g/left_pad", "g/right_pad") == pytest.approx(0.05, abs=_TILT)


def test_mirrored_slides_open_in_opposite_directions() -> None:
    assert _at(armed(SLIDES, fingers=gp.Opening(0.05)), "left", "right") == pytest.approx([0.025, -0.025], abs=1e-4)


def test_fingers_close_on_the_object() -> None:
    scene = linkage(carried="block", X_TO=below(0.02), fingers=gp.Opening())
    data = scene.data_at([0.0])
    pads = [scene.model.geom(f"g/{side}_pad").id for side in ("left", "right")]
    (block,) = scene.components["carried"].geoms
    gaps = [mujoco.mj_geomDistance(scene.model, data, pad, block, 1.0, None) for pad in pads]
    assert gaps == pytest.approx([0.0, 0.0], abs=1e-4)
    empty = scene.detach()
    assert _at(empty, "left_driver") == [0.0]  # only while the object is held


def test_an_opening_survives_edits_and_costs_them_nothing() -> None:
    scene = linkage(fingers=gp.Opening(0.05))
    moved = scene.edit(move={"vase": [0.4, 0.1, 0.1]}).with_severity({"vase": 3.0})
    assert np.array_equal(moved.home_qpos, scene.home_qpos)
    assert isinstance(moved.notes.fingers, dict)  # solved once


def test_scene_files_have_openings(tmp_path: Path) -> None:
    (tmp_path / "world.xml").write_text(mujoco.MjSpec.to_xml(linkage().spec))
    file = tmp_path / "scene.yaml"
    text = """version: 1
world: world.xml
robot: {prefix: a/, velocity: [2], acceleration: [6]}
tool: g/tool
fingers: {opening: 0.05}
objects:
  block: {grasp: {position: [0, 0, 0.02]}, fingers: {opening: object}}
"""
    file.write_text(text)
    scene = gp.load_scene(str(file))
    assert _at(scene, "left_driver") == pytest.approx(_at(linkage(fingers=gp.Opening(0.05)), "left_driver"))
    assert _at(scene.attach("block"), "left_driver") > _at(scene, "left_driver")
    file.write_text(text.replace("opening: 0.05", "opening: 0.05, g/left_driver: 0"))
    with pytest.raises(SceneError, match="g/left_driver"):
        gp.load_scene(str(file))


@pytest.mark.parametrize("metres", [-0.01, float("nan"), float("inf")])
def test_an_opening_is_a_length(metres: float) -> None:
    with pytest.raises(SettingError, match="metres"):
        gp.Opening(metres)


def test_impossible_openings() -> None:
    with pytest.raises(SettingError, match=r"opening = 0.2, expected between .* and 0.073"):
        linkage(fingers=gp.Opening(0.2))
    with pytest.raises(SettingError, match="nothing is carried"):
        linkage(fingers=gp.Opening())
    with pytest.raises(SettingError, match=r"does not overlap, as it does by \d+\.\d mm"):
        linkage(carried="block", X_TO=below(-0.1), fingers=gp.Opening())
    with pytest.raises(UnsupportedError, match="no joint"):
        armed(CUP, fingers=gp.Opening(0.02))
    with pytest.raises(UnsupportedError, match="'g/tool' is not between two fingers"):
        armed(LINKAGE.replace('pos="0 0 .145"', 'pos="0 0 .4"'), fingers=gp.Opening(0.02))
