from dataclasses import replace
from functools import cache

import mujoco
import numpy as np
import pytest
from coast_twin import carried_hits, hits
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import erfc

import graceful_plan as gp
from graceful_plan.core import _native
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import Kernels, instruction_sets, reals
from graceful_plan.costs.cost import moving_batch
from graceful_plan.costs.models.failing_base import FailingBase
from graceful_plan.exceptions import SettingError
from graceful_plan.mobile.coast.coast import Coast
from graceful_plan.mobile.coast.constants import CoastSettings, OdometryDrift, Way
from graceful_plan.mobile.coast.four_wheel import one_sided_trajectories
from graceful_plan.mobile.coast.native import SKIDS, coasting_arrays, shape_arrays
from graceful_plan.mobile.coast.tables import coast_tables
from hall import BASE, hall

SCENE = hall()
SHIPPED = CoastSettings.shipped()


def only(**way):
    given = {"weight": 1.0, "deceleration": (1.0,), "drag": 0.0, "delay": (0.0,)} | way
    ways = replace(SHIPPED, ways={"only": Way(**given)}, position_spread=1e-3, drift=0.0)
    return ways.only("only")


def hit(x, v, *, y=0.8, yaw=0.0, omega=0.0, scene=SCENE, settings=SHIPPED):
    """Return P that the base, driving at x, hits the person, who stands at (2, 0.8) with a radius of 0.25 m."""
    q = np.array([[x, y, yaw]])
    qd = np.array([[v * np.cos(yaw), v * np.sin(yaw), omega]])
    return Coast(settings).probability(moving_batch(scene, q, qd))[0, 0, 0]


def states(n=400, seed=0):
    rng = np.random.default_rng(seed)
    q = np.column_stack([rng.uniform(-4, 4, n), rng.uniform(-1.5, 1.5, n), rng.uniform(-3, 3, n)])
    v, omega = rng.uniform(-2, 2, n), rng.uniform(-2, 2, n)
    return q, np.column_stack([v * np.cos(q[:, 2]), v * np.sin(q[:, 2]), omega])


def test_the_core_equals_the_twin():
    q, qd = states(80)
    cost = gp.ImpactCost(model=Coast())
    kernel = Coast().kernel(SCENE, cost.severity(SCENE), (1.0, 1.0))
    batch = moving_batch(SCENE, q, qd)
    P = hits(batch, coast_tables(SCENE), SHIPPED, SHIPPED.straightens)
    np.testing.assert_allclose(Coast().probability(batch)[:, 0], P, atol=1e-9)
    expected = P @ cost.severity(SCENE)[0]
    assert (expected > 0.1).sum() > 3
    np.testing.assert_allclose(cost.state(batch), expected, atol=1e-7)
    np.testing.assert_allclose(kernel.moving_states(q, qd), expected, atol=1e-7)
    value, by_q, _ = kernel.state_slopes(q, qd)
    np.testing.assert_allclose(value, expected, atol=1e-7)
    assert np.isfinite(by_q).all()


def states_in(scene, seed, n=150):
    rng = np.random.default_rng(seed)
    q, qd = np.zeros((2, n, len(scene.joints)))
    q[:, :2] = rng.uniform(*scene.limits.position[:2].T, (n, 2))
    q[:, 2], v = rng.uniform(-3, 3, n), rng.uniform(-1.0, 1.0, n) * scene.base.v_max
    qd[:, 0], qd[:, 1], qd[:, 2] = v * np.cos(q[:, 2]), v * np.sin(q[:, 2]), rng.uniform(-1, 1, n)
    return q, qd


CROWDED = [gp.load_scene("warehouse_aisle"), gp.load_scene("hallway").without_moving()]


