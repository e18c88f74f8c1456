"""Concave meshes of the surroundings count as convex parts: a bin is open, its walls are walls."""

from __future__ import annotations

import sys
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.exceptions import SceneError, SettingError, UnsupportedError

Array = np.ndarray

_FACES = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4),
          (1, 5, 7), (1, 7, 3)]  # fmt: skip
_BOXES = [([-0.2, -0.2, 0.0], [0.2, 0.2, 0.02]), ([-0.2, -0.2, 0.0], [-0.18, 0.2, 0.3]),
          ([0.18, -0.2, 0.0], [0.2, 0.2, 0.3]), ([-0.2, -0.2, 0.0], [0.2, -0.18, 0.3]),
          ([-0.2, 0.18, 0.0], [0.2, 0.2, 0.3])]  # fmt: skip
"""Bottom and walls of a bin."""


def _corners(low: list[float], high: list[float]) -> Array:
    unit = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    return np.array(low) + unit * (np.array(high) - np.array(low))


_VERTICES = np.concatenate([_corners(low, high) for low, high in _BOXES])
_TRIANGLES = np.concatenate([np.array(_FACES) + 8 * k for k in range(len(_BOXES))])
_WORLD = f"""<mujoco><asset><mesh name="bin" scale="1 1 1" vertex="{" ".join(map(str, _VERTICES.ravel()))}"
  face="{" ".join(map(str, _TRIANGLES.ravel()))}"/></asset><worldbody>
  <body name="bin" pos="0 0 0" euler="0 0 20"><geom name="bin" type="mesh" mesh="bin" mass="2" friction=".3"/></body>
  <body name="second" pos="3 0 0"><geom type="mesh" mesh="bin"/></body>
  <body name="r/z" pos="0 0 1"><joint name="r/z" type="slide" axis="0 0 -1" range="0 1"/>
    <geom type="sphere" size=".01"/>
    <body name="r/x"><joint name="r/x" type="slide" axis="1 0 0" range="-.5 .5"/>
      <geom name="rod" type="capsule" fromto="0 0 .1 0 0 .5" size=".03"/><site name="r/tip"/></body></body>
  {{more}}
</worldbody></mujoco>"""
INSIDE, ABOVE, IN_THE_WALL = [0.9, 0.0], [0.2, 0.0], [0.9, 0.2]


@pytest.fixture(autouse=True)
def _nothing_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GRACEFUL_PLAN_NO_CACHE", "1")


