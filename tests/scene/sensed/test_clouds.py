"""Point clouds, depth images and height maps as obstacles: occupied space, and motions that avoid it."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from jaxtyping import TypeCheckError

import graceful_plan as gp
from graceful_plan.core.compile import compile_scene
from graceful_plan.exceptions import NonFiniteError, SceneError, SettingError, ShapeError
from graceful_plan.scene.sensed.boxes import joined

CELLS = npst.arrays(np.int64, st.tuples(st.integers(1, 60), st.just(3)), elements=st.integers(0, 5))


@pytest.fixture(scope="module")
def scene() -> gp.Scene:
    return gp.load_scene("tabletop_l1")


@given(CELLS)
@settings(max_examples=25, deadline=None)
def test_boxes_are_the_full_cells_and_nothing_else(cells: np.ndarray) -> None:
    full = np.unique(cells, axis=0)
    count = np.zeros((6, 6, 6), dtype=int)
    for a, b in zip(*joined(full), strict=True):
        count[a[0] : b[0], a[1] : b[1], a[2] : b[2]] += 1
    wanted = np.zeros_like(count)
    wanted[tuple(full.T)] = 1
    np.testing.assert_array_equal(count, wanted)


def test_a_full_block_is_one_box() -> None:
    block = np.stack(np.meshgrid(*map(np.arange, (4, 3, 5)), indexing="ij"), axis=-1).reshape(-1, 3)
    first, last = joined(block)
    np.testing.assert_array_equal(first, [[0, 0, 0]])
    np.testing.assert_array_equal(last, [[4, 3, 5]])


@pytest.mark.parametrize("inflation", [0.0, 0.03])
def test_every_point_is_inside_and_every_cell_has_one(inflation: float) -> None:
    rng = np.random.default_rng(0)
    points = rng.normal(scale=0.2, size=(500, 3))
    lower, upper = gp.PointCloud(name="seen", points=points, resolution=0.05, inflation=inflation).boxes
    inside = np.all((points[:, None] >= lower + inflation) & (points[:, None] <= upper - inflation), axis=2)
    assert inside.any(axis=1).all()
    # Every box is near a point: within the box, or within the gap between two.
    middle = 0.5 * (lower + upper)
    away = np.abs(points[:, None] - middle) - 0.5 * (upper - lower) + inflation
    assert np.all(away.max(axis=2).min(axis=0) <= 2 * 0.05)


def test_gaps_of_two_cells_are_closed_and_wider_ones_stay() -> None:
    x = np.array([0.0, 1.0, 4.0, 5.0, 9.0])
    points = np.column_stack([x, 0.0 * x, 0.0 * x]) * 0.1 + 0.05
    lower, upper = gp.PointCloud(name="seen", points=points, resolution=0.1).boxes
    np.testing.assert_allclose(np.sort(lower[:, 0]), [0.0, 0.9])
    np.testing.assert_allclose(np.sort(upper[:, 0]), [0.6, 1.0])
    np.testing.assert_allclose(upper[:, 1:] - lower[:, 1:], 0.1)


def test_noise_does_not_make_dust_of_a_table() -> None:
    rng = np.random.default_rng(0)
    top = np.column_stack([rng.uniform(0.0, 1.0, (40_000, 2)), rng.normal(scale=0.002, size=40_000)])
    assert len(gp.PointCloud(name="seen", points=top, resolution=0.02).boxes[0]) < 20


def test_points_follow_their_frame_and_invalid_ones_are_dropped() -> None:
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], [1.0, 2.0, 3.0]
    points = [[0.105, 0.005, 0.005], [np.nan, 0.0, 0.0], [0.0, np.inf, 1.0]]
    lower, upper = gp.PointCloud(name="seen", points=points, resolution=0.01, pose=X).boxes
    np.testing.assert_allclose(lower, [[0.99, 2.1, 3.0]], atol=1e-9)
    np.testing.assert_allclose(upper, [[1.0, 2.11, 3.01]], atol=1e-9)
    for nothing in (np.zeros((0, 3)), [[np.nan] * 3]):
        assert len(gp.PointCloud(name="seen", points=nothing).boxes[0]) == 0


def test_a_depth_image_equals_a_pinhole_camera() -> None:
    """Return a wall half a metre before a camera that looks along x, through a pinhole with a given opening."""
    X_WC = np.eye(4)
    X_WC[:3, :3] = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # x right is -y, y down is -z
    K = [[100.0, 0.0, 49.5], [0.0, 100.0, 24.5], [0.0, 0.0, 1.0]]
    depth = np.full((50, 100), 0.505)
    depth[:, :50] = 0.0  # no points in the left half
    lower, upper = gp.PointCloud.from_depth("seen", depth, K, X_WC, resolution=0.01).boxes
    np.testing.assert_allclose([lower[:, 0].min(), upper[:, 0].max()], [0.5, 0.51], atol=1e-9)
    np.testing.assert_allclose([lower[:, 1].min(), upper[:, 1].max()], [-0.505 * 0.495, 0.0], atol=0.0101)
    np.testing.assert_allclose([lower[:, 2].min(), upper[:, 2].max()], [-0.505 * 0.245, 0.505 * 0.245], atol=0.0101)
    assert len(gp.PointCloud.from_depth("seen", depth, K, X_WC, far=0.4).boxes[0]) == 0


@given(npst.arrays(float, st.tuples(st.integers(1, 6), st.integers(1, 6)), elements=st.floats(-0.2, 1.0)))
def test_height_maps_are_full_below(heights: np.ndarray) -> None:
    lower, upper = gp.HeightMap(name="map", heights=heights, cell=0.1, corner=(1.0, 2.0), step=0.01).boxes
    x, y = np.indices(heights.shape) * 0.1 + 0.05 + np.array([1.0, 2.0])[:, None, None]
    over = (x[..., None] > lower[:, 0]) & (x[..., None] < upper[:, 0])
    over &= (y[..., None] > lower[:, 1]) & (y[..., None] < upper[:, 1])
    assert (over.sum(axis=2) == (heights > 0.0)).all()
    top = np.where(over, upper[:, 2], 0.0).max(axis=2, initial=0.0)
    assert np.all(top >= np.maximum(heights, 0.0) - 1e-9) and np.all(top <= np.maximum(heights, 0.0) + 0.01)


def test_motions_keep_away_from_every_point(scene: gp.Scene) -> None:
    """Verified in a scene that has each point as a ball, by exact geometry."""
    task = scene.tasks["green_to_blue"]
    free = gp.plan(task.start, task.goal, task.scene, w=0.0, iterations=200).unwrap()
    place = gp.StateBatch(task.scene, free.at([0.5 * free.duration]).q).tool_poses[0, :3, 3]
    y, z = np.meshgrid(np.arange(-0.1, 0.1, 0.02), place[2] + np.arange(-0.1, 0.15, 0.02))
    points = np.column_stack([np.full(y.size, place[0]), place[1] + y.ravel(), z.ravel()])
    seen = task.scene.edit(add=[gp.PointCloud(name="seen", points=points)])
    balls = [gp.StaticBody(name=f"p{k}", kind="sphere", size=0.001, pose=p) for k, p in enumerate(points)]
    exact = task.scene.edit(add=balls)
    assert not gp.verify(free, exact).passed
    result = gp.plan(task.start, task.goal, seen, w=0.0, iterations=800)
    assert result.status is gp.PlanStatus.SOLVED, result.detail
    assert gp.verify(result.trajectory, exact).passed


def test_a_cloud_is_an_entity_like_the_thing_that_was_seen(scene: gp.Scene) -> None:
    """A tray near the path, as a box and as points on it: drops hit both with about equal probability."""
    task, half, place = scene.tasks["green_to_blue"], np.array([0.12, 0.15, 0.02]), np.array([0.45, 0.0, 0.3])
    box = gp.StaticBody(name="tray", kind="box", size=half, pose=place, entity="glass")
    points = place + np.random.default_rng(0).uniform(-half, half, (20_000, 3)) * 0.999
    cloud = gp.PointCloud(name="tray", points=points, resolution=0.01, entity="glass")
    lower, upper = task.scene.limits.position.T
    q = np.random.default_rng(1).uniform(lower, upper, (300, 7))
    found = []
    for thing in (box, cloud):
        world = task.scene.edit(add=[thing])
        P = gp.interaction_probability(q, world)
        found.append(P[:, 0, list(world.entities).index("tray")])
    assert found[0].max() > 0.5
    np.testing.assert_allclose(found[1], found[0], atol=0.15)
    assert found[1].sum() == pytest.approx(found[0].sum(), rel=0.1)


def test_a_hundred_thousand_points_are_few_surfaces(scene: gp.Scene) -> None:
    rng = np.random.default_rng(2)
    points = rng.uniform([0.2, -0.6, 0.0], [0.9, 0.6, 0.3], (100_000, 3))
    points[:, 2] *= (np.sin(9.0 * points[:, 0]) * np.cos(7.0 * points[:, 1])) ** 2
    seen = scene.tasks["green_to_blue"].scene.edit(add=[gp.PointCloud(name="seen", points=points, entity="glass")])
    assert len(compile_scene(seen).world.kind) > 300
    q = np.random.default_rng(1).uniform(*seen.limits.position.T, (20, 7))
    assert np.isfinite(gp.interaction_probability(q, seen)).all()


@pytest.mark.parametrize(
    ("make", "error"),
    [
        (lambda: gp.PointCloud(name="seen", points=[[0.0, 1.0]]), ShapeError),
        (lambda: gp.PointCloud(name="seen", points=[[0.0, 1.0, 2.0]], resolution=0.0), SettingError),
        (lambda: gp.PointCloud(name="seen", points=[[0.0, 1.0, 2.0]], inflation=-1.0), SettingError),
        (lambda: gp.PointCloud(name="seen", points=[[0.0, 1.0, 2000.0]]), SettingError),
        (lambda: gp.PointCloud(name="seen", points=[[0.0] * 3, [400.0] * 3], resolution=1e-3).boxes, SettingError),
        (lambda: gp.PointCloud(name="seen", points=[[0.0] * 3], pose=np.zeros((4, 4))), Exception),
        (lambda: gp.PointCloud.from_depth("seen", np.zeros(3), np.eye(3), np.eye(4)), ShapeError),
        (lambda: gp.PointCloud.from_depth("seen", np.ones((3, 3)), np.zeros((3, 3)), np.eye(4)), SettingError),
        (lambda: gp.HeightMap(name="map", heights=[1.0], cell=0.1, corner=(0.0, 0.0)), ShapeError),
        (lambda: gp.HeightMap(name="map", heights=[[1.0]], cell=0.0, corner=(0.0, 0.0)), SettingError),
        (lambda: gp.HeightMap(name="map", heights=[[1.0]], cell=1.0, corner=(np.nan, 0.0)), NonFiniteError),
    ],
)
def test_misuse_names_the_culprit(make, error) -> None:
    with pytest.raises(error, match=r"seen|map"):
        make()


def test_names_are_taken_once_and_boxes_are_not_too_many(scene: gp.Scene) -> None:
    with pytest.raises(SceneError, match="table"):
        scene.edit(add=[gp.PointCloud(name="table", points=[[0.0] * 3])])
    dust = np.random.default_rng(0).uniform(0.0, 1.0, (60_000, 3))
    with pytest.raises(SettingError, match="resolution of dust"):
        scene.edit(add=[gp.PointCloud(name="dust", points=dust, resolution=0.002)])


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: gp.PointCloud(name="seen", points=[[0.0] * 3, [0.0] * 2]),
        lambda: gp.PointCloud(name="seen", points=[["a", "b", "c"]]),
        lambda: gp.PointCloud(name="seen", points=[[0.0] * 3], resolution=1e-300),
        lambda: gp.PointCloud(name="seen", points=[[0.0] * 3], resolution=float("nan")),
        lambda: gp.PointCloud(name="seen", points=[[0.0] * 3], inflation=1e9),
        lambda: gp.PointCloud.from_depth("seen", np.ones((3, 3)), np.eye(3), np.eye(4), near=float("nan")),
        lambda: gp.PointCloud.from_depth("seen", np.full((3, 3), np.inf), np.eye(3), np.eye(4), far=np.inf),
        lambda: gp.PointCloud.from_depth("seen", np.ones((3, 3)), np.eye(3), np.eye(4), near=2.0, far=1.0),
        lambda: gp.HeightMap(name="map", heights=[[1.0], [1.0, 2.0]], cell=0.1, corner=(0.0, 0.0)),
        lambda: gp.HeightMap(name="map", heights=[[np.inf]], cell=0.1, corner=(0.0, 0.0)),
        lambda: gp.HeightMap(name="map", heights=[[1e300]], cell=0.1, corner=(0.0, 0.0)),
        lambda: gp.HeightMap(name="map", heights=[[1.0]], cell=1e300, corner=(0.0, 0.0)),
        lambda: gp.HeightMap(name="map", heights=[[1.0]], cell=0.1, corner=(1e300, 0.0)),
        lambda: gp.HeightMap(name="map", heights=[[1.0]], cell=0.1, corner=(0.0, 0.0), bottom=float("nan")),
    ],
)
def test_impossible_sensor_data_are_refused(wrong) -> None:
    """In particular, an infinite height must not count as zero."""
    with pytest.raises((gp.GracefulPlanError, TypeCheckError)):
        wrong()


# --- points on the robot ----------------------------------------------------------------------------------------------

_SHAPES = """<mujoco><asset><mesh name="wedge" vertex="0 0 0 .2 0 0 0 .2 0 0 0 .2 .2 .2 0"/></asset><worldbody>
  <body name="far" pos="3 0 0"><geom type="box" size=".1 .1 .1"/></body>
  <body name="r/a" pos="0 0 1"><joint name="r/j" axis="0 0 1" range="-3 3"/>
    <geom type="capsule" fromto="0 0 0 .3 0 0" size=".05"/><geom type="cylinder" size=".04 .1" pos=".4 0 .1"/>
    <geom type="ellipsoid" size=".1 .05 .03" pos="0 .3 0"/><geom type="mesh" mesh="wedge" pos="-.4 0 0" euler="30 0 0"/>
    <site name="r/tip" pos=".5 0 0"/></body>
  <body name="cup" pos="0 0 3"><freejoint/><geom type="box" size=".05 .05 .05"/></body>
