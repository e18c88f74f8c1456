"""The kernels against MuJoCo, closed forms and slow NumPy."""

import re

import mujoco
import numpy as np
import pytest
from ball import scene_of
from hypothesis import given
from hypothesis import strategies as st
from places import ROOT

import graceful_plan as gp
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import CAPACITY, COST_STEP, Kernels, instruction_sets
from graceful_plan.exceptions import NonFiniteError, SettingError, ShapeError
from graceful_plan.judge.exact import Judge
from graceful_plan.judge.reference_cost import reference_probability

_FLOAT32 = 2e-6  # metres: collision runs in single precision, poses stay within a few metres
_P = 1e-9  # probabilities: impact runs in double precision

_WEDGE = '<mesh name="wedge" vertex="0 0 0  0.2 0 0  0 0.3 0  0 0 0.25  0.2 0.1 0.1"/>'
_SHAPES = {
    "sphere": 'type="sphere" size="0.1"',
    "capsule": 'type="capsule" size="0.06 0.15"',
    "cylinder": 'type="cylinder" size="0.1 0.12"',
    "box": 'type="box" size="0.1 0.15 0.2"',
    "ellipsoid": 'type="ellipsoid" size="0.1 0.2 0.15"',
    "plane": 'type="plane" size="0 0 1"',
    "mesh": 'type="mesh" mesh="wedge"',
}

_ODD_ARM = """
<mujoco><compiler angle="radian" autolimits="true"/>
<custom>
  <numeric name="odd/velocity_limit" data="1 1 1 1 1 1"/><numeric name="odd/acceleration_limit" data="1 1 1 1 1 1"/>
</custom>
<worldbody>
  <geom name="post" type="cylinder" size="0.1 0.3" pos="0.5 0.2 0.3"/>
  <body name="odd/a" pos="0.1 0.2 0.3" quat="0.9 0.1 0.3 -0.2">
    <joint name="a1" axis="1 2 3" range="-2 2" ref="0.3"/><joint name="a2" axis="0 1 0" pos="0.05 0 0.1" range="-2 2"/>
    <geom type="capsule" size="0.04 0.1"/>
    <body name="odd/b" pos="0 0.1 0.3" euler="0.3 0.2 0.1">
      <joint name="b" type="slide" axis="1 1 0" range="-0.3 0.3" ref="0.1"/><geom type="box" size="0.05 0.04 0.1"/>
      <body name="odd/c" pos="0.2 0 0.1"><joint name="c" axis="0 0 -1" range="-2 2"/><geom type="sphere" size="0.06"/>
        <body name="odd/fixed" pos="0.1 0.1 0" euler="0 0.5 0"><geom type="cylinder" size="0.03 0.08"/>
          <body name="odd/d" pos="0 0 0.15"><joint name="d1" axis="1 0 0" range="-2 2"/>
            <joint name="d2" axis="0 1 0" range="-2 2"/>
            <geom type="ellipsoid" size="0.03 0.05 0.04"/>
              <site name="odd/tool" pos="0.02 0.03 0.1" euler="0.1 0.2 0.3"/>
  </body></body></body></body></body>
</worldbody></mujoco>"""


@pytest.fixture(scope="module")
def odd():
    return gp.Scene.from_mjcf(_ODD_ARM, robot="odd/", tool="odd/tool")


@pytest.fixture(scope="module")
def table():
    return gp.load_scene("tabletop").tasks["lift_to_goal"].scene


def _random(scene, n, seed=0):
    return np.random.default_rng(seed).uniform(*scene.limits.position.T, size=(n, len(scene.joints)))


# --- kinematics -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("which", ["odd", "table"])
def test_tool_pose_is_mujocos(which, request):
    scene = request.getfixturevalue(which)
    for q in _random(scene, 20):
        site = scene.data_at(q).site(scene.tool)
        X = compile_scene(scene).kernels.tool_pose(q)
        np.testing.assert_allclose(X[:3, 3], site.xpos, atol=1e-12)
        np.testing.assert_allclose(X[:3, :3].ravel(), site.xmat, atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, np.pi / 4, -np.pi / 2, np.pi, 3.0 * np.pi, -100.3])
