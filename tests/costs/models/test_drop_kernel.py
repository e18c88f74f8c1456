"""The drop model in the core against the one in NumPy."""

import gc
import weakref
from dataclasses import replace

import numpy as np
import pytest
from drop_twin import dropped
from hypothesis import given, settings
from hypothesis import strategies as st
from own_loss_twin import own_loss
from wrapped import Wrapped

import graceful_plan as gp
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import Kernels, instruction_sets
from graceful_plan.costs.cost import StateBatch
from graceful_plan.costs.models.drop.constants import DropSettings
from graceful_plan.costs.models.drop.kernel import CONSTANTS, ROWS, DropKernel, drop_kernel
from graceful_plan.costs.models.drop.loss import loss_tables
from graceful_plan.costs.models.drop.tables import SHAPE_CLASSES, drop_tables
from graceful_plan.costs.models.spill.constants import SpillSettings
from graceful_plan.costs.models.spill.tables import spill_tables
from graceful_plan.costs.objective import moving_batch
from graceful_plan.exceptions import NonFiniteError, ShapeError
from graceful_plan.planners.native import native_space
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.scene.harm.fragility import FragilityTable
from graceful_plan.testing import check_cost
from sizes import first_quick

_P = 1e-11  # probabilities: pruning and rounding; the documented bound is 1e-9
SETTINGS = DropSettings.shipped()


_ODD_ARM = """
<mujoco><compiler angle="radian"/><worldbody>
  <geom name="ground" type="plane" size="0 0 1"/>
  <body name="vase" pos="0.55 0.1 0.2"><geom type="cylinder" size="0.06 0.2"/></body>
  <body name="box" pos="0.3 0.2 0.1" euler="0 0 0.4"><geom type="box" size="0.1 0.2 0.1"/></body>
  <body name="arm" pos="0 0 0.6"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
    <joint name="a" axis="0.2 0.1 1" range="-2 2"/>
    <body name="b" pos="0.2 0 0"><joint name="b" type="slide" axis="1 0.3 0.1" range="-0.3 0.3"/>
      <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
      <body name="c" pos="0.1 0 0.1"><joint name="c" axis="0 1 0.2" pos="0 0.05 0" range="-1 1"/>
        <joint name="d" axis="1 0 0" range="-2 2"/><geom type="sphere" size="0.01"/>
        <site name="tool" pos="0.1 0 -0.05"/>
  </body></body></body>
  <body name="thing" pos="3 3 1"><freejoint/>
    <geom type="box" size="0.03 0.04 0.05"/><geom type="capsule" size="0.01 0.04" pos="0.05 0 0.02" euler="0.4 0 0"/>
    <geom type="sphere" size="0.02" pos="0 0 0.07"/></body>
</worldbody></mujoco>"""


def _states(scene, n, seed, fastest=1.5):
    rng = np.random.default_rng(seed)
    q = rng.uniform(*scene.limits.position.T, size=(n, len(scene.joints)))
    return q, scene.limits.velocity * rng.uniform(-1.0, 1.0, q.shape) * rng.uniform(0.0, fastest, (n, 1))


def _kernel_of(scene, isa):
    compiled, tables = compile_scene(scene), drop_tables(scene)
    kernels = Kernels(compiled.robot, compiled.world, compiled.impact_tables, isa=isa)
    contents = None if scene.contents is None else (spill_tables(scene), SpillSettings.shipped())
    constants, loss = SETTINGS.of(tables.shape_class), loss_tables(scene, FragilityTable.shipped())
    return DropKernel(tables, constants, kernels, scene.limits.velocity, len(scene.entities), contents, loss)


def _numpy(scene, q, qd):
    return dropped(moving_batch(scene, q, qd)).entity


@pytest.fixture(scope="module")
def scene():
    return gp.load_scene("desk").tasks["bring_coffee"].scene