@pytest.fixture
def divider(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace the library by one that knows the parts of the bin, up to the pose of the mesh's own frame."""

    def run_coacd(mesh: Any, **_: object) -> list[tuple[Array, None]]:
        corners, faces = mesh
        triangles = corners[faces]
        return [(triangles[12 * k : 12 * k + 12].reshape(-1, 3), None) for k in range(len(_BOXES))]

    fake = SimpleNamespace(set_log_level=lambda _: None, Mesh=lambda *given: given, run_coacd=run_coacd)
    monkeypatch.setitem(sys.modules, "coacd", fake)


def _scene(convex: str | None = None, more: str = "", **changes: object) -> gp.Scene:
    given = {"robot": "r/", "tool": "r/tip", "velocity": [1.0] * 2, "acceleration": [5.0] * 2} | changes
    return gp.Scene.from_mjcf(_WORLD.format(more=more), convex=convex, **given)  # type: ignore[arg-type]


@pytest.mark.usefixtures("divider")
@pytest.mark.parametrize("convex", [None, "parts"])
def test_a_bin_is_open_and_its_walls_are_walls(convex: str | None) -> None:
    scene, hull = _scene(convex), _scene("hull")
    assert gp.clearance(INSIDE, scene) > 0.05 and gp.clearance(INSIDE, hull) < 0.0
    for one in (scene, hull):
        assert gp.clearance(ABOVE, one) > 0.0 > gp.clearance(IN_THE_WALL, one)
    assert gp.plan(ABOVE, INSIDE, scene, w=0.0, iterations=50).status is gp.PlanStatus.SOLVED
    assert gp.plan(ABOVE, INSIDE, hull, w=0.0, iterations=50).status is gp.PlanStatus.INVALID_GOAL


@pytest.mark.usefixtures("divider")
def test_the_mesh_keeps_its_mass_and_its_parts_its_name() -> None:
    scene, hull = _scene("parts", entities={"bin": "table"}), _scene("hull", entities={"bin": "table"})
    for field in ("body_mass", "body_inertia", "body_ipos"):
        np.testing.assert_allclose(getattr(scene.model, field), getattr(hull.model, field), atol=1e-9)
    assert len(scene.geoms_named("bin")) == len(_BOXES) == len(scene.entities["bin"].geoms)
    assert all(scene.model.geom_friction[g, 0] == 0.3 for g in scene.geoms_named("bin"))
    assert not scene.model.geom("bin").contype[0]
    free = scene.with_allowed_contacts(gp.AllowedContact("bin", "rod"))
    assert gp.clearance(IN_THE_WALL, free) > 0.0
    assert gp.clearance(INSIDE, scene.edit(move={"bin": [0.3, 0.0, 0.0]})) < 0.05


@pytest.mark.usefixtures("divider")
def test_geoms_whose_contacts_are_listed_in_pairs_stay_whole(caplog: pytest.LogCaptureFixture) -> None:
    text = _WORLD.format(more="").replace("</mujoco>", '<contact><pair geom1="bin" geom2="rod"/></contact></mujoco>')
    given = {"robot": "r/", "tool": "r/tip", "velocity": [1.0] * 2, "acceleration": [5.0] * 2}
    scene = gp.Scene.from_mjcf(text, **given)  # type: ignore[arg-type]
    assert len(scene.geoms_named("bin")) == 1 and len(scene.geoms_named("second")) == len(_BOXES)
    assert "'bin' counts as its convex hull" in caplog.text


def test_without_the_library_hulls_are_named(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.setitem(sys.modules, "coacd", None)
    scene = _scene()
    assert len(scene.geoms_named("bin")) == 1 and "hull of mesh 'bin'" in caplog.text
    caplog.clear()
    _scene("hull")
    assert not caplog.text
    with pytest.raises(UnsupportedError, match="mesh 'bin' of 'bin'"):
        _scene("parts")
    with pytest.raises(SettingError, match="convex = 'none'"):
        _scene("none")


def test_messages_say_that_a_hull_is_in_the_way() -> None:
    result = gp.plan(ABOVE, INSIDE, _scene("hull"), w=0.0, iterations=50)
    assert "the hull of bin" in result.detail and "AllowedContact('rod', 'bin')" in result.detail


@pytest.mark.usefixtures("divider")
def test_scene_files_choose(tmp_path: Any) -> None:
    (tmp_path / "world.xml").write_text(_WORLD.format(more=""))
    head = "world: world.xml\nrobot: {prefix: r/, velocity: [1, 1], acceleration: [5, 5]}\ntool: r/tip\n"
    file = tmp_path / "one.yaml"
    for choice, count in (("hull", 1), ("parts", len(_BOXES))):
        file.write_text(f"version: 1\n{head}convex: {choice}\n")
        assert len(gp.load_scene(file).geoms_named("bin")) == count
    file.write_text(f"version: 1\n{head}convex: boxes\n")
    with pytest.raises(SceneError, match="convex"):
        gp.load_scene(file)


def test_an_angle_is_divided_by_the_library_itself() -> None:
    pytest.importorskip("coacd")
    outline = np.array([[0.0, 0.0], [0.4, 0.0], [0.4, 0.04], [0.04, 0.04], [0.04, 0.4], [0.0, 0.4]])
    vertices = np.concatenate([np.column_stack([outline, np.full(6, z)]) for z in (-0.02, 0.02)])
    caps = [(6, 7, 8), (6, 8, 9), (6, 9, 10), (6, 10, 11), (2, 1, 0), (3, 2, 0), (4, 3, 0), (5, 4, 0)]
    sides = [t for a in range(6) for b in [(a + 1) % 6] for t in ((a, b, b + 6), (a, b + 6, a + 6))]
    mesh = f"""<mesh name="angle" vertex="{" ".join(map(str, vertices.ravel()))}"
      face="{" ".join(map(str, np.array(caps + sides).ravel()))}"/>"""
    text = f"""<mujoco><asset>{mesh}</asset><worldbody>
      <body name="angle"><geom name="angle" type="mesh" mesh="angle"/></body>
      <body name="r/x" pos=".2 .2 0"><joint name="r/x" type="slide" axis="1 1 0" range="-.4 .1"/>
        <geom type="sphere" size=".02"/><site name="r/tip"/></body></worldbody></mujoco>"""
    given: dict[str, Any] = {"robot": "r/", "tool": "r/tip", "velocity": [1.0], "acceleration": [5.0]}
    hull, parts = (gp.Scene.from_mjcf(text, convex=convex, **given) for convex in ("hull", "parts"))
    assert gp.clearance([-0.1], hull) < 0.0 < gp.clearance([-0.1], parts)
    assert gp.clearance([-0.27], parts) < 0.0
    assert mujoco.mj_id2name(parts.model, mujoco.mjtObj.mjOBJ_GEOM, parts.geoms_named("angle")[0]) == "angle#0"
