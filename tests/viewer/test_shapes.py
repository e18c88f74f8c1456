"""Shapes of bodies: the triangles of their geoms."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.viewer.poses import pose_of, poses_along, quaternion_of
from graceful_plan.viewer.shapes import geom_triangles, parts

_FACETS = 0.06
"""Share of a volume that round shapes lose by their facets."""

_GEOMS = """
<mujoco>
  <asset>
    <mesh name="wedge" vertex="0 0 0  .1 0 0  0 .2 0  0 0 .3"/>
    <hfield name="hill" nrow="3" ncol="4" size="1 2 .5 .1"/>
  </asset>
  <worldbody>
    <geom type="box" size=".1 .2 .3" pos="1 2 3" euler="10 20 30"/>
    <geom type="sphere" size=".2" pos="1 0 0"/>
    <geom type="cylinder" size=".1 .3" euler="0 90 0"/>
    <geom type="capsule" size=".1 .3"/>
    <geom type="ellipsoid" size=".1 .2 .3"/>
    <geom type="mesh" mesh="wedge" mass="1" pos=".5 0 0"/>
    <geom type="plane" size="0 0 .1"/>
    <geom type="hfield" hfield="hill"/>
  </worldbody>
</mujoco>
"""


@pytest.fixture(scope="module")
def model():
    return mujoco.MjModel.from_xml_string(_GEOMS)


def volume(vertices, faces):
    """Return the signed volume enclosed by triangles; positive if they face outwards."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.sum(np.einsum("ij,ij->i", a, np.cross(b, c))) / 6.0)


@pytest.mark.parametrize(
    ("geom", "expected"),
    [
        (0, 8 * 0.1 * 0.2 * 0.3),
        (1, 4 / 3 * np.pi * 0.2**3),
        (2, np.pi * 0.1**2 * 0.6),
        (3, np.pi * 0.1**2 * 0.6 + 4 / 3 * np.pi * 0.1**3),
        (4, 4 / 3 * np.pi * 0.1 * 0.2 * 0.3),
        (5, 0.1 * 0.2 * 0.3 / 6),
    ],
)
def test_solids_look_outwards_and_have_their_volume(model, geom, expected):
    vertices, faces = geom_triangles(model, geom)
    middle = vertices - vertices.mean(axis=0)
    assert volume(middle, faces) == pytest.approx(expected, rel=_FACETS)
    assert volume(middle, faces) <= expected * (1.0 + 1e-6)
    assert faces.max() < len(vertices) and faces.min() == 0


def test_solids_are_where_their_geoms_are(model):
    vertices, _ = geom_triangles(model, 0)
    np.testing.assert_allclose(vertices.mean(axis=0), [1.0, 2.0, 3.0], atol=1e-9)
    reach = np.abs((vertices - [1.0, 2.0, 3.0]) @ mujoco_rotation(model, 0))
    np.testing.assert_allclose(reach, np.tile([0.1, 0.2, 0.3], (len(vertices), 1)), atol=1e-9)


def mujoco_rotation(model, geom):
    R = np.empty(9)
    mujoco.mju_quat2Mat(R, model.geom_quat[geom])
    return R.reshape(3, 3)


def test_planes_without_a_size_and_heights_are_drawn(model):
    plane, _ = geom_triangles(model, 6)
    assert np.ptp(plane[:, 0]) > 5.0 and np.ptp(plane[:, 2]) == 0.0
    hill, faces = geom_triangles(model, 7)
    assert len(hill) == 12 and len(faces) == 2 * 2 * 3
    np.testing.assert_allclose([np.ptp(hill[:, 0]), np.ptp(hill[:, 1])], [2.0, 4.0])


@pytest.mark.parametrize("name", [*gp.scenes(), *gp.mobile_scenes()])
def test_every_bundled_scene_can_be_drawn(name):
    scene = gp.load_scene(name)
    drawn = parts(scene)
    assert {part.entity for part in drawn} >= {n for n, e in scene.entities.items() if e.geoms and seen(scene, e)}
    for part in drawn:
        for mesh in part.meshes:
            assert np.isfinite(mesh.vertices).all() and mesh.faces.max() < len(mesh.vertices)
            assert 0.0 < mesh.opacity <= 1.0 and all(0 <= x <= 255 for x in mesh.colour)


def seen(scene, entity):
    return any(scene.model.geom_group[g] < 3 and scene.model.geom_rgba[g, 3] > 0.0 for g in entity.geoms)


def test_contents_and_spaces_to_keep_out_of_are_not_drawn():
    scene = gp.load_scene("apartment")
    hidden = [g for g in range(scene.model.ngeom) if scene.model.geom_group[g] >= 3]
    assert hidden
    bodies = {part.body for part in parts(scene)}
    alone = [b for b in set(scene.model.geom_bodyid[hidden]) if scene.model.body_geomnum[b] == 1]
    assert not bodies & set(alone)


def test_poses_are_those_of_mujoco_and_of_predictions():
    task = next(iter(gp.load_scene("hallway").tasks.values()))
    scene, drawn = task.scene, parts(task.scene)
    q = np.stack([task.start, task.start])
    poses, X_WT = poses_along(scene, drawn, q, np.array([0.0, 2.0]))
    data = scene.data_at(task.start)
    for k, part in enumerate(drawn):
        if part.body >= 0:
            np.testing.assert_allclose(poses.position[0, k], data.xpos[part.body], atol=1e-9)
        else:
            np.testing.assert_allclose(poses.position[1, k], scene.moving[part.name].at(2.0).position, atol=1e-12)
    assert any(part.body < 0 for part in drawn)
    np.testing.assert_allclose(X_WT[0, :3, 3], data.site(scene.tool).xpos, atol=1e-9)


def test_poses_and_quaternions_are_inverse():
    X = pose_of(np.array([1.0, 2.0, 3.0]), np.array([2.0, 0.0, 0.0, 2.0]))
    np.testing.assert_allclose(X, [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]], atol=1e-12)
    np.testing.assert_allclose(quaternion_of(X[:3, :3]), np.array([1, 0, 0, 1]) / np.sqrt(2), atol=1e-12)
