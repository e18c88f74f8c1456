"""Links far larger than their robot are named at load, with the mesh file and the factor."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

import graceful_plan as gp

_CAMERA = [(x, y, z) for x in (-30.0, 30.0) for y in (-12.0, 12.0) for z in (-12.0, 12.0)]  # in millimetres
_OBJ = "".join(f"v {x} {y} {z}\n" for x, y, z in _CAMERA) + "".join(
    f"f {a} {b} {c}\n"
    for a, b, c in (
        (1, 2, 4),
        (1, 4, 3),
        (5, 7, 8),
        (5, 8, 6),
        (1, 5, 6),
        (1, 6, 2),
        (3, 4, 8),
        (3, 8, 7),
        (1, 3, 7),
        (1, 7, 5),
        (2, 6, 8),
        (2, 8, 4),
    )
)
_URDF = """<robot name="arm">
  <link name="foot"><collision><geometry><box size=".1 .1 .1"/></geometry></collision></link>
  <link name="boom"><collision><origin xyz=".3 0 0"/><geometry><box size=".5 .05 .05"/></geometry></collision></link>
  <link name="fore"><collision><origin xyz=".3 0 0"/><geometry><box size=".5 .05 .05"/></geometry></collision></link>
  <link name="camera"><collision><geometry><mesh filename="camera.obj" {scale}/></geometry></collision></link>
  <joint name="j1" type="revolute"><parent link="foot"/><child link="boom"/><axis xyz="0 0 1"/>
    <limit lower="-2" upper="2" effort="9" velocity="1"/></joint>
  <joint name="j2" type="revolute"><parent link="boom"/><child link="fore"/><origin xyz=".6 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-2" upper="2" effort="9" velocity="1"/></joint>
  <joint name="end" type="fixed"><parent link="fore"/><child link="camera"/><origin xyz=".6 0 .1"/></joint>
</robot>"""
_MJCF = """<mujoco><asset><mesh file="camera.obj" scale="{scale}"/></asset><worldbody>
  <body name="r/foot"><geom type="box" size=".05 .05 .05"/>
    <body name="r/boom" pos="0 0 .2"><joint name="r/j1" axis="0 0 1" range="-2 2"/>
      <geom type="box" size=".3 .02 .02" pos=".3 0 0"/>
      <body name="r/fore" pos=".6 0 0"><joint name="r/j2" axis="0 0 1" range="-2 2"/>
        <geom type="box" size=".3 .02 .02" pos=".3 0 0"/>
        <body name="r/camera" pos=".6 0 .1"><geom type="mesh" mesh="camera"/></body></body></body></body>
</worldbody></mujoco>"""


def _warnings(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING]


def _load(folder: Path, urdf: bool, scale: float) -> gp.Scene:
    (folder / "camera.obj").write_text(_OBJ)
    if urdf:
        given = "" if scale == 1.0 else f'scale="{scale} {scale} {scale}"'
        (folder / "arm.urdf").write_text(_URDF.format(scale=given))
        return gp.Scene.from_urdf(folder / "arm.urdf", tool="camera", acceleration=5.0)
    (folder / "arm.xml").write_text(_MJCF.format(scale=f"{scale} {scale} {scale}"))
    given = {"velocity": [1.0] * 2, "acceleration": [5.0] * 2}
    return gp.Scene.from_mjcf(folder / "arm.xml", robot="r/", tool="r/camera", **given)  # type: ignore[arg-type]


@pytest.mark.parametrize("urdf", [True, False])
def test_a_mesh_in_millimetres_is_named(tmp_path: Path, caplog: pytest.LogCaptureFixture, urdf: bool) -> None:
    _load(tmp_path, urdf, 1.0)
    (told,) = [text for text in _warnings(caplog) if "large" in text]
    for word in ("camera", "60 m large", "100 times", ".obj", "0.001"):
        assert word in told
    caplog.clear()
    _load(tmp_path, urdf, 0.001)
    assert not _warnings(caplog)


def test_pairs_that_always_overlap_deeply_are_named(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    scene = _load(tmp_path, True, 1.0)
    (told,) = [text for text in _warnings(caplog) if "overlap" in text]
    assert "arm/foot - arm/fore" in told and "mm" in told
    assert "arm/boom - arm/fore\n  overlap: " in scene.describe()
    assert "overlap: arm/graceful_plan_base - arm/fore" in scene.describe()


def test_bundled_scenes_load_without_warnings(caplog: pytest.LogCaptureFixture) -> None:
    for name in (*gp.scenes(), *gp.mobile_scenes()):
        gp.load_scene(name)
    assert not _warnings(caplog)