@pytest.fixture(scope="module")
def kernel(scene):
    return drop_kernel(scene, SETTINGS)


# --- values -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", first_quick(gp.scenes()))
def test_the_kernel_is_the_specification(name):
    for k, task in enumerate(gp.load_scene(name).tasks.values()):
        q, qd = _states(task.scene, 150, seed=k)
        q[-50:] = np.linspace(task.start, task.goal[0], 50)
        qd[-25:] = 0.0
        kernel = drop_kernel(task.scene, SETTINGS)
        found, lost = kernel.probability(q, qd), kernel.own_loss(q, qd)
        np.testing.assert_allclose(found[:, 0], _numpy(task.scene, q, qd), atol=_P)
        np.testing.assert_allclose(lost, own_loss(moving_batch(task.scene, q, qd)), atol=_P)
        assert found[:, 0].max() > 0.5 and lost.max() > (0.5 if task.scene.carried.object_class != "sharp" else 0.01)


@given(seed=st.integers(0, 10_000), scale=st.floats(0.2, 4.0), fastest=st.floats(0.0, 20.0))
@settings(max_examples=10, deadline=None)
def test_constants_of_all_sizes(scene, seed, scale, fastest):
    rng = np.random.default_rng(seed)
    tables = drop_tables(scene)
    values = {n: getattr(SETTINGS.of(tables.shape_class), n) * scale ** rng.uniform(-1.0, 1.0) for n in CONSTANTS}
    values["catch"] = min(1.0, values["catch"])
    constants = type(SETTINGS.box)(**values)
    compiled = compile_scene(scene)
    loss = loss_tables(scene, FragilityTable.shipped())
    found = DropKernel(tables, constants, compiled.kernels, scene.limits.velocity, len(scene.entities), loss=loss)
    q, qd = _states(scene, 40, seed, fastest)
    same = DropSettings(box=constants, cylinder=constants, plate=constants, ball=constants)
    batch = moving_batch(scene, q, qd)
    np.testing.assert_allclose(found.probability(q, qd)[:, 0], dropped(batch, same).entity, atol=1e-9)
    np.testing.assert_allclose(found.own_loss(q, qd), own_loss(batch, same), atol=1e-9)


@pytest.mark.parametrize("isa", instruction_sets())
def test_instruction_sets_agree(scene, kernel, isa):
    other = _kernel_of(scene, isa)
    q, qd = _states(scene, 301, seed=1)
    np.testing.assert_allclose(other.probability(q, qd)[:, 0], kernel.probability(q, qd)[:, 0], atol=_P)
    np.testing.assert_allclose(other.own_loss(q, qd), kernel.own_loss(q, qd), atol=_P)
    x = np.concatenate([np.linspace(-700.0, 700.0, 4001), np.linspace(-1.0, 1.0, 999), [0.0, 5e-324, -5e-324]])
    exponential, logarithm = other.kernels.core.elementary(x)
    np.testing.assert_allclose(exponential, np.exp(x), rtol=1e-13)
    np.testing.assert_allclose(logarithm, x, rtol=1e-13, atol=3e-16)


def test_neighbours_in_the_batch_and_batch_axes(scene, kernel):
    q, qd = _states(scene, 21, seed=2)
    whole = kernel.probability(q, qd)
    each = [kernel.probability(*state) for state in zip(q, qd, strict=True)]
    np.testing.assert_allclose(whole, each, atol=_P)
    shaped = kernel.probability(q.reshape(3, 7, -1), qd.reshape(3, 7, -1))
    assert np.array_equal(shaped.reshape(whole.shape), whole)
    assert np.array_equal(kernel.probability(q), kernel.probability(q, np.zeros_like(q)))
    assert kernel.probability(q[:0]).shape == (0, len(ROWS), len(scene.entities))
    lost = kernel.own_loss(q.reshape(3, 7, -1), qd.reshape(3, 7, -1))
    assert np.array_equal(lost, kernel.own_loss(q, qd).reshape(3, 7))