@pytest.mark.parametrize("isa", instruction_sets())
@pytest.mark.parametrize("scene", CROWDED)
def test_instruction_sets_agree(scene, isa):
    """With several parts of a base, several entities, and shapes that hide behind each other."""
    q, qd = states_in(scene, 1)
    compiled = compile_scene(scene)

    def impact(isa):
        core = Kernels(compiled.robot, compiled.world, compiled.impact_tables, isa=isa).core
        model = _native.CoastModel(
            core, n_entity=len(scene.entities), **shape_arrays(scene), **coasting_arrays(scene, SHIPPED)
        )
        severity, speed = np.ones(2 * len(scene.entities)), reals(scene.limits.velocity)
        kernel = _native.CoastImpact(model, model, severity=severity, speed=speed, slow=1.0, fast=1.0)
        return model.probability(reals(q), reals(qd)), kernel.state_slopes(reals(q), reals(qd), False)

    (P, slopes), (expected, expected_slopes) = impact(isa), impact("auto")
    assert (expected > 0.01).sum() > 3
    np.testing.assert_allclose(P, expected, atol=1e-11)
    np.testing.assert_allclose(slopes[0], P.sum(axis=(1, 2)), atol=1e-10)
    for own, other in zip(slopes, expected_slopes, strict=True):
        np.testing.assert_allclose(own, other, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize(("scene", "n"), [(CROWDED[0], 20), (CROWDED[1], 50)])
def test_the_core_equals_the_twin_among_many_entities(scene, n):
    q, qd = states_in(scene, 2, n=n)
    batch = moving_batch(scene, q, qd)
    P = hits(batch, coast_tables(scene), SHIPPED, SHIPPED.straightens if scene.base.slip > SKIDS else 1e6)
    assert ((P > 1e-4).sum(axis=1) > 1).any()
    body = list(scene.components).index("body")
    np.testing.assert_allclose(Coast().probability(batch)[:, body], P, atol=1e-9)


KITCHEN = gp.load_scene("kitchen").tasks["carry_out"].scene


def states_with_a_pan(n, seed, scene=KITCHEN):
    rng = np.random.default_rng(seed)
    q = np.tile(scene.keyframes["ready"], (n, 1))
    q[:, :2], q[:, 2] = rng.uniform([0.8, 0.8], [4.8, 2.8], (n, 2)), rng.uniform(-3, 3, n)
    q[:, 4] = rng.uniform(-1.0, 1.0, n)  # the arm swings about the shoulder
    v, qd = rng.uniform(-1.0, 1.0, n) * (np.arange(n) % 4 > 0), np.zeros_like(q)
    qd[:, 0], qd[:, 1], qd[:, 2] = v * np.cos(q[:, 2]), v * np.sin(q[:, 2]), rng.uniform(-1.5, 1.5, n)
    return q, qd


def test_the_core_equals_the_twin_for_the_object_on_an_arm():
    q, qd = states_with_a_pan(80, 3)
    batch = moving_batch(KITCHEN, q, qd)
    P = carried_hits(batch, coast_tables(KITCHEN), SHIPPED, 1e6)
    assert (P > 1e-3).sum() > 20 and (P[::4] > 1e-3).any()  # also from turns in place
    carried = list(KITCHEN.components).index("carried")
    np.testing.assert_allclose(Coast().probability(batch)[:, carried], P, atol=1e-9)


def test_derivatives_with_an_object_on_the_arm_are_finite_differences():
    q, qd = states_with_a_pan(60, 4)
    severity = np.zeros((len(KITCHEN.components), len(KITCHEN.entities)))
    severity[list(KITCHEN.components).index("carried")] = 1.0
    kernel, right, n = Coast().kernel(KITCHEN, severity, (1.0, 1.0)), 0, 0
    _, by_q, by_qd = kernel.state_slopes(q, qd)
    for j in (0, 1, 2, 4):  # the base and the shoulder; how other joints tilt the object is not followed
        step = 1e-6 * np.eye(q.shape[1])[j]
        by_place = (kernel.moving_states(q + step, qd) - kernel.moving_states(q - step, qd)) / 2e-6
        by_speed = (kernel.moving_states(q, qd + step) - kernel.moving_states(q, qd - step)) / 2e-6
        for known, found in ((by_place, by_q), (by_speed, by_qd)):
            right += int(np.isclose(found[:, j], known, rtol=1e-4, atol=1e-4).sum())
            n += len(q)
        assert np.abs(by_place).max() > 0.1
    assert right >= 0.98 * n  # it has kinks: which touch decides, and the standing base


def test_an_object_on_the_arm_is_swung_into_entities_beside_the_base():
    """A wheel that locks turns the base about it, and the pan with an arm's length: farther than the base goes."""
    place = KITCHEN.data_at(KITCHEN.keyframes["ready"]).xpos[KITCHEN.model.body("child_head").id]
    q = KITCHEN.keyframes["ready"].copy()
    q[0], q[1], q[2] = place[0] - 0.75, place[1] - 0.75, 0.0
    qd = np.zeros_like(q)
    qd[0] = 0.8
    batch = moving_batch(KITCHEN, q[None], qd[None])
    index = list(KITCHEN.entities).index("child_head")
    rows = {name: Coast().probability(batch)[0, k, index] for k, name in enumerate(KITCHEN.components)}
    assert rows["carried"] > 0.01 > rows["body"]
    empty = KITCHEN.detach()
    assert not Coast().probability(moving_batch(empty, q[None], qd[None]))[0, 1:].any()


def test_an_object_on_a_deck_hits_what_stops_the_base():
    scene = gp.load_scene("apartment").tasks["bring_parcel"].scene
    person = gp.MovingEntity("ann", "adult", size=[0.25, 0.85], t=[0.0], position=[[3.0, 2.0, 0.85]])
    scene = scene.with_moving(person)
    rng, n = np.random.default_rng(0), 200
    q = np.column_stack([rng.uniform(0.5, 6.5, n), rng.uniform(0.5, 3.5, n), rng.uniform(-3, 3, n)])
    v = rng.uniform(-2, 2, n)
    qd = np.column_stack([v * np.cos(q[:, 2]), v * np.sin(q[:, 2]), rng.uniform(-2, 2, n)])
    batch, rows = moving_batch(scene, q, qd), list(scene.components)
    P = Coast().probability(batch)
    assert (P[:, 0] > 0.1).sum() > 10
    np.testing.assert_array_equal(P[:, rows.index("carried")], P[:, 0])
    severity = np.array([e.severity.get("body", 0.0) for e in scene.entities.values()])
    more = np.array([e.severity.get("carried", 0.0) for e in scene.entities.values()])
    table = np.zeros((len(rows), len(severity)))
    table[0], table[rows.index("carried")] = severity, more
    kernel = Coast().kernel(scene, table, (1.0, 1.0))
    np.testing.assert_allclose(kernel.moving_states(q, qd), P[:, 0] @ (severity + more), atol=1e-7)
    met = Coast().moving().sources(moving_batch(scene, q, qd, np.zeros(n)))["coast"]
    assert (met[:, 0] > 0.1).any()
    np.testing.assert_array_equal(met[:, rows.index("carried")], met[:, 0])


def test_cached_tables_are_read_and_broken_ones_recomputed(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    body = coast_tables(SCENE).body
    first = one_sided_trajectories.__wrapped__(body, SHIPPED)
    (file,) = (tmp_path / "graceful_plan").iterdir()
    np.testing.assert_array_equal(one_sided_trajectories.__wrapped__(body, SHIPPED).places, first.places)
    with np.load(file) as found:
        np.testing.assert_array_equal(found["values"], first.places)
    np.savez(file, values=np.full_like(first.places, np.nan))
    np.testing.assert_array_equal(one_sided_trajectories.__wrapped__(body, SHIPPED).places, first.places)


def test_the_outline_covers_the_geoms_and_shapes_are_at_its_height():
    tables = coast_tables(SCENE)
    chassis, *wheels = tables.outline
    np.testing.assert_allclose(chassis, [0, 0, 1, 0, 0.21, 0.155, 0], atol=1e-9)
    assert sorted(row[:2].round(4).tolist() for row in wheels) == [
        [x, y] for x in (-0.131, 0.131) for y in (-0.1878, 0.1878)
    ]
    assert len(tables.entity) == 4 and (tables.entity >= 0).sum() == 1  # walls, pillar, person; no floor


def test_a_round_base_is_round_and_hides_its_casters():
    fetch = coast_tables(gp.load_scene("kitchen")).outline
    assert fetch[0].tolist() == pytest.approx([0, 0, 1, 0, 0, 0, 0.288]) and len(fetch) == 2  # and the torso's corners


@given(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6), st.floats(-3, 3))
def test_a_hit_is_where_mujoco_has_the_geoms_touch(x, y, yaw):
    """A nearly static base and a box at a random pose: P is one half at a distance equal to the spread."""
    box = '<body name="box" pos="0 0 .1" euler="0 0 .4"><geom name="box" type="box" size=".3 .1 .1"/></body>'
    scene = boxed(box)
    q = np.array([x, y, yaw])
    data, fromto = scene.data_at(q), np.zeros(6)
    body = scene.model.body("cart/base").id
    mine = [g for g in range(scene.model.ngeom) if scene.model.geom_bodyid[g] == body]
    near = min(mujoco.mj_geomDistance(scene.model, data, g, scene.model.geom("box").id, 1.0, fromto) for g in mine)
    settings = replace(only(deceleration=(1e3,)), reference_speed=1e-5, position_spread=0.02)
    qd = 0.01 * np.array([[np.cos(yaw), np.sin(yaw), 0.0]])
    P = Coast(settings).probability(moving_batch(scene, q[None], qd))[0, 0, 0]
    if near > 0.0:
        assert P == pytest.approx(0.5 * erfc(near / 0.02 / np.sqrt(2.0)), abs=0.02)
    else:
        assert P >= 0.49


@cache
def boxed(box):
    """The hall with a box as the only entity."""
    return hall(walls="", extra=box, entities={"box": "adult"})


@pytest.mark.parametrize("v", [0.5, 1.0, 2.0])
def test_the_base_covers_the_closed_form_distance(v):
    settings = only(deceleration=(1.0,), delay=(0.2,))
    far = 0.2 * v + v**2 / 2.0
    front = 0.229  # front of the foremost disc, including wheels
    gap = 2.0 - 0.25 - front
    assert hit(gap - 0.85 * far, v, settings=settings) > 0.0
    assert hit(gap - 1.05 * far, v, settings=settings) < 1e-12


def test_drag_shortens_the_way():
    without, much = only(deceleration=(0.5,)), only(deceleration=(0.5,), drag=1.0)
    v, a, k = 2.0, 0.5, 1.0
    far = v / k - a / k**2 * np.log1p(k * v / a)
    x = 2.0 - 0.25 - 0.229 - 1.2 * far
    assert hit(x, v, settings=much) < 1e-12 < hit(x, v, settings=without)


def test_harm_grows_with_the_square_of_the_speed_up_to_that_of_the_table():
    settings = only(deceleration=(0.002,))
    slow, twice, fast = (hit(1.2, v, settings=settings) for v in (0.2, 0.4, 2.0))
    assert slow == pytest.approx(0.04, rel=0.25) and twice == pytest.approx(4 * 0.04, rel=0.25)
    assert fast == pytest.approx(1.0, abs=0.01)


SIDE = '<body name="side" pos="0 1 .5"><geom type="box" size="6 .05 .5"/></body>'


@pytest.mark.parametrize("angle", [0.3, 0.6, 1.0, np.pi / 2])
@pytest.mark.parametrize("backwards", [False, True])
def test_energy_counts_along_the_normal(angle, backwards):
    """The impact speed on a long side is the speed times the sine of the angle."""
    scene = hall(walls="", extra=SIDE, entities={"side": "adult"})
    settings, v = only(deceleration=(1e-4,), delay=(5.0,)), 0.8
    turned, v = (angle + np.pi, -v) if backwards else (angle, v)
    P = hit(-2.0, v, y=0.0, yaw=turned, scene=scene, settings=settings)
    assert P == pytest.approx((v * np.sin(angle)) ** 2, rel=0.02)


def test_grazed_entities_do_not_stop_the_base():
    behind = '<body name="behind" pos="2.6 0 .5"><geom type="cylinder" size=".25 .5"/></body>'
    names = {"person": "adult", "behind": "adult"}
    scene, settings = hall(walls="", extra=behind, entities=names), only(deceleration=(0.1,), delay=(2.0,))

    def second(y):
        q, qd = np.array([[0.0, y, 0.0]]), np.array([[1.0, 0.0, 0.0]])
        return Coast(settings).probability(moving_batch(scene, q, qd))[0, 0, 1]

    assert second(0.35) > 0.5  # the person's rim overlaps the base's side by 6 cm
    assert hit(0.0, 1.0, y=0.7, scene=scene, settings=settings) > 0.9 and second(0.7) == 0.0


@pytest.mark.parametrize("y", [0.2, 0.8])
def test_very_uncertain_entities_have_no_known_normal(y):
    """Half of the energy counts, both for passing and for driving straight at the entity."""
    settings = replace(only(deceleration=(1e-4,), delay=(5.0,)), position_spread=3.0)
    touched = hit(0.0, 0.5, y=y, settings=replace(settings, reference_speed=1e-6))
    assert hit(0.0, 0.5, y=y, settings=settings) / touched == pytest.approx(0.5 * 0.5**2, rel=0.05)


def astray():
    """Settings in which all failures are odometry drift, at rates that hardly turn the base."""
    lost = OdometryDrift(weight=1.0, misread=0.001 * BASE.track * BASE.slip, lasts=16.0, pace=1.0, spread=0.2)
    strong = replace(SHIPPED.weak, weight=0.0)
    return replace(
        SHIPPED, harmless=0.95, ways={}, astray=lost, weak=strong, position_spread=1e-3, reference_speed=1e-3
    )


def passing(settings, gap, v, scene=None, dt=0.005):
    """Return the sum over time of P along a straight path past the person, who stands to the left [s]."""
    scene = hall(walls="") if scene is None else scene
    t = np.arange(-2.0, 2.0, dt * abs(v)) / abs(v)
    q = np.column_stack(
        [2.0 + abs(v) * t, np.full(len(t), 0.8 - 0.25 - 0.2078 - gap), np.where(v < 0.0, np.pi, 0.0) + 0.0 * t]
    )
    qd = np.column_stack([np.full(len(t), abs(v)), np.zeros((len(t), 2))])
    P = Coast(settings).probability(moving_batch(scene, q, qd))[:, 0, 0]
    return float(P.sum() * dt)


@pytest.mark.parametrize("gap", [0.02, 0.1, 0.2])
@pytest.mark.parametrize("v", [0.05, -0.05, 0.2])
def test_passed_entities_are_hit_by_drifting_bases(gap, v):
    """After 2, 6, 10 or 14 s of drift at 2 m/s, the base is 1 to 39 cm aside, on either side."""
    way = 2.0 * np.array([2.0, 6.0, 10.0, 14.0])
    aside = 0.001 * way**2 / 2.0
    met = 0.5 * erfc((gap - aside) / np.hypot(1e-3, 0.2 * aside) / np.sqrt(2.0))
    expected = 0.05 * 16.0 * met.mean() / 2.0
    assert passing(astray(), gap, v) == pytest.approx(expected, rel=0.1)


def test_without_drift_odometry_failures_take_its_weight():
    seen = SHIPPED.without_drift()
    total = sum(way.weight for way in SHIPPED.ways.values()) + SHIPPED.astray.weight
    assert seen.weak == SHIPPED.weak
    assert sum(way.weight for way in seen.ways.values()) == pytest.approx(total) and seen.astray.weight == 0.0
    assert {name for name, way in seen.ways.items() if way != SHIPPED.ways[name]} == {"odometry"}
    assert only().without_drift() == only()


def weak(harmless=0.9, **change):
    """All failures weaken the drives, and any touch counts in full."""
    found, none = replace(SHIPPED.weak, deceleration=1e3, **change), replace(SHIPPED.astray, weight=0.0)
    settings = replace(SHIPPED, harmless=harmless, ways={}, astray=none, weak=found)
    return replace(settings, position_spread=1e-3, drift=0.0, reference_speed=1e-3)


@pytest.mark.parametrize("v", [1.0, -1.0])
def test_a_base_that_cannot_turn_goes_straight_on_where_its_path_turns(v):
    ahead = {"yaw": 0.0 if v > 0.0 else np.pi, "settings": weak()}
    assert hit(1.2, v, omega=0.0, **ahead) == 0.0  # its path leads there, and the judge would object
    each = 0.1 * SHIPPED.weak.lasts / SHIPPED.weak.turn
    for gap, reach in ((0.3, 1.0), (0.7, 0.75), (2.2, 0.25), (2.8, 0.0)):  # those with so many seconds left
        for omega in (0.5, -1.0):
            P = hit(2.0 - 0.25 - 0.229 - gap, v, omega=omega, **ahead)
            assert P == pytest.approx(reach * abs(omega) * each, rel=1e-3, abs=1e-9)
    assert hit(1.2, v, omega=0.5, **ahead, scene=hall(replace(BASE, slip=1.0))) == 0.0  # two wheels turn without effort


def test_in_a_turn_a_base_that_cannot_turn_leaves_its_path_once_per_angle():
    """Wherever it leaves, it comes to a wall all round; on the path of a turn by a right angle."""
    sides = ((2.0, 0.0), (-2.0, 0.0), (0.0, 2.0), (0.0, -2.0))
    walls = "".join(
        f'<geom type="box" size="{0.1 if x else 2} {0.1 if y else 2} .5" pos="{x} {y} 0"/>' for x, y in sides
    )
    scene = hall(walls="", extra=f'<body name="fence" pos="0 0 .5">{walls}</body>', entities={"fence": "adult"})
    omega, turned = 0.8, np.linspace(0.0, np.pi / 2.0, 200)
    q = np.column_stack([-np.sin(turned), np.cos(turned) - 1.0, np.pi + turned])  # away from the person
    qd = omega * np.column_stack([-np.cos(turned), -np.sin(turned), np.ones(len(turned))])
    settings = weak(harmless=0.99, lasts=40.0, turn=2.0)
    P = Coast(settings).probability(moving_batch(scene, q, qd))[:, 0, 0]
    left = np.trapezoid(P, turned / omega)
    assert left == pytest.approx(0.01 * settings.weak.lasts * (np.pi / 2.0) / settings.weak.turn, rel=0.02)


def test_walls_stop_drifting_bases():
    wall = '<body name="wall" pos="2 0.45 .5"><geom type="box" size="4 .06 .5"/></body>'
    assert passing(astray(), 0.2, 0.05, hall(walls="", extra=wall)) < 0.1 * passing(astray(), 0.2, 0.05)


def test_astray_harm_grows_with_the_square_of_the_speed_and_more_with_nearness():
    settings = replace(astray(), reference_speed=1.0)
    slow, fast = (passing(settings, 0.1, v) for v in (0.1, 0.4))
    assert fast == pytest.approx(16.0 * slow, rel=0.05)
    near, far = (passing(astray(), gap, 0.1) for gap in (0.1, 0.7))
    assert far < 0.1 * near


@given(st.floats(-4, 4), st.floats(-1.4, 1.4), st.floats(-3, 3), st.floats(-2, 2), st.floats(-2, 2))
def test_probabilities_are_probabilities_and_standing_is_safe(x, y, yaw, v, omega):
    assert 0.0 <= hit(x, v, y=y, yaw=yaw, omega=omega) <= 1.0 + 1e-12  # a sum of shares
    assert hit(x, 0.0, y=y, yaw=yaw, omega=omega) == 0.0


def test_reversing_is_driving_the_other_way():
    ahead = hit(0.0, 1.5)
    assert ahead > 0.05 and hit(0.0, 1.5, yaw=np.pi) < 1e-12
    assert hit(0.0, -1.5, yaw=np.pi) == pytest.approx(ahead, rel=1e-6)


def test_hits_on_arcs_are_at_the_right_place():
    settings = only(deceleration=(0.5,))
    # From (1, -0.2), heading to +y on an arc of 1 m to the right, it comes to the person at (2, 0.8).
    assert hit(1.0, 1.5, y=-0.2, yaw=np.pi / 2, omega=-1.5, settings=settings) > 0.3
    assert hit(1.0, 1.5, y=-0.2, yaw=np.pi / 2, omega=1.5, settings=settings) < 1e-12


def test_a_skid_steer_goes_straight_on_once_its_wheels_are_let_go():
    settings = only(deceleration=(0.5,), wheels="released")
    on_the_arc = {"y": -0.2, "yaw": np.pi / 2, "omega": -1.5, "settings": settings}
    assert hit(1.0, 1.5, **on_the_arc) < 1e-6
    assert hit(1.0, 1.5, **on_the_arc, scene=hall(replace(BASE, slip=1.0))) > 0.3
    assert hit(1.7, 1.5, y=-0.6, yaw=np.pi / 2, omega=0.3, settings=settings) > 0.05


def test_walls_stop_the_base():
    shield = '<body name="shield" pos="1 .8 .5"><geom type="box" size=".05 .6 .5"/></body>'
    assert hit(0.0, 2.0) > 0.1
    assert hit(0.0, 2.0, scene=hall(extra=shield)) < 1e-4


def test_by_default_all_failures_of_a_base_without_an_arm_are_its_own():
    fetch = gp.load_scene("kitchen")
    assert SHIPPED.of_base(fetch) == SHIPPED.share and SHIPPED.of_cargo(fetch) == 1.0 - SHIPPED.share
    assert SHIPPED.of_base(SCENE) == 1.0 and SHIPPED.of_cargo(SCENE) == SHIPPED.thrown
    q, qd = states()
    batch = moving_batch(SCENE, q, qd)
    coast = gp.ImpactCost(model=Coast()).state(batch)
    np.testing.assert_allclose(gp.ImpactCost().state(batch), coast, atol=1e-12)
    sources = gp.ImpactCost().sources(batch)
    assert set(sources) == {"drop", "spill", "stop", "coast"} or "coast" in sources
    kernel = gp.Objective(w=1.0).bind(SCENE).kernel
    edge = kernel.edges(q[:50], q[:50] + 0.1 * qd[:50])
    assert (edge[:, 1] >= 0.0).all() and edge[:, 1].max() > 0.0


class Doubtful(FailingBase):
    """A custom model: the shipped one plus half of it."""

    coast = Coast()

    def of_base(self, scene):
        return 0.5

    def of_cargo(self, scene):
        return 0.5

    def worth(self, speed):
        return self.coast.worth(speed)

    def probability(self, batch):
        return self.coast.probability(batch)

    def meeting(self, scene):
        return self.coast.meeting(scene)

    def kernel(self, scene, severity, paces):
        return self.coast.kernel(scene, severity, paces)

    def gradients(self, batch, severity):
        return self.coast.gradients(batch, severity)


def test_a_custom_model_of_failing_bases_counts_in_states_searches_and_descents():
    q, qd = states()
    batch = moving_batch(SCENE, q, qd)
    shipped, own = (gp.ImpactCost(model=gp.FailureMixture(base=base)) for base in (None, Doubtful()))
    assert shipped.state(batch).max() > 0.0
    np.testing.assert_allclose(own.state(batch), 0.5 * shipped.state(batch), atol=1e-12)
    np.testing.assert_allclose(own.gradient(batch), 0.5 * shipped.gradient(batch), atol=1e-9)
    one, other = (gp.Objective(impact=cost, w=1.0).bind(SCENE).edges(q[:50], q[:50] + 0.1) for cost in (shipped, own))
    np.testing.assert_allclose(other[:, 1], 0.5 * one[:, 1], atol=1e-12)


def test_settings_alone_are_no_model_of_how_bases_fail():
    model = gp.FailureMixture()
    object.__setattr__(model, "base", SHIPPED)  # past the type checks, which users do not have
    with pytest.raises(SettingError, match=r"base = .*Coast\(settings\)"):
        model.__post_init__()


def test_a_robot_that_stands_still_has_no_base_to_fear():
    scene = hall(None)
    batch = moving_batch(scene, *states())
    assert not Coast().probability(batch).any()
    assert gp.ImpactCost().counted(scene) == ("carried", "contents")
    assert not gp.ImpactCost(model=Coast()).state(batch).any()


def test_gradients_are_those_of_differences():
    q, qd = states(60, seed=3)
    severity = gp.ImpactCost(model=Coast()).severity(SCENE)
    by_q, by_qd = Coast().gradients(moving_batch(SCENE, q, qd), severity)
    kernel = Coast().kernel(SCENE, severity, (1.0, 1.0))

    def value(q, qd):
        return kernel.state_slopes(q, qd)[0]

    for j in range(3):
        e = 1e-6 * np.eye(3)[j]
        differences = (value(q + e, qd) - value(q - e, qd)) / 2e-6, (value(q, qd + e) - value(q, qd - e)) / 2e-6
        assert max(np.abs(of).max() for of in differences) > 0.1
        np.testing.assert_allclose(by_q[:, j], differences[0], rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(by_qd[:, j], differences[1], rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize(
    "change",
    [
        {"share": 1.5},
        {"harmless": 1.0},
        {"reference_speed": 0.0},
        {"position_spread": np.nan},
        {"drift": -1.0},
        {"ways": {}, "astray": replace(SHIPPED.astray, weight=0.0), "weak": replace(SHIPPED.weak, weight=0.0)},
    ],
)
def test_settings_are_checked(change):
    with pytest.raises(SettingError):
        replace(SHIPPED, **change)
    for lost in ({"weight": -1.0}, {"misread": np.nan}, {"lasts": np.inf}, {"pace": 1.1}, {"spread": -0.1}):
        with pytest.raises(SettingError, match=f"astray.{next(iter(lost))}"):
            replace(SHIPPED.astray, **lost)
    for tired in ({"weight": -1.0}, {"lasts": np.nan}, {"turn": 0.0}, {"deceleration": 0.0}):
        with pytest.raises(SettingError, match=f"weak.{next(iter(tired))}"):
            replace(SHIPPED.weak, **tired)
    for way in ({"weight": -1.0}, {"deceleration": ()}, {"delay": (-1.0,)}, {"drag": np.inf}, {"steered": True}):
        with pytest.raises(SettingError):
            only(**way)


@pytest.mark.long
def test_slow_near_people():
    assert BASE.v_max == 2.0
    asked = ((0.0, 4000), (0.3, 4000))
    fast, careful = (gp.plan("west", [4.0, 0.8, 0.0], SCENE, w=w, iterations=n) for w, n in asked)
    objective = gp.Objective(w=1.0)
    harm = [gp.evaluate(result.trajectory, SCENE, objective).impact for result in (fast, careful)]
    assert harm[1] < 0.25 * harm[0]  # 0.229 measured
    assert careful.trajectory.duration < 1.3 * fast.trajectory.duration  # 1.257 measured
