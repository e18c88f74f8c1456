import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from graceful_plan.core.compile import compile_scene
from graceful_plan.costs.cost import StateBatch
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.models.mixture.mixture import FALLING
from graceful_plan.path import Path
from graceful_plan.scene.loading.bundled import load_scene
from graceful_plan.scene.scene import Scene
from graceful_plan.viz import figures, render
from graceful_plan.viz.drop import drop_impact
from graceful_plan.viz.footprints import entity_outlines, object_positions, outline, surface_points

_TOLERANCE = 1e-9  # both in double precision, with poses from two robot models

ARM = """
<mujoco><worldbody>
  <body name="arm/base"><geom type="box" size=".05 .05 .05" pos="0 0 -1"/>
    <body name="arm/slide"><joint name="arm/x" type="slide" axis="1 0 0" range="-1 1"/>
      <geom type="box" size=".02 .02 .02" pos="0 0 1"/><site name="arm/tool" pos="0 0 .9"/></body></body>
  <geom name="floor" type="plane" size="2 2 .1" pos="0 0 -1.05"/>
  <body name="ball" pos=".5 .1 0"><geom type="sphere" size=".1"/></body>
  <body name="can" pos="-.5 .1 0"><geom type="cylinder" size=".1 .2"/></body>
  <body name="egg" pos=".5 -.4 0"><geom type="ellipsoid" size=".1 .05 .2"/></body>
  <body name="log" pos="-.5 -.4 0" euler="0 90 0"><geom type="capsule" size=".05 .2"/></body>
</worldbody></mujoco>"""


@pytest.fixture(scope="module")
def task():
    return next(iter(load_scene("tabletop").tasks.values()))


@given(hnp.arrays(float, st.tuples(st.integers(1, 40), st.just(3)), elements=st.integers(-3, 3)))
def test_outline_holds_all_points_and_turns_left(points):
    corners = outline(points)
    assert {tuple(c) for c in corners} <= {tuple(p) for p in points[:, :2]}
    if len(corners) > 2:
        edges = np.roll(corners, -1, axis=0) - corners
        to_points = points[None, :, :2] - corners[:, None]
        assert np.all(edges[:, None, 0] * to_points[..., 1] - edges[:, None, 1] * to_points[..., 0] >= 0.0)


@pytest.mark.parametrize(
    ("name", "half"), [("ball", (0.1, 0.1)), ("can", (0.1, 0.1)), ("egg", (0.1, 0.05)), ("log", (0.25, 0.05))]
)
def test_outlines_are_as_large_as_the_geoms(name, half):
    scene = Scene.from_mjcf(
        ARM, robot="arm/", tool="arm/tool", velocity=[1.0], acceleration=[1.0], entities={name: "glass"}
    )
    [corners] = entity_outlines(scene, [name])[name]
    np.testing.assert_allclose(np.ptp(corners, axis=0) / 2, half, rtol=0.01)
    np.testing.assert_allclose(corners.mean(axis=0), scene.model.body(name).pos[:2], atol=0.005)


def test_plane_has_no_outline():
    scene = Scene.from_mjcf(ARM, robot="arm/", tool="arm/tool", velocity=[1.0], acceleration=[1.0])
    floor = scene.model.geom("floor").id
    assert len(surface_points(scene, scene.data_at(np.zeros(1)), floor)) == 0


def test_drop_impact_where_the_object_is_equals_the_default(task):
    scene = task.scene
    low, high = scene.limits.position.T
    q = np.random.default_rng(0).uniform(low, high, (20, len(low)))
    expected = ImpactCost(components=FALLING).state(StateBatch(scene, q))
    here = object_positions(scene, Path(q))
    found = [drop_impact(scene, q[i], here[i, :1], here[i, 1:2])[0, 0] for i in range(len(q))]
    assert np.max(expected) > 0.0
    np.testing.assert_allclose(found, expected, atol=_TOLERANCE)


def test_drop_impact_is_worst_above_the_worst_and_nothing_far_away(task):
    scene = task.scene
    worst = max(scene.entities.values(), key=lambda entity: entity.severity["carried"])
    above = entity_outlines(scene, [worst.name])[worst.name][0].mean(axis=0)
    impact = drop_impact(scene, task.start, np.array([above[0], 9.0]), np.array([above[1]]))
    assert impact[0, 0] >= worst.severity["carried"]
    assert impact[0, 1] == 0.0


def test_object_positions_start_at_the_tool(task):
    scene = task.scene
    position = object_positions(scene, Path(task.start[None]))[0]
    tool = compile_scene(scene).kernels.tool_pose(task.start)
    np.testing.assert_allclose(position, (tool @ scene.carried.X_TO)[:3, 3], atol=1e-9)


def test_picture_is_drawn(task, tmp_path):
    file = tmp_path / "picture.png"
    straight = Path(np.stack([task.start, task.goal[0]]))
    figures.compare_paths(task.scene, {"one": straight, "other": straight.reversed()}, file)
    header = file.read_bytes()[:24]
    assert header[:8] == b"\x89PNG\r\n\x1a\n"
    assert int.from_bytes(header[16:20], "big") >= 1600


def test_view_is_rendered_or_declined(task, tmp_path):
    file = tmp_path / "view.png"
    rendered = render.render_paths(task.scene, {"one": Path(np.stack([task.start, task.goal[0]]))}, file)
    assert rendered == file.exists()
    if rendered:
        from matplotlib.image import imread

        assert np.ptp(imread(file)) > 0.5


def test_view_is_declined_without_egl(task, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco.egl", None)
    file = tmp_path / "view.png"
    assert not render.render_paths(task.scene, {"one": Path(task.start[None])}, file)
    assert not file.exists()