# --- costs in planners ------------------------------------------------------------------------------------------------


def test_impact_is_the_sum_over_entities(scene, kernel):
    q, qd = _states(scene, 40, seed=3)
    count = len(scene.entities)
    severity = np.random.default_rng(0).uniform(size=(len(ROWS), count)) * (np.arange(count) % 3 > 0)
    moving, still = (np.einsum("nre,re->n", kernel.probability(q, rates), severity) for rates in (qd, None))
    np.testing.assert_allclose(kernel.impact(q, severity, qd), moving, atol=1e-12)
    np.testing.assert_allclose(kernel.with_severity(severity).states(q), still, atol=1e-12)
    moving, still = moving + 3.0 * kernel.own_loss(q, qd), still + 3.0 * kernel.own_loss(q)
    np.testing.assert_allclose(kernel.impact(q, severity, qd, own=3.0), moving, atol=1e-12)
    np.testing.assert_allclose(kernel.with_severity(severity, own=3.0).states(q), still, atol=1e-12)
    alone = kernel.impact(q, np.zeros_like(severity), qd, own=1.0)
    np.testing.assert_allclose(alone, kernel.own_loss(q, qd), atol=1e-15)
    nothing = DropKernel(drop_tables(scene), SETTINGS.box, kernel.kernels, scene.limits.velocity, count)
    assert not nothing.own_loss(q).any() and not nothing.impact(q, np.zeros_like(severity), own=1.0).any()


def test_edges_are_evaluated_at_their_speed(scene):
    native = gp.Objective(impact=gp.ImpactCost(model="mixture")).bind(scene)
    generic = gp.Objective(impact=gp.ImpactCost(model=Wrapped())).bind(scene)
    assert native.kernel is not None and generic.kernel is None
    q0, q1 = _states(scene, 20, seed=4)[0], _states(scene, 20, seed=5)[0]
    q1[0] = q0[0]
    np.testing.assert_allclose(native.edges(q0, q1), generic.edges(q0, q1), rtol=2e-3)
    np.testing.assert_allclose(native.states(q0), native.kernel.states(q0), rtol=1e-9)
    assert np.all(native.edges(q0, q1)[0] == 0.0)


def test_planners_run_on_the_drop_model():
    task = gp.load_scene("tabletop").tasks["green_to_blue"]
    objective = gp.Objective(impact=gp.ImpactCost(model="mixture"), w=2.0).bind(task.scene)
    problem = SceneProblem(kernels=compile_scene(task.scene).kernels, start=task.start, goals=np.atleast_2d(task.goal))
    assert type(native_space(problem, objective)).__name__ == "SceneSpace"
    native = gp.plan(task.start, task.goal, task.scene, objective=objective.objective, iterations=250)
    assert native.path is not None
    assert native.cost.total == pytest.approx(objective.breakdown(native.trajectory).total, rel=1e-9)
    # A plan that ignores impact costs more under this objective.
    ordinary = gp.plan(task.start, task.goal, task.scene, 0.0, iterations=250)
    assert ordinary.path is not None and objective.breakdown(ordinary.trajectory).total > 1.05 * native.cost.total


def test_without_a_carried_object_there_is_no_harm():
    scene = gp.load_scene("tabletop")
    assert scene.carried is None
    objective = gp.Objective(impact=gp.ImpactCost(model="mixture")).bind(scene)
    q0, q1 = _states(scene, 5, seed=6)[0], _states(scene, 5, seed=7)[0]
    assert objective.kernel is not None
    assert not objective.edges(q0, q1)[:, 1].any() and not objective.states(q0).any()


