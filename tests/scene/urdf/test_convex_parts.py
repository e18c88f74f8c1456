"""Meshes that differ from their hulls are decomposed: a concave corner is free, and the surface is covered."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.exceptions import SceneError, UnknownNameError, UnsupportedError
from graceful_plan.scene import scene as scene_module
from graceful_plan.scene.urdf.convex_parts import convex_parts
from graceful_plan.scene.urdf.meshes import mesh_content, mesh_triangles, obj_content
from graceful_plan.scene.urdf.reading import UrdfRobot, read_urdf

Array = np.ndarray

URDF = """<robot name="crane">
  <link name="post"><collision><geometry><box size="0.04 0.04 0.04"/></geometry></collision></link>
  <link name="angle"><collision name="angle"><origin xyz="0 0 0.1"/><geometry><mesh filename="angle.obj"/></geometry>
    </collision></link>
  <joint name="turn" type="revolute"><parent link="post"/><child link="angle"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="10" velocity="1"/></joint>
</robot>"""


@pytest.fixture(autouse=True)
def _nothing_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GRACEFUL_PLAN_NO_CACHE", "1")


def box(low: list[float], high: list[float]) -> Array:
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    faces = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6],
             [0, 6, 4], [1, 5, 7], [1, 7, 3]]  # fmt: skip
    return (np.array(low) + corners * (np.array(high) - np.array(low)))[faces]


def angle() -> Array:
    """Return two legs of 0.4 m, 4 cm thick, as one solid."""
    outline = np.array([[0.0, 0.0], [0.4, 0.0], [0.4, 0.04], [0.04, 0.04], [0.04, 0.4], [0.0, 0.4]])
    low, high = (np.column_stack([outline, np.full(6, z)]) for z in (-0.02, 0.02))
    top = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]]
    sides = [t for a, b in zip(range(6), [1, 2, 3, 4, 5, 0], strict=True)
             for t in ((low[a], low[b], high[b]), (low[a], high[b], high[a]))]  # fmt: skip
    return np.array([*(high[t] for t in top), *(low[t[::-1]] for t in top), *sides])


def outside(parts: list[Array], points: Array) -> Array:
    """Return the distance of points outside the hulls of parts."""
    spatial = pytest.importorskip("scipy.spatial")
    hulls = [spatial.ConvexHull(part).equations for part in parts]
    return np.min([(points @ planes[:, :3].T + planes[:, 3]).max(axis=1) for planes in hulls], axis=0)


def test_an_angle_has_parts_that_leave_its_bend_free() -> None:
    pytest.importorskip("coacd")
    triangles = angle()
    parts = convex_parts(triangles, "angle", needed=True)
    assert 2 <= len(parts) <= 4
    rng = np.random.default_rng(1)
    weights = rng.dirichlet(np.ones(3), size=(len(triangles), 200))
    on_surface = np.einsum("tnk,tki->tni", weights, triangles).reshape(-1, 3)
    assert outside(parts, on_surface).max() < 1e-3
    assert outside(parts, triangles.reshape(-1, 3)).max() < 2e-6
    assert outside(parts, np.array([[0.2, 0.2, 0.0], [0.1, 0.3, 0.0]])).min() > 0.05


def test_meshes_equal_to_their_hulls_stay_whole() -> None:
    assert convex_parts(box([0, 0, 0], [0.4, 0.1, 0.1]), "box", needed=True) == []
    assert convex_parts(np.zeros((2, 3, 3)), "point", needed=True) == []


def test_a_robot_whose_links_are_apart_is_not_read_again_to_be_divided(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[bool | None] = []

    def read(*given: Any, decompose: bool | None) -> UrdfRobot:
        asked.append(decompose)
        return read_urdf(*given, decompose=decompose)

    monkeypatch.setattr(scene_module, "read_urdf", read)
    (tmp_path / "angle.obj").write_bytes(obj_content(angle()))
    file = tmp_path / "crane.urdf"
    file.write_text(URDF)
    gp.Scene.from_urdf(file, tool="angle", acceleration=2.0)
    assert asked == [False]


def test_a_robot_passes_through_a_concave_corner(tmp_path: Path) -> None:
    pytest.importorskip("coacd")
    (tmp_path / "angle.obj").write_bytes(obj_content(angle()))
    file = tmp_path / "crane.urdf"
    file.write_text(URDF)
    ball = '<geom type="sphere" size="0.02" pos="0.15 0.15 0.1"/>'
    world = f"<mujoco><worldbody>{ball}</worldbody></mujoco>"
    whole = gp.Scene.from_urdf(file, tool="angle", acceleration=2.0, world=world, decompose=False)
    divided = gp.Scene.from_urdf(file, tool="angle", acceleration=2.0, world=world, decompose=True)
    assert gp.clearance([0.0], whole) < 0.0 < gp.clearance([0.0], divided)
    meshes = [g for g in range(divided.model.ngeom) if divided.model.geom_type[g] == mujoco.mjtGeom.mjGEOM_MESH]
    assert len(meshes) >= 2 and len({divided.model.geom_bodyid[g] for g in meshes}) == 1
    assert gp.clearance([0.7], divided) < 0.0  # a leg is in the way


def test_named_links_are_divided_closely(tmp_path: Path) -> None:
    pytest.importorskip("coacd")
    (tmp_path / "angle.obj").write_bytes(obj_content(0.1 * angle()))  # the hull protrudes by less than 2.5 cm
    file = tmp_path / "crane.urdf"
    file.write_text(URDF)

    def meshes(decompose: bool | list[str]) -> int:
        model = gp.Scene.from_urdf(file, tool="angle", acceleration=2.0, decompose=decompose).model
        return int((model.geom_type == mujoco.mjtGeom.mjGEOM_MESH).sum())

    assert meshes(True) == 1
    assert meshes(["angle"]) >= 2
    with pytest.raises(UnknownNameError, match="'jaw'"):
        gp.Scene.from_urdf(file, tool="angle", acceleration=2.0, decompose=["jaw"])


def test_without_coacd_the_error_names_it(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.setitem(sys.modules, "coacd", None)
    assert convex_parts(angle(), "angle.obj", needed=False) == []
    assert "angle.obj" in caplog.text and ".[urdf]" in caplog.text
    with pytest.raises(UnsupportedError, match=r"angle\.obj.* cm.*\.\[urdf\]"):
        convex_parts(angle(), "angle.obj", needed=True)


def test_parts_are_kept(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    pytest.importorskip("coacd")
    monkeypatch.delenv("GRACEFUL_PLAN_NO_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    first = convex_parts(angle(), "angle", needed=True)
    monkeypatch.setitem(sys.modules, "coacd", None)
    again = convex_parts(angle(), "angle", needed=True)
    assert len(first) == len(again) and all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))


def test_meshes_are_read_as_mujoco_reads_them(tmp_path: Path) -> None:
    triangles = angle()
    file = tmp_path / "a.obj"
    file.write_bytes(obj_content(triangles))
    np.testing.assert_allclose(mesh_triangles(*mesh_content(file), "a"), triangles, atol=1e-8)
    quads = b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1/1 2/2 3/3 4/4\nf -4 -3 -2\n"
    assert mesh_triangles(quads, ".obj", "a").shape == (3, 3, 3)
    for broken in (b"v 0 0\nf 1 2 3\n", b"", b"f 1 2 3\n", b"v 0 0 nan\nv 0 0 1\nv 0 1 0\nf 1 2 3\n"):
        with pytest.raises(SceneError, match="no triangles"):
            mesh_triangles(broken, ".obj", "a")
    with pytest.raises(SceneError, match="no triangles"):
        mesh_triangles(b"0" * 100, ".stl", "a")