</worldbody></mujoco>"""


@pytest.mark.parametrize("carried", [None, "cup"])
def test_points_on_the_robot_are_left_out(carried):
    told = {"velocity": [1.0], "acceleration": [1.0], "X_TO": np.eye(4) if carried else None, "carried": carried}
    scene, q, margin = gp.Scene.from_mjcf(_SHAPES, robot="r/", tool="r/tip", **told), [0.7], 0.03
    rng = np.random.default_rng(0)
    parts = [g for c in ("body", "carried") if c in scene.components for g in scene.components[c].geoms]
    points = scene.data_at(q).geom_xpos[rng.choice(parts, 800)] + rng.uniform(-0.2, 0.2, (800, 3))
    left = gp.PointCloud(name="seen", points=points).without_robot(scene, q, margin).points
    kept = (points[:, None] == left[None]).all(axis=2).any(axis=1)
    # Every point is a tiny sphere for MuJoCo.
    spec = scene.spec.copy()
    probe_body = spec.worldbody.add_body(name="probe", mocap=True)
    probe_body.add_geom(name="probe", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[1e-6] * 3)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = scene.data_at(q).qpos
    probe, distance = model.geom("probe").id, np.zeros(len(points))
    for k, point in enumerate(points):
        data.mocap_pos[0] = point
        mujoco.mj_kinematics(model, data)
        distance[k] = min(mujoco.mj_geomDistance(model, data, g, probe, 1.0, None) for g in parts)
    assert 50 < (~kept).sum() < 700
    assert not kept[distance < margin - 2e-3].any()  # nothing on the robot stays
    assert kept[distance > margin + 0.02].all()  # and hardly anything else goes, near the corners of the mesh


def test_a_cloud_with_the_robot_in_it_blocks_nothing_afterwards():
    scene = gp.load_scene("tabletop")
    q = scene.keyframes["ready"]
    data = scene.data_at(q)
    bodies = sorted(scene.robot_bodies)
    rng = np.random.default_rng(1)
    on_links = np.concatenate([data.xipos[b] + rng.uniform(-0.03, 0.03, (200, 3)) for b in bodies])
    cloud = gp.PointCloud(name="seen", points=np.concatenate([on_links, [[0.5, 0.5, 1.2]] * 3]), inflation=0.01)
    assert gp.clearance(q, scene.edit(add=[cloud])) < 0.0
    clean = cloud.without_robot(scene, q)
    assert gp.clearance(q, scene.edit(add=[clean])) > 0.0 and len(clean.points) >= 3


@pytest.mark.parametrize(("q", "margin"), [([0.0], -0.1), ([0.0], float("nan")), ([0.0, 1.0], 0.1)])
def test_impossible_margins(q, margin):
    scene = gp.Scene.from_mjcf(_SHAPES, robot="r/", tool="r/tip", velocity=[1.0], acceleration=[1.0])
    with pytest.raises((SettingError, ShapeError)):
        gp.PointCloud(name="seen", points=[[0.0, 0.0, 0.0]]).without_robot(scene, q, margin)