@pytest.mark.parametrize("vase", ["", '<body name="vase" pos="0.1 0 0.2"><geom type="box" size="0.1 0.1 0.1"/></body>'])
def test_little_or_nothing_to_fall_on(vase):
    text = f"""<mujoco><worldbody>{vase}
      <body name="arm" pos="0 0 1"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><site name="tool"/>
        <joint name="a" axis="0 1 0" limited="true" range="-1 1"/><geom type="sphere" size="0.01"/></body>
      <body name="thing" pos="3 3 1"><freejoint/><geom type="sphere" size="0.03"/></body></worldbody></mujoco>"""
    limits = {"velocity": [1.0], "acceleration": [1.0], "X_TO": gp.FROM_ABOVE}
    entities = {"vase": "glass"} if vase else {}
    scene = gp.Scene.from_mjcf(text, robot="arm", tool="tool", carried="thing", entities=entities, **limits)
    q, qd = _states(scene, 9, seed=11)
    found = drop_kernel(scene, SETTINGS).probability(q, qd)
    np.testing.assert_allclose(found[:, 0], _numpy(scene, q, qd), atol=_P)
    lost = drop_kernel(scene, SETTINGS).own_loss(q, qd)
    np.testing.assert_allclose(lost, own_loss(moving_batch(scene, q, qd)), atol=_P)
    edges = gp.Objective(impact=gp.ImpactCost(model="mixture")).bind(scene).edges(q[:-1], q[1:])
    assert np.all(np.isfinite(edges)) and (edges[:, 1] > 0.0).all() == bool(vase)


# --- gradient ---------------------------------------------------------------------------------------------------------


def _difference(f, n, h):
    """Return fourth-order differences of f [n] along each axis of its argument; [n nq]."""
    steps = h * np.eye(n)
    return np.stack([(8 * (f(d) - f(-d)) - (f(2 * d) - f(-2 * d))) / (12 * h) for d in steps], axis=1)


def _check_gradient(kernel, q, qd, severity, own=0.7):
    impact, *gradients = kernel.gradient(q, severity, qd, own=own)
    np.testing.assert_allclose(impact, kernel.impact(q, severity, qd, own=own), atol=1e-12)
    assert np.ptp(impact) > 0.1

    def of(q, qd):
        return kernel.impact(q, severity, qd, own=own)

    impacts = (lambda d: of(q + d, qd), lambda d: of(q, qd + d))
    for gradient, f in zip(gradients, impacts, strict=True):
        # The model has kinks (edges of parts above edges of a surface); a smaller step does not cross them.
        found = [_difference(f, q.shape[1], h) for h in (1e-5, 1e-6, 1e-7)]
        assert np.min([np.abs(gradient - d) / (1.0 + np.abs(d)) for d in found], axis=0).max() < 1e-6


@pytest.mark.parametrize("name", first_quick(gp.scenes()))
def test_gradient_is_the_finite_difference(name):
    for k, task in enumerate(gp.load_scene(name).tasks.values()):
        scene, kernel = task.scene, drop_kernel(task.scene, SETTINGS)
        severity = np.random.default_rng(k).uniform(size=(len(ROWS), len(scene.entities)))
        q, qd = _states(scene, 40, seed=20 + k)
        q[-20:] = np.linspace(task.start, task.goal[0], 20) + 0.01 * q[:20]  # away from kinks of aligned objects
        _check_gradient(kernel, q, qd, severity)
        if np.ptp(kernel.own_loss(q, qd)) > 0.1:
            _check_gradient(kernel, q, qd, np.zeros_like(severity), own=1.0)


