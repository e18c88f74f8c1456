"""The body model: laws, and the core against a slow twin and MuJoCo."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from body_twin import BodyTwin
from hypothesis import given, settings
from hypothesis import strategies as st

import graceful_plan as gp
from graceful_plan import StateBatch
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import Kernels, instruction_sets
from graceful_plan.costs.models.body import body as body_module
from graceful_plan.costs.models.body.body import (
    SINGLE,
    BodyModel,
    chance,
    mode_margins,
    mode_names,
    mode_weights,
    native_model,
    native_model_of,
)
from graceful_plan.costs.models.body.constants import GENERATORS, BodySettings, Margin, Margins
from graceful_plan.costs.models.body.tables import BodyTables, body_tables
from graceful_plan.exceptions import NonFiniteError, SceneError, SettingError, ShapeError
from graceful_plan.timing.dynamics import RobotDynamics

_SAME = 1e-9  # metres; core and twin differ by rounding, and Newton's method may stop one step apart
_TORQUE = 1e-8  # N m and rad/s^2; MuJoCo's own rounding
_TINY = 1e-6  # share of a severity of 1; single precision of probabilities near 0
SETTINGS = BodySettings.shipped()
_COARSE = replace(SETTINGS, steps=2)

_ARM = """
<mujoco><compiler angle="radian"/><worldbody>
  <body name="ground"><geom name="ground" type="plane" size="0 0 1"/></body>
  <body name="vase" pos="{vase}" euler="0 0 {turn}"><freejoint/>
    <geom type="cylinder" size="0.06 0.2" mass="0.3"/></body>
  <body name="lamp" pos="{lamp}" euler="0 0 {turn}"><freejoint/>
    <geom type="ellipsoid" size="0.06 0.1 0.08" mass="0.3"/></body>
  <body name="arm" pos="0 0 0.5" euler="0 0 {turn}"><geom type="capsule" size="0.05 0.05" mass="1"/>
    <body name="arm_a"><joint name="a" axis="0.2 0.1 1" range="-2 2" damping="0.3" armature="0.05"/>
    <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.04" mass="2"/>
    <body name="arm_b" pos="0.3 0 0"><joint name="b" type="slide" axis="1 0.3 0.1" range="-0.3 0.3" damping="2"/>
      <geom type="box" size="0.05 0.03 0.04" pos="0.05 0 0" mass="1"/>
      <body name="arm_c" pos="0.1 0 0.1"><joint name="c" axis="0 1 0.2" pos="0 0.05 0" range="-1 1" frictionloss="0.2"/>
        <joint name="d" axis="1 0 0" range="-2 2"/><geom type="sphere" size="0.05" pos="0 0.1 0" mass="0.7"/>
        <site name="tool" pos="0.1 0 -0.05"/>
  </body></body></body></body>
  <body name="thing" pos="3 3 1"><freejoint/>
    <geom type="box" size="0.03 0.04 0.05" mass="0.3"/>
    <geom type="sphere" size="0.02" pos="0 0 0.07" mass="0.1"/></body>