def test_sine_and_cosine_hold_far_from_zero(odd, angle):
    kernels = compile_scene(odd).kernels
    q = np.array([0.3, 0.0, 0.1, 0.0, 0.0, angle])
    np.testing.assert_allclose(kernels.tool_pose(q), kernels.tool_pose(q + [0, 0, 0, 0, 0, 2 * np.pi]), atol=1e-12)
    relative = np.linalg.inv(kernels.tool_pose(q * [1, 1, 1, 1, 1, 0])) @ kernels.tool_pose(q)
    assert relative[:3, :3].trace() == pytest.approx(1 + 2 * np.cos(angle), abs=1e-12)


# --- collision --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", sorted(_SHAPES))
def test_clearance_of_a_ball_is_the_distance(shape):
    scene = scene_of(_SHAPES[shape], _WEDGE)
    kernels = compile_scene(scene).kernels
    ball, obstacle = (
        scene.model.geom("ball").id,
        int(np.flatnonzero(scene.model.geom_bodyid == scene.model.body("obstacle").id)[0]),
    )
    q = _random(scene, 200, seed=1)
    expected = [mujoco.mj_geomDistance(scene.model, scene.data_at(x), ball, obstacle, 10.0, None) for x in q]
    got = kernels.clearance(q)
    outside = np.array(expected) > 1e-3
    assert outside.any() and (~outside).any()
    np.testing.assert_allclose(
        got[outside], np.array(expected)[outside], atol=2e-4
    )  # mj_geomDistance iterates for some pairs
    assert np.all(got[outside] <= np.array(expected)[outside] + 2e-4)
    assert np.array_equal(kernels.free(q), got > 0.0)


@pytest.mark.parametrize("shape", sorted(_SHAPES))
def test_gradient_of_clearance_is_its_slope(shape):
    scene = scene_of(_SHAPES[shape], _WEDGE)
    kernels = compile_scene(scene).kernels
    q = _random(scene, 300, seed=2)
    clearance, gradient = kernels.clearance_gradient(q)
    h = 2e-3  # single precision: rounding dominates at smaller steps
    slopes = np.stack(
        [(kernels.clearance(q + h * e) - kernels.clearance(q - h * e)) / (2 * h) for e in np.eye(3)], axis=1
    )
    smooth = (clearance > 0.02) & (
        np.abs(np.linalg.norm(slopes, axis=1) - 1.0) < 1e-3
    )  # away from the borders of Voronoi regions
    assert smooth.sum() > 50
    error = np.abs(gradient - slopes)[smooth].max(axis=1)
    assert np.median(error) < 2e-4 and np.quantile(error, 0.9) < 1e-2
    np.testing.assert_allclose(np.linalg.norm(gradient, axis=1), 1.0, atol=1e-6)


def test_gradient_of_an_arm_is_its_slope(table):
    kernels = compile_scene(table).kernels
    q = _random(table, 400, seed=3)
    clearance, gradient = kernels.clearance_gradient(q)
    h = 1e-3
    slopes = np.stack(
        [(kernels.clearance(q + h * e) - kernels.clearance(q - h * e)) / (2 * h) for e in np.eye(7)], axis=1
    )
    error = np.abs(gradient - slopes).max(axis=1)
    assert np.array_equal(clearance, kernels.clearance(q))
    assert np.median(error) < 2e-4 and np.mean(error < 5e-3) > 0.9  # at the others, the nearest pair changes


@pytest.mark.parametrize("which", ["odd", "table"])
def test_never_free_where_mujoco_sees_a_collision(which, request):
    scene = request.getfixturevalue(which)
    judge = Judge(scene)
    q = _random(scene, 4000, seed=4)
    free = compile_scene(scene).kernels.free(q)
    touching = np.zeros(len(q), dtype=bool)
    touching[[touch.sample for touch in judge.touches(q)]] = True
    assert free.any() and touching.any()
    assert not np.any(free & touching)
    assert np.sum(~free & ~touching) < 0.08 * np.sum(~touching)


def test_margin_is_a_clearance(table):
    kernels = compile_scene(table).kernels
    q = _random(table, 2000, seed=5)
    clearance = kernels.clearance(q)
    certain = np.abs(clearance - 0.03) > _FLOAT32
    assert np.array_equal(kernels.free(q, margin=0.03)[certain], (clearance > 0.03)[certain])