def test_gradient_where_the_parts_of_an_entity_share_the_first_impact():
    bars = "".join(f'<geom type="box" size="0.01 0.2 0.02" pos="{0.07 * k - 0.21} 0 0"/>' for k in range(7))
    text = f"""<mujoco><worldbody><body name="rack" pos="0 0 0.1">{bars}</body>
      <body name="arm" pos="0 0 0.5"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
        <joint name="x" type="slide" axis="1 0 0" range="-0.3 0.3"/>
        <joint name="y" type="slide" axis="0 1 0" range="-0.3 0.3"/><joint name="turn" axis="0 0.3 1" range="-1 1"/>
        <geom type="sphere" size="0.01"/><site name="tool" pos="0 0 -0.1"/></body>
      <body name="ball" pos="3 3 1"><freejoint/><geom type="sphere" size="0.04"/></body></worldbody></mujoco>"""
    scene = gp.Scene.from_mjcf(
        text, robot="arm", tool="tool", velocity=[1.0] * 3, acceleration=[1.0] * 3, entities={"rack": "robust"}
    ).attach("ball", X_TO=np.eye(4))
    q, qd = _states(scene, 60, seed=3)
    found = dropped(moving_batch(scene, q, qd))
    on_rack = drop_tables(scene).target_entity == 0
    assert (found.hit[:, on_rack].max(axis=1) < found.entity[:, 0] - 1e-3).sum() > 10
    kernel = drop_kernel(scene, SETTINGS)
    np.testing.assert_allclose(kernel.probability(q, qd)[:, 0], found.entity, atol=_P)
    _check_gradient(kernel, q, qd, np.ones((len(ROWS), 1)), own=0.0)


@pytest.mark.parametrize("name", first_quick(gp.scenes()))
@pytest.mark.parametrize("isa", instruction_sets())
def test_single_precision_changes_little(name, isa):
    for k, task in enumerate(gp.load_scene(name).tasks.values()):
        scene = task.scene
        kernel = _kernel_of(scene, isa)
        severity = kernel.severities(np.random.default_rng(k).uniform(size=(len(ROWS), len(scene.entities))), 0.7)
        q, qd = _states(scene, 200, seed=50 + k)
        exact, rough = (kernel.native.gradient(severity, q, qd, rough=rough) for rough in (False, True))
        assert np.ptp(exact[0]) > 0.1
        np.testing.assert_allclose(rough[0], exact[0], atol=1e-4)
        for mine, theirs in zip(rough[1:], exact[1:], strict=True):
            error = np.linalg.norm(mine - theirs, axis=1) / (1e-2 + np.linalg.norm(theirs, axis=1))
            assert np.median(error) < 2e-4
            assert np.quantile(error, 0.97) < 1e-2  # the others are at kinks


@pytest.mark.parametrize("scale", [0.0, 1.0, 30.0])
def test_single_precision_bears_extreme_speeds(scene, scale):
    kernel = drop_kernel(scene, SETTINGS)
    q, qd = _states(scene, 500, seed=3)
    severity = kernel.severities(np.full((len(ROWS), len(scene.entities)), 50.0), 50.0)
    for array in kernel.native.gradient(severity, q, scale * qd, rough=True):
        assert np.isfinite(array).all()


def test_the_cost_has_the_gradient_of_its_model(scene):
    check_cost(gp.ImpactCost(model="mixture"), scene)
    q, qd = _states(scene, 30, seed=10)
    speed = np.linalg.norm(qd, axis=1)
    batch = StateBatch(scene, q, qd / speed[:, None], speed)
    cost = gp.ImpactCost(model="mixture", components=("carried",))
    severity = np.zeros((len(ROWS), len(scene.entities)))
    severity[0] = cost.severity(scene).sum(axis=0)
    impact, by_q, _ = drop_kernel(scene, SETTINGS).gradient(q, severity, qd, own=scene.own_severity)
    np.testing.assert_allclose(cost.state(batch), impact, atol=1e-12)
    np.testing.assert_allclose(cost.gradient(batch), by_q, atol=1e-9)
    assert gp.ImpactCost(model="box_overlap").gradient(batch) is None
    assert gp.ImpactCost(model=Wrapped()).gradient(batch) is None
    without = gp.ImpactCost(model="mixture", components=("carried",), own_loss=False)
    impact, by_q, _ = drop_kernel(scene, SETTINGS).gradient(q, severity, qd)
    np.testing.assert_allclose(without.state(batch), impact, atol=1e-12)
    np.testing.assert_allclose(without.gradient(batch), by_q, atol=1e-9)
    free = gp.load_scene("tabletop")
    assert not gp.ImpactCost(model="mixture").gradient(StateBatch(free, _states(free, 3, seed=0)[0])).any()