</worldbody></mujoco>"""


def _odd(turn=0.0, entities=("vase", "lamp", "ground"), held=True):
    c, s = np.cos(turn), np.sin(turn)
    place = {"vase": (0.6, 0.15, 0.2), "lamp": (0.5, -0.3, 0.5)}
    turned = {n: f"{c * x - s * y} {s * x + c * y} {z}" for n, (x, y, z) in place.items()}
    text = _ARM.format(turn=turn, **turned)
    notes = {name: gp.EntityAnnotation(category="glass") for name in entities}
    scene = gp.Scene.from_mjcf(text, robot="arm", tool="tool", velocity=[2.0] * 4,
                               acceleration=[5.0] * 4, entities=notes)  # fmt: skip
    return scene.attach("thing", X_TO=np.eye(4)) if held else scene


def _stopped(gain, **changes):
    margins = {name: replace(getattr(SETTINGS, name), stop_gain=gain) for name in GENERATORS}
    return replace(SETTINGS, **margins, **changes)


def _states(scene, n, seed, fastest=1.0):
    rng = np.random.default_rng(seed)
    q = rng.uniform(*scene.limits.position.T, size=(n, len(scene.joints)))
    return q, scene.limits.velocity * rng.uniform(-fastest, fastest, q.shape)


def _batch(scene, q, qd):
    speed = np.linalg.norm(qd, axis=1)
    return StateBatch(scene, q, qd / np.where(speed > 0.0, speed, 1.0)[:, None], speed)


@pytest.fixture(scope="module")
def odd():
    return _odd()


@pytest.fixture(scope="module")
def tabletop():
    return gp.load_scene("tabletop").tasks["lift_to_goal"].scene


# --- the core against twin and MuJoCo --------------------------------------------------------------------------------


def test_the_core_is_the_specification(odd):
    constants = _stopped(2.0, steps=2)
    q, qd = _states(odd, 2, seed=0)
    twin, found = BodyTwin(odd, constants), BodyModel(constants).distances(_batch(odd, q, qd))
    expected = [twin.distances(*state) for state in zip(q, qd, strict=True)]
    np.testing.assert_allclose(found, expected, atol=_SAME)
    assert (found < 0.2).any(axis=(0, 1, 3)).all()  # both rows come near some entity
    q, qd = q[:1], qd[:1]
    ahead = q[:, None] + np.linspace(0.1, 0.4, 2)[:, None] * qd[:, None]
    found = BodyModel(constants).distances(_batch(odd, q, qd), ahead)
    np.testing.assert_allclose(found[0], twin.distances(q[0], qd[0], ahead[0]), atol=_SAME)


@pytest.mark.long
@pytest.mark.parametrize("name", ["tabletop", "dining_table"])
def test_the_core_is_the_specification_in_bundled_scenes(name):
    task = next(iter(gp.load_scene(name).tasks.values()))
    constants = replace(SETTINGS, steps=1)
    qd = 0.4 * (task.goal[:1] - task.start)
    q = 0.5 * (task.goal[:1] + task.start)
    found = BodyModel(constants).distances(_batch(task.scene, q, qd))
    # Nearest points are computed iteratively and may differ by a few nanometres.
    np.testing.assert_allclose(found[0], BodyTwin(task.scene, constants).distances(q[0], qd[0]), atol=1e-7)


def _accelerations(scene, q):
    """Joint accelerations without drives, by MuJoCo; the carried object is welded to the tool by hand."""
    model = scene.model.__copy__()
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    model.dof_frictionloss[:] = 0.0
    data = mujoco.MjData(model)
    data.qpos[:] = scene.data_at(q).qpos
    mujoco.mj_forward(model, data)
    dofs = [int(model.jnt_dofadr[model.joint(name).id]) for name in scene.joints]
    return data.qacc[dofs]


def test_accelerations_equal_those_of_mujoco():
    scene = _odd(held=False)
    q, _ = _states(scene, 10, seed=1)
    M, G = native_model(scene, SETTINGS).dynamics(q)
    expected = [_accelerations(scene, state) for state in q]
    np.testing.assert_allclose(-np.linalg.solve(M, G[..., None])[..., 0], expected, atol=_TORQUE)


@pytest.mark.parametrize("name", ["tabletop", "dining_table"])
def test_torques_equal_inverse_dynamics(name):
    scene = next(iter(gp.load_scene(name).tasks.values())).scene
    inverse = RobotDynamics(scene)
    q, _ = _states(scene, 4, seed=2)
    M, G = native_model(scene, SETTINGS).dynamics(q)
    still, axes = np.zeros(len(scene.joints)), np.eye(len(scene.joints))
    for k, state in enumerate(q):
        torque = inverse(state, still, still)
        np.testing.assert_allclose(G[k], torque, atol=_TORQUE)
        columns = np.array([inverse(state, still, axis) - torque for axis in axes]).T
        np.testing.assert_allclose(M[k], columns, atol=_TORQUE)


def test_a_joint_without_power_rests_on_obstacles(odd):
    q, qd = _states(odd, 400, seed=11)
    never = replace(SETTINGS, joint=replace(SETTINGS.joint, stop_tolerance=100.0))
    batch, loose = _batch(odd, q, qd), slice(1, 5)
    through, resting = (BodyModel(constants).distances(batch)[:, loose] for constants in (never, SETTINGS))
    # A resting link may be moved by the other joints, but most links that fall through an entity get deeper.
    assert (resting >= through - 1e-9).mean() > 0.99
    assert (resting > through + 0.01).sum() > 10


# --- single precision, and derivatives -------------------------------------------------------------------------------

_WEIGHTS = np.array([[0.04, 0.01], [0.04, 0.03], [0.07, 0.07], [0.01, 0.01]])


def _severity(scene):
    return np.array([[e.severity[name] for e in scene.entities.values()] for name in scene.components])


def _along(scene, task, n, seed):
    """States near the path from start to goal, at the speeds of edges."""
    rng = np.random.default_rng(seed)
    u = rng.uniform(size=(n, 1))
    q = task.start + u * (task.goal[0] - task.start) + rng.normal(scale=0.2, size=(n, len(task.start)))
    way = task.goal[0] - task.start + rng.normal(scale=0.3, size=q.shape)
    return np.clip(q, *scene.limits.position.T), 0.4 * way / np.abs(way / scene.limits.velocity).max(axis=1)[:, None]


@pytest.mark.parametrize("isa", instruction_sets())
@pytest.mark.parametrize(("name", "task"), [("tabletop", "lift_to_goal"), ("dining_table", "serve_tea")])
def test_the_impact_is_that_of_the_distances_nearly(name, task, isa):
    task = gp.load_scene(name).tasks[task]
    scene, compiled = task.scene, compile_scene(task.scene)
    native = native_model_of(scene, SETTINGS, Kernels(compiled.robot, compiled.world, compiled.impact_tables, isa=isa))
    q, qd = _along(scene, task, 203, seed=0)
    severity = _severity(scene)[:2]
    weight = mode_weights(_WEIGHTS, len(scene.joints))
    P = BodyModel().modes(_batch(scene, q, qd))
    expected = np.einsum("nmre,mr,re->n", P, weight, severity)
    found = native.impact(weight, severity, q, qd)
    error = np.abs(found - expected) / (SINGLE * expected + _TINY * severity.max())
    # A joint rests beyond some depth; only states very close to that depth depend on rounding.
    assert np.sort(error)[-3] < 1.0 and np.median(error) < 0.1
    assert (expected > 0.0).mean() > 0.5
    same, by_q, by_qd = native.gradient(weight, severity, q, qd)
    np.testing.assert_allclose(same, found, rtol=1e-5, atol=_TINY)
    assert by_q.shape == by_qd.shape == q.shape
    assert np.isfinite(by_q).all() and np.isfinite(by_qd).all()


def _slopes(value, x, step=1e-5):
    """Compute central differences."""
    units = step * np.eye(x.shape[1])
    return np.stack([(value(x + unit) - value(x - unit)) / (2.0 * step) for unit in units], axis=1)


def _cosines(a, b):
    return (a * b).sum(axis=1) / (np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1) + 1e-30)


@pytest.mark.parametrize("generator", [*GENERATORS, "all"])
def test_derivatives_of_the_impact(generator, tabletop):
    task = gp.load_scene("tabletop").tasks["lift_to_goal"]
    q, qd = _along(tabletop, task, 40, seed=1)
    severity, model = _severity(tabletop), BodyModel()
    weights = _WEIGHTS * (np.array([generator in ("all", name) for name in GENERATORS]))[:, None]
    weight = mode_weights(weights, len(tabletop.joints))

    def impact(q, qd):
        return np.einsum("nmre,mr,re->n", model.modes(_batch(tabletop, q, qd)), weight, severity)

    value, by_q, by_qd = model.impact_gradient(_batch(tabletop, q, qd), severity, weights)
    np.testing.assert_allclose(value, model.impact(_batch(tabletop, q, qd), severity, weights), rtol=1e-5, atol=_TINY)
    for given_slope, slope in (
        (by_q, _slopes(lambda x: impact(x, qd), q)),
        (by_qd, _slopes(lambda x: impact(q, x), qd)),
    ):
        cosine = _cosines(given_slope, slope)[np.linalg.norm(slope, axis=1) > 1e-5]
        assert len(cosine) > 10
        if generator in ("stuck", "stray"):  # these gradients are complete
            assert np.quantile(cosine, 0.1) > 0.999
        assert np.median(cosine) > 0.97 and np.quantile(cosine, 0.1) > 0.9
        size = np.linalg.norm(given_slope, axis=1) / np.maximum(np.linalg.norm(slope, axis=1), 1e-30)
        assert 0.8 < np.median(size) < 1.25


def test_derivatives_of_slides_and_of_arms_that_are_stopped(odd):
    q, qd = _states(odd, 60, seed=13, fastest=0.3)
    severity, model = np.array([[1.0, 2.0, 0.5], [0.0, 1.0, 1.0]]), BodyModel(_stopped(2.0, steps=3))
    weight = mode_weights(_WEIGHTS, 4)

    def impact(q):
        return np.einsum("nmre,mr,re->n", model.modes(_batch(odd, q, qd)), weight, severity)

    _, by_q, _ = model.impact_gradient(_batch(odd, q, qd), severity, _WEIGHTS)
    slope = _slopes(impact, q)
    cosine = _cosines(by_q, slope)[np.linalg.norm(slope, axis=1) > 1e-4]
    assert len(cosine) > 20 and np.median(cosine) > 0.9


def test_wider_margins(odd):
    wide = SETTINGS.widened(0.1)
    assert wide.joint.body.spread == pytest.approx(np.hypot(SETTINGS.joint.body.spread, 0.1 * np.sqrt(3.0) / np.pi))
    assert wide.stray.carried.offset == SETTINGS.stray.carried.offset and wide.steps == SETTINGS.steps
    q, qd = _states(odd, 50, seed=14)
    narrow, smeared = (BodyModel(constants).probability(_batch(odd, q, qd)) for constants in (SETTINGS, wide))
    assert (smeared > 0.0).sum() > (narrow > 0.0).sum() and smeared.max() <= 1.0


# --- laws ------------------------------------------------------------------------------------------------------------


@given(seed=st.integers(0, 10_000), fastest=st.floats(0.0, 3.0))
@settings(max_examples=25, deadline=None)
def test_probabilities_and_neighbours(odd, seed, fastest):
    q, qd = _states(odd, 11, seed, fastest)
    model = BodyModel(_COARSE)
    P = model.modes(_batch(odd, q, qd))
    assert P.shape == (11, len(mode_names(odd)), 2, 3)
    assert (P >= 0.0).all() and (P <= 1.0).all()
    alone = [model.modes(_batch(odd, q[i : i + 1], qd[i : i + 1]))[0] for i in range(11)]
    np.testing.assert_allclose(P, alone, atol=1e-9)
    means = model.probability(_batch(odd, q, qd))
    np.testing.assert_allclose(means[:, 1], P[:, 1:5].mean(axis=1), atol=1e-15)
    assert means.shape == (11, len(GENERATORS), 2, 3)


@given(seed=st.integers(0, 10_000), turn=st.floats(-3.0, 3.0))
@settings(max_examples=10, deadline=None)
def test_robot_and_scene_may_turn_together(odd, seed, turn):
    q, qd = _states(odd, 9, seed)
    turned = _odd(turn)
    model = BodyModel(_COARSE)
    # Poses rounded to single precision change the distances slightly.
    first, second = model.distances(_batch(odd, q, qd)), model.distances(_batch(turned, q, qd))
    np.testing.assert_allclose(first, second, atol=5e-6)


@given(offset=st.floats(-0.2, 0.2), spread=st.floats(0.001, 0.2))
def test_chances_fall_with_distance(offset, spread):
    d = np.linspace(offset - 20.0 * spread, offset + 20.0 * spread, 400)
    P = chance(d[:, None, None, None], np.array([[offset]]), np.array([[spread]])).ravel()
    assert P[0] == pytest.approx(1.0, abs=5e-4) and P[-1] == 0.0
    assert (np.diff(P) <= 1e-15).all()
    assert chance(np.full((1, 1, 1, 1), offset), np.array([[offset]]), np.array([[spread]])).item() == pytest.approx(
        0.5, abs=2e-4
    )


def test_distant_entities_are_not_hit(odd):
    q, qd = _states(odd, 50, seed=5)
    vase = list(odd.entities).index("vase")
    away = odd.add_box("far", [0.1, 0.1, 0.1], [0.0, 0.0, 9.0], entity="glass")
    P, before = BodyModel(_COARSE).probability(_batch(away, q, qd)), BodyModel(_COARSE).probability(_batch(odd, q, qd))
    assert (P[..., list(away.entities).index("far")] < 1e-15).all()  # 0 up to rounding
    np.testing.assert_allclose(P[..., list(away.entities).index("vase")], before[..., vase], atol=1e-12)


def test_entities_without_severity_change_nothing(odd):
    q, qd = _states(odd, 300, seed=6)
    severity = np.array([[1.0, 0.0, 2.0], [3.0, 0.0, 0.5]])
    weights = np.array([[0.1, 0.2], [0.2, 0.0], [0.3, 0.5], [0.4, 0.1]])
    model, batch = BodyModel(_COARSE), _batch(odd, q, qd)
    expected = np.einsum("ngre,gr,re->n", model.probability(batch), weights, severity)
    np.testing.assert_allclose(model.impact(batch, severity, weights), expected, rtol=SINGLE, atol=_TINY)
    assert expected.max() > 1e-3
    fewer = _odd(entities=("vase", "ground"))
    found = model.impact(_batch(fewer, q, qd), severity[:, [0, 2]], weights)
    np.testing.assert_allclose(found, expected, rtol=SINGLE, atol=_TINY)


def test_no_object_and_no_entities(tabletop):
    scene = _odd(held=False)
    q, qd = _states(scene, 9, seed=7)
    P = BodyModel(_COARSE).probability(_batch(scene, q, qd))
    assert (P[:, :, 1] < 1e-15).all() and P[:, :, 0].max() > 0.1
    empty = _odd(entities=())
    assert BodyModel(_COARSE).probability(_batch(empty, q, qd)).shape == (9, 4, 2, 0)
    assert (BodyModel(_COARSE).impact(_batch(empty, q, qd), np.zeros((2, 0)), np.ones((4, 2))) == 0.0).all()
    assert BodyModel().modes(_batch(tabletop, np.zeros((0, 7)), np.zeros((0, 7)))).shape[0] == 0


def test_a_supported_arm_does_not_reach_entities_below(odd):
    q, qd = _states(odd, 60, seed=8)
    free = BodyModel(_stopped(0.0, steps=2)).distances(_batch(odd, q, qd))
    held = BodyModel(_stopped(4.0, steps=2)).distances(_batch(odd, q, qd))
    assert (held >= free - 1e-12).all()
    assert (held > free + 1e-3).any()


# --- planners --------------------------------------------------------------------------------------------------------


def test_costs_in_planners_equal_the_model(odd):
    q, _ = _states(odd, 12, seed=9)
    severity, weights = np.array([[1.0, 2.0, 0.5], [0.0, 1.0, 1.0]]), np.outer([0.4, 0.3, 0.2, 0.1], [1.0, 0.5])
    model = BodyModel(_COARSE)
    kernel = model.kernel(odd, severity, weights, (0.5, 0.5))
    at_rest = model.impact(_batch(odd, q, np.zeros_like(q)), severity, weights)
    np.testing.assert_allclose(kernel.states(q), at_rest, atol=1e-12)
    cost = kernel.edges(q[:-1], q[1:], 0.05)
    for k in range(4):
        way = q[k + 1] - q[k]
        rate = 0.5 * way / (np.abs(way) / odd.limits.velocity).max()
        s = np.linspace(0.0, 1.0, 2000)
        states = q[k] + s[:, None] * way
        I = model.impact(_batch(odd, states, np.tile(rate, (len(s), 1))), severity, weights)  # noqa: E741
        assert cost[k, 0] == pytest.approx(np.linalg.norm(way))
        assert cost[k, 1] == pytest.approx(np.trapezoid(I, s) * cost[k, 0], rel=0.02, abs=1e-3)


# --- misuse ----------------------------------------------------------------------------------------------------------


def test_misuse(odd):
    q, qd = _states(odd, 3, seed=10)
    batch, model = _batch(odd, q, qd), BodyModel()
    with pytest.raises(ShapeError, match="ahead"):
        model.modes(batch, np.zeros((2, 3, 4)))
    with pytest.raises(SettingError, match="steps ahead"):
        model.modes(batch, np.zeros((3, 65, 4)))
    with pytest.raises(NonFiniteError):
        model.modes(batch, np.full((3, 1, 4), np.nan))
    with pytest.raises(ShapeError, match="weights"):
        mode_weights(np.ones((3, 2)), 4)
    with pytest.raises(SettingError, match="weights"):
        mode_weights(np.full((4, 2), -1.0), 4)
    with pytest.raises(ShapeError, match="severity"):
        model.impact(batch, np.ones((1, 3)), np.ones((4, 2)))
    with pytest.raises(SettingError, match="spread"):
        Margin(offset=0.0, spread=0.0)
    with pytest.raises(SettingError, match="steps"):
        replace(SETTINGS, steps=65)
    with pytest.raises(SettingError, match="stop_gain"):
        _stopped(-1.0)
    with pytest.raises(SettingError, match="brake_time"):
        replace(SETTINGS, brake_time=-1.0)


def test_constants_from_a_file(tmp_path):
    text = (body_module.__file__ or "").replace("body.py", "body.yaml")
    file = tmp_path / "body.yaml"
    content = Path(text).read_text(encoding="utf-8")
    file.write_text(content)
    assert BodySettings.load(file) == SETTINGS
    offset, spread = mode_margins(SETTINGS, 2)
    assert offset.shape == spread.shape == (6, 2)
    assert offset[0, 1] == SETTINGS.collapse.carried.offset
    assert isinstance(SETTINGS.joint, Margins)
    file.write_text(content.replace("version: 1", "version: 2"))
    with pytest.raises(SceneError, match="version 1"):
        BodySettings.load(file)


def test_tables_are_documented():
    rows = [line.split("|")[1].strip() for line in (BodyTables.__doc__ or "").splitlines() if "|" in line][2:]
    assert rows == list(BodyTables.__dataclass_fields__)


def test_inertias_are_those_of_the_model(tabletop):
    tables, model = body_tables(tabletop), tabletop.model
    held = model.body_rootid == model.body_rootid[model.body(tabletop.carried.body).id]
    moving = [b for b in tabletop.robot_bodies if model.body(b).name != "panda/link0"]
    assert tables.mass.sum() == pytest.approx(model.body_mass[moving].sum() + model.body_mass[held].sum())
    assert compile_scene(tabletop).world.geom.shape == tables.entity.shape