def test_an_edge_is_free_if_and_only_if_its_configurations_are(table):
    kernels = compile_scene(table).kernels
    rng = np.random.default_rng(6)
    q0 = _random(table, 400, seed=6)
    q0 = q0[kernels.free(q0)]
    q1 = np.clip(q0 + rng.normal(size=q0.shape) * 0.3, *table.limits.position.T)
    got = kernels.edges_free(q0, q1, step=1 / 32)
    assert got.any() and (~got).any()
    fine = np.linspace(0.0, 1.0, 400)[:, None]
    for a, b, free in zip(q0, q1, got, strict=True):
        clearance = kernels.clearance(a + fine * (b - a)).min()
        assert free == (clearance > 0) or abs(clearance) < 0.01  # a shallow contact fits between two steps


def test_edges_without_length_and_reversed(table):
    kernels = compile_scene(table).kernels
    q = _random(table, 200, seed=7)
    assert np.array_equal(kernels.edges_free(q, q), kernels.free(q))
    q1 = q[::-1]
    assert np.array_equal(kernels.edges_free(q, q1), kernels.edges_free(q1, q))


def test_nothing_to_hit_is_infinitely_far():
    kernels = compile_scene(scene_of('type="box" size="0.1 0.1 0.1" contype="0" conaffinity="0"')).kernels
    clearance, gradient = kernels.clearance_gradient(np.zeros(3))
    assert clearance == np.inf and kernels.free(np.zeros(3)) and np.all(gradient == 0.0)


# --- impact -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("scene_name", gp.scenes())
def test_algorithm_1_is_the_transcription(scene_name):
    task = next(iter(gp.load_scene(scene_name).tasks.values()))
    scene = task.scene
    q = np.concatenate([_random(scene, 300, seed=8), np.linspace(task.start, task.goal[0], 100)])
    expected = reference_probability(scene, q)
    np.testing.assert_allclose(gp.interaction_probability(q, scene, "box_overlap"), expected, atol=_P)
    assert expected.max() > 0.0
    severity = gp.ImpactCost(components=("body", "carried", "contents")).severity(scene)
    impact = compile_scene(scene).kernels.impact(q, severity)
    np.testing.assert_allclose(impact, np.einsum("nce,ce->n", expected, severity), atol=1e-7)


def test_edge_cost_is_length_and_integral(table):
    kernels = compile_scene(table).kernels
    severity = gp.ImpactCost().severity(table)
    q0, q1 = _random(table, 40, seed=9), _random(table, 40, seed=10)
    cost, fine = kernels.edge_costs(q0, q1, severity), kernels.edge_costs(q0, q1, severity, step=0.1 * COST_STEP)
    np.testing.assert_allclose(cost[:, 0], np.linalg.norm(q1 - q0, axis=1), rtol=1e-12)
    s = np.linspace(0.0, 1.0, 4001)[:, None]
    for a, b, (length, impact), nearer in zip(q0, q1, cost, fine[:, 1], strict=True):
        values = kernels.impact(a + s * (b - a), severity)
        exact = length * float(np.mean((values[1:] + values[:-1]) / 2))
        assert nearer == pytest.approx(exact, rel=5e-3, abs=5e-3)
        # P jumps where one body rises above the other: the error is at most half a step times the total variation.
        step = COST_STEP + length / (len(s) - 1)
        assert abs(impact - exact) <= 0.5 * step * np.abs(np.diff(values)).sum() + 1e-9
    assert np.all(kernels.edge_costs(q0, q0, severity) == 0.0)
    # The impact is almost constant along a short edge, so the edge costs length times impact.
    q = q0[kernels.impact(q0, severity) > 0.1]
    short = kernels.edge_costs(q, q + 1e-9, severity)
    assert len(q) > 3
    np.testing.assert_allclose(short[:, 1] / short[:, 0], kernels.impact(q, severity), rtol=1e-6)


# --- all kernels ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("isa", instruction_sets())
def test_instruction_sets_agree(table, isa):
    compiled = compile_scene(table)
    other = Kernels(compiled.robot, compiled.world, compiled.impact_tables, isa=isa)
    q = _random(table, 501, seed=11)
    best = compiled.kernels
    np.testing.assert_allclose(other.clearance(q), best.clearance(q), atol=_FLOAT32)
    np.testing.assert_allclose(other.interaction(q), best.interaction(q), atol=_P)
    np.testing.assert_allclose(other.link_poses(q), best.link_poses(q), atol=1e-12)
    certain = np.abs(best.clearance(q)) > _FLOAT32
    assert np.array_equal(other.free(q)[certain], best.free(q)[certain])