def test_gradient_of_an_arm_with_slides_and_turns():
    limits = {"velocity": [1.0] * 4, "acceleration": [1.0] * 4, "X_TO": gp.FROM_ABOVE}
    entities = {"vase": "glass", "box": "robust"}
    scene = gp.Scene.from_mjcf(_ODD_ARM, robot="arm", tool="tool", carried="thing", entities=entities, **limits)
    kernel = drop_kernel(scene, SETTINGS)
    _check_gradient(kernel, *_states(scene, 100, seed=9), np.array([[1.0, 0.3], *[[0.0, 0.0]] * (len(ROWS) - 1)]))


# --- misuse -----------------------------------------------------------------------------------------------------------


def test_misuse_names_the_culprit(scene, kernel):
    q, qd = _states(scene, 3, seed=8)
    with pytest.raises(ShapeError, match="qd"):
        kernel.probability(q, qd[:2])
    with pytest.raises(ShapeError, match="qd"):
        kernel.probability(q, qd[:, :3])
    with pytest.raises(NonFiniteError, match="qd"):
        kernel.probability(q, np.full_like(qd, np.inf))
    with pytest.raises(ShapeError, match="severity"):
        kernel.impact(q, np.ones((2, len(scene.entities))))
    with pytest.raises(ShapeError, match="severity"):
        kernel.with_severity(np.ones((len(ROWS), len(scene.entities) + 1)))
    with pytest.raises(NonFiniteError, match="severity"):
        kernel.impact(q, np.ones((len(ROWS), len(scene.entities))), own=np.nan)
    with pytest.raises(ValueError, match="speed"):
        compiled, tables = compile_scene(scene), drop_tables(scene)
        constants = SETTINGS.of(tables.shape_class)
        DropKernel(tables, constants, compiled.kernels, np.zeros(len(scene.joints)), len(scene.entities))


def test_a_fit_with_many_constants_leaves_no_tables_behind(scene):
    shipped = DropSettings.shipped()
    watched = []
    for delay in np.linspace(0.0, 0.02, 12):
        constants = {name: replace(getattr(shipped, name), delay=float(delay)) for name in SHAPE_CLASSES}
        watched.append(weakref.ref(drop_kernel(scene, DropSettings(**constants))))
    gc.collect()
    assert 0 < sum(ref() is not None for ref in watched) <= 4
    assert drop_kernel(scene, shipped) is drop_kernel(scene, shipped)


def test_impacts_of_one_scene_add_up() -> None:
    scene = gp.load_scene("tabletop").tasks["lift_to_goal"].scene
    rng = np.random.default_rng(0)
    q0, q1 = (rng.uniform(*scene.limits.position.T, size=(40, len(scene.joints))) for _ in range(2))
    first, second = (gp.ImpactCost(model=model).kernel(scene, (0.3, 0.7)) for model in ("box_overlap", "mixture"))
    assert first is not None and second is not None
    both = first + second
    assert np.allclose(both.states(q0), first.states(q0) + second.states(q0), rtol=1e-12)
    edges = both.edges(q0, q1)
    assert np.array_equal(edges[:, 0], first.edges(q0, q1)[:, 0])
    assert np.allclose(edges[:, 1], first.edges(q0, q1)[:, 1] + second.edges(q0, q1)[:, 1], rtol=1e-12)
    other = gp.ImpactCost().kernel(gp.load_scene("tabletop_l1"), (0.3, 0.7))
    assert other is not None
    with pytest.raises(ValueError, match="different scenes"):
        first + other
