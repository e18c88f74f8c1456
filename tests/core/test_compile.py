"""Compile a scene to tables: covered geoms, ignored pairs, refused features."""

import mujoco
import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import CAPACITY
from graceful_plan.exceptions import UnsupportedError
from graceful_plan.judge.exact import exactly_free
from sizes import first_quick


@pytest.fixture(scope="module")
def scene():
    return gp.load_scene("kitchen_counter").tasks["move_oil"].scene


def _surface(model, geom, rng, n=300):
    """Points of a primitive in its frame, most of them on its surface."""
    kind, size = model.geom_type[geom], model.geom_size[geom]
    unit = rng.normal(size=(n, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return unit * size[0] + np.outer(rng.uniform(-1, 1, n), [0, 0, size[1]])
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return unit * size[0]
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        flat = unit[:, :2] / np.linalg.norm(unit[:, :2], axis=1, keepdims=True)
        return np.column_stack([flat * size[0], rng.choice([-1.0, 1.0, 0.3], n) * size[1]])
    assert kind == mujoco.mjtGeom.mjGEOM_BOX
    points = rng.uniform(-1, 1, (n, 3))
    axis = rng.integers(3, size=n)
    points[np.arange(n), axis] = np.sign(points[np.arange(n), axis])
    return points * size


def test_spheres_cover_colliding_geoms_and_exceed_them_by_less_than_a_centimetre(scene):
    compiled, model, rng = compile_scene(scene), scene.model, np.random.default_rng(0)
    robot = compiled.robot
    assert 0.0 < robot.protrusion < 0.01
    q = rng.uniform(*scene.limits.position.T)
    data, X_WL = scene.data_at(q), compiled.kernels.link_poses(q)
    R, p = X_WL[robot.sphere_link, :3, :3], X_WL[robot.sphere_link, :3, 3]
    centres = np.einsum("sij,sj->si", R, robot.sphere[:, :3]) + p
    moving = sorted(set(scene.collision_pairs()[:, 0].tolist()))
    for geom in moving:
        points = _surface(model, geom, rng) @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
        gaps = np.linalg.norm(points[:, None] - centres, axis=-1) - robot.sphere[:, 3]
        assert gaps.min(axis=1).max() <= 1e-9, model.geom(geom).name


def test_bounding_spheres_bound(scene):
    robot = compile_scene(scene).robot
    bound = robot.bound[robot.sphere_link]
    reach = np.linalg.norm(robot.sphere[:, :3] - bound[:, :3], axis=1) + robot.sphere[:, 3]
    assert np.all(reach <= bound[:, 3] + 1e-9)


def test_a_scene_is_compiled_once(scene):
    assert compile_scene(scene) is compile_scene(scene)


def test_allowed_contacts_are_ignored(scene):
    """The gripper overlaps the carried object in every configuration; this is not a collision."""
    free_somewhere = compile_scene(scene).kernels.free(
        np.random.default_rng(1).uniform(*scene.limits.position.T, (200, 7))
    )
    assert free_somewhere.any()


def test_ignored_obstacles_are_those_without_a_pair(scene):
    compiled = compile_scene(scene)
    world, robot = compiled.world, compiled.robot
    base_geoms = {
        g for g in range(scene.model.ngeom) if scene.model.body(scene.model.geom_bodyid[g]).name == "panda/link0"
    }
    assert not base_geoms & set(world.geom.tolist()), "the robot's own base is no obstacle but part of self-collision"
    assert np.all(world.ignores >> len(robot.parent) == 0)


def test_severities_follow_the_scene(scene):
    impact_tables = compile_scene(scene).impact_tables
    for r, component in enumerate(scene.components):
        for e, entity in enumerate(scene.entities.values()):
            assert impact_tables.severity[r, e] == entity.severity[component]


def test_a_carried_shape_that_cannot_be_covered_is_named():
    text = """<mujoco><compiler angle="radian" autolimits="true"/>
    <custom><numeric name="r/velocity_limit" data="1"/><numeric name="r/acceleration_limit" data="1"/></custom>
    <worldbody><geom name="wall" type="box" size="0.1 0.1 0.1"/>
      <body name="r/a" pos="0 0 1"><joint name="j" range="-1 1"/><geom name="disc" type="hfield" hfield="h"/>
        <site name="t"/></body>
    </worldbody><asset><hfield name="h" nrow="2" ncol="2" size="1 1 1 1" elevation="0 0 0 0"/></asset></mujoco>"""
    with pytest.raises(UnsupportedError, match=r"hfield|HFIELD"):
        compile_scene(gp.Scene.from_mjcf(text, robot="r/", tool="t"))


def test_a_scene_without_anything_around_compiles():
    text = """<mujoco><compiler angle="radian" autolimits="true"/>
    <custom><numeric name="r/velocity_limit" data="1"/><numeric name="r/acceleration_limit" data="1"/></custom>
    <worldbody><body name="r/a"><joint name="j" range="-1 1"/><geom size="0.1"/><site name="t"/>
      </body></worldbody></mujoco>"""
    scene = gp.Scene.from_mjcf(text, robot="r/", tool="t")
    result = gp.plan([-0.5], [0.5], scene, iterations=50)
    assert result.status is gp.PlanStatus.SOLVED
    assert result.cost.motion == pytest.approx(1.0)


def test_fingers_that_never_move_apart_do_not_block_everything():
    text = """<mujoco><compiler angle="radian" autolimits="true"/>
    <custom><numeric name="r/velocity_limit" data="1"/><numeric name="r/acceleration_limit" data="1"/></custom>
    <worldbody><body name="r/a" pos="0 0 1"><joint name="j" range="-1 1"/>
      <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
      <body name="r/b" pos="0.021 0 0"><geom type="box" size="0.02 0.02 0.02"/></body>
      <body name="r/c" pos="-0.021 0 0"><geom type="box" size="0.02 0.02 0.02"/></body><site name="t"/></body>
    </worldbody></mujoco>"""
    result = gp.plan([-0.5], [0.5], gp.Scene.from_mjcf(text, robot="r/", tool="t"), iterations=50)
    assert result.status is gp.PlanStatus.SOLVED, result.detail


def door(size: float, more: str = "") -> gp.Scene:
    text = f"""<mujoco><compiler angle="radian" autolimits="true"/>
    <custom><numeric name="r/velocity_limit" data="1"/><numeric name="r/acceleration_limit" data="1"/></custom>
    <worldbody><geom name="wall" type="box" size="0.1 0.1 0.1" pos="9 0 0"/>
      <body name="r/a" pos="0 0 1"><joint name="j" range="-1 1"/>
        <geom name="door" type="box" size="{size} 0.02 {size}"/>{more}<site name="t"/></body>
    </worldbody></mujoco>"""
    return gp.Scene.from_mjcf(text, robot="r/", tool="t")


def test_a_robot_too_large_for_the_kernels_is_refused_by_name():
    with pytest.raises(UnsupportedError, match="'door'"):
        compile_scene(door(5.0, "".join(f'<geom type="sphere" size="0.01" pos="{9 + k} 0 0"/>' for k in range(2100))))


def test_a_robot_that_is_large_gets_large_spheres():
    robot = compile_scene(door(50.0)).robot
    assert len(robot.sphere) <= CAPACITY["spheres"] and 0.1 < robot.protrusion < 3.0


def test_spheres_stick_out_farther_where_there_would_be_too_many():
    scene = door(1.0)
    compiled = compile_scene(scene)
    robot, X_WL = compiled.robot, compiled.kernels.link_poses([0.0])
    assert 0.01 < robot.protrusion < 0.03 and len(robot.sphere) <= CAPACITY["spheres"]
    X = X_WL[robot.sphere_link]
    centres = np.einsum("sij,sj->si", X[:, :3, :3], robot.sphere[:, :3]) + X[:, :3, 3]
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (4000, 3)) * [1.0, 0.02, 1.0]
    points[:8] = [[x, 0.02 * y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)]
    outside = np.linalg.norm((points + [0.0, 0.0, 1.0])[:, None] - centres, axis=-1) - robot.sphere[:, 3]
    assert outside.min(axis=1).max() <= 1e-6
    assert compile_scene(door(0.3)).robot.protrusion < 0.01


def _crane(scale: float) -> gp.Scene:
    """Return an arm of ten boxes and cylinders, about a metre long."""
    body, end = "", ""
    for k in range(10):
        kind, sizes = ("box", [0.06, 0.06, 0.1]) if k % 2 else ("cylinder", [0.06, 0.1])
        size = " ".join(str(scale * one) for one in sizes)
        geom = f'<geom type="{kind}" size="{size}" pos="0 0 {0.14 * scale}"/>'
        axis = "1 0 0" if k % 2 else "0 1 0"
        body += f'<body name="r/{k}" pos="0 0 {0.28 * scale}"><joint axis="{axis}" range="-1 1"/>{geom}'
        end += "</body>"
    text = f"""<mujoco><worldbody><geom name="wall" type="box" size="1 1 1" pos="{20 * scale} 0 0"/>
      <body name="r/base">{body}<site name="tip"/>{end}</body></worldbody></mujoco>"""
    given = {"velocity": [1.0] * 10, "acceleration": [1.0] * 10}
    return gp.Scene.from_mjcf(text, robot="r/", tool="tip", **given)


@pytest.mark.parametrize("scale", first_quick([30.0, 10.0, 3.0]))
def test_a_robot_of_any_size_fits_into_the_kernels(scale):
    usual, large = compile_scene(_crane(1.0)).robot, compile_scene(_crane(scale)).robot
    assert usual.protrusion < 0.01 and len(large.sphere) <= CAPACITY["spheres"]
    assert large.protrusion <= 3.0 * max(0.01, 0.01 * scale)
    scene = _crane(scale)
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (300, 10))
    cautious = compile_scene(scene).kernels.clearance(q) > 0.0
    assert not (cautious & ~exactly_free(q, scene)).any()