def test_an_instruction_set_is_chosen_by_name(table):
    compiled = compile_scene(table)
    tables = compiled.robot, compiled.world, compiled.impact_tables
    assert compiled.kernels.isa == instruction_sets()[0]
    for name in instruction_sets():
        assert Kernels(*tables, isa=Kernels(*tables, isa=name).isa).isa == name


def test_the_documents_state_the_capacities_of_the_core():
    text = (ROOT / "docs" / "limitations.md").read_text()
    stated = re.search(
        r"room for (\d+) joints, (\d+) links .*?, (\d+) covering spheres.*?, (\d+) geoms .*? and (\d+) entities",
        text,
        re.DOTALL,
    )
    assert stated is not None
    holds = [CAPACITY[name] for name in ("joints", "links", "spheres", "parts", "entities")]
    assert [int(number) for number in stated.groups()] == holds


@given(st.sampled_from([(), (1,), (2, 3), (0,), (17,)]), st.integers(0, 99))
def test_batch_axes_pass_through(batch, seed):
    scene = gp.load_scene("tabletop_l1")
    kernels = compile_scene(scene).kernels
    q = np.random.default_rng(seed).uniform(*scene.limits.position.T, size=(*batch, 7))
    assert kernels.free(q).shape == batch
    assert kernels.clearance(q).shape == batch
    assert kernels.tool_pose(q).shape == (*batch, 4, 4)
    assert kernels.interaction(q).shape == (*batch, *kernels.impact_tables.severity.shape)
    assert kernels.edges_free(q, np.zeros(7)).shape == batch
    flat = kernels.clearance(q.reshape(-1, 7))
    assert np.array_equal(kernels.clearance(q).ravel(), flat)


def test_results_do_not_depend_on_neighbours_in_the_batch(table):
    kernels = compile_scene(table).kernels
    q = _random(table, 37, seed=12)
    np.testing.assert_array_equal(kernels.clearance(q), [kernels.clearance(x) for x in q])
    np.testing.assert_allclose(kernels.interaction(q), [kernels.interaction(x) for x in q], atol=1e-15)


def test_misuse_names_the_culprit(table):
    kernels = compile_scene(table).kernels
    with pytest.raises(ShapeError, match=r"q .*\(2, 6\)"):
        kernels.free(np.zeros((2, 6)))
    with pytest.raises(NonFiniteError, match=r"q .*\(1, 3\)"):
        kernels.clearance(np.where(np.arange(14).reshape(2, 7) == 10, np.nan, 0.0))
    with pytest.raises(ShapeError, match="severity"):
        kernels.impact(np.zeros(7), np.zeros((1, 1)))
    with pytest.raises(SettingError, match="step"):
        kernels.edges_free(np.zeros(7), np.ones(7), step=0.0)
    with pytest.raises(SettingError, match="isa"):
        Kernels(kernels.robot, kernels.world, kernels.impact_tables, isa="avx1024")


def test_numbers_that_single_precision_cannot_hold_are_refused(table):
    kernels = compile_scene(table).kernels
    with pytest.raises(SettingError, match="q = "):
        kernels.clearance(np.full(7, 1e39))
    for margin in (np.nan, np.inf):
        with pytest.raises(SettingError, match="margin"):
            kernels.free(np.zeros(7), margin=margin)
    with pytest.raises(SettingError, match="step"):
        kernels.edges_free(np.zeros(7), np.ones(7), step=1e-12)


def test_a_body_without_area_from_above_is_not_hit_from_above():
    """A vertical pane is a plane whose box has zero area in xy, which used to give 0 / 0."""
    task = gp.load_scene("tabletop_l1").tasks["green_to_blue"]
    thin = task.scene.add_box("pane", [0.2, 1e-13, 0.1], [0.0, -0.35, 0.3], entity="glass")
    index = list(thin.entities).index("pane")
    probability = gp.interaction_probability(_random(thin, 500, seed=13), thin, "box_overlap")[:, :, index]
    assert np.all(probability == 0.0)
