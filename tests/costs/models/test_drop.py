"""The drop model: laws, closed forms, the slow oracle, velocities against MuJoCo, unhappy paths."""

import math

import numpy as np
import pytest
from drop_oracle import release as slow_release
from drop_oracle import slow_drop
from drop_twin import catching, dropped
from hypothesis import given, settings
from hypothesis import strategies as st

import graceful_plan as gp
from graceful_plan.core.kernels import CAPACITY
from graceful_plan.costs.cost import StateBatch
from graceful_plan.costs.models.drop.constants import DropConstants, DropSettings
from graceful_plan.costs.models.drop.release import release
from graceful_plan.costs.models.drop.tables import LEVEL, SHAPE_CLASSES, drop_tables
from graceful_plan.costs.models.mixture.mixture import FailureMixture
from graceful_plan.exceptions import SceneError, SettingError
from sizes import first_quick

_TOLERANCE = 1e-9
"""The oracle uses the same formulas in another order of operations."""

_SHAPES = {
    "box": '<geom name="load" type="box" size="0.03 0.04 0.05"/>',
    "cylinder": '<geom name="load" type="cylinder" size="0.03 0.08"/>',
    "plate": '<geom name="load" type="cylinder" size="0.1 0.01"/>',
    "ball": '<geom name="load" type="sphere" size="0.04"/>',
}


def gantry(targets, shape="box", turn=0.0, shift=(0.0, 0.0), load=None):
    """An arm of three slides and a vertical hinge that holds an object above boxes; all rotated by `turn`."""
    bodies = "".join(
        f'<body name="{name}" pos="{x} {y} {z}"><geom name="{name}" {geom}/></body>'
        for name, (x, y, z, geom) in targets.items()
    )
    axes = (("x", "1 0 0"), ("y", "0 1 0"), ("z", "0 0 1"))
    joints = "".join(
        f'<joint name="{name}" type="slide" axis="{axis}" limited="true" range="-20 20"/>' for name, axis in axes
    )
    text = f"""<mujoco model="gantry"><compiler angle="radian"/><worldbody>
      <frame pos="{shift[0]} {shift[1]} 0" euler="0 0 {turn}">
        <geom name="ground" type="plane" size="0 0 1"/>{bodies}
        <body name="arm" pos="0 0 1"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>{joints}
          <body name="hand"><joint name="wrist" axis="0 0 1" limited="true" range="-7 7"/>
            <geom name="hand" type="sphere" size="0.01"/><site name="tool" pos="0 0 -0.2"/></body></body>
        <body name="object" pos="3 3 1"><freejoint/>{load or _SHAPES[shape]}</body>
      </frame></worldbody></mujoco>"""
    scene = gp.Scene.from_mjcf(
        text,
        robot="arm",
        tool="tool",
        velocity=[1.0] * 4,
        acceleration=[1.0] * 4,
        entities=dict.fromkeys(targets, "robust"),
    )
    X = np.eye(4)
    X[:3, 3] = [0.0, 0.0, -0.1]
    return scene.attach("object", X_TO=X)


def drop(scene, q, qd=None, settings=None):
    q = np.atleast_2d(np.asarray(q, float))
    qd = np.zeros_like(q) if qd is None else np.atleast_2d(np.asarray(qd, float))
    speed = np.linalg.norm(qd, axis=1)
    direction = np.divide(qd, speed[:, None], out=np.zeros_like(qd), where=speed[:, None] > 0.0)
    return dropped(StateBatch(scene, q, direction, speed), settings)


_FLOOR = {"floor": (0.0, 0.0, -0.05, 'type="box" size="3 3 0.05"')}
BOX = {"target": (0.0, 0.0, 0.1, 'type="box" size="0.05 0.05 0.1"')}


@pytest.fixture(scope="module")
def tasks():
    names = [("tabletop_l3", "green_to_blue"), ("kitchen_counter", "move_oil"), ("dining_table", "pass_bottle")]
    return [gp.load_scene(scene).tasks[task] for scene, task in names]


def random_states(task, n, seed):
    rng = np.random.default_rng(seed)
    goal = np.atleast_2d(task.goal)[0]
    q = task.start + rng.uniform(size=(n, 1)) * (goal - task.start) + rng.normal(scale=0.15, size=(n, 7))
    return q, rng.normal(scale=0.4, size=(n, 7))


# --- the oracle -----------------------------------------------------------------------------------------------------


def test_the_model_equals_the_slow_oracle(tasks):
    for seed, task in enumerate(tasks):
        q, qd = random_states(task, 6, seed)
        found = drop(task.scene, q, qd)
        for i in range(len(q)):
            first, entity = slow_drop(task.scene, DropSettings.shipped(), q[i], qd[i])
            np.testing.assert_allclose(found.entity[i], entity, atol=_TOLERANCE)
            np.testing.assert_allclose(found.first[i], first, atol=_TOLERANCE)


@pytest.mark.parametrize("shape", SHAPE_CLASSES)
def test_every_class_equals_the_slow_oracle(shape):
    solids = BOX | {
        "ball": (0.2, 0.1, 0.3, 'type="sphere" size="0.08"'),
        "rod": (-0.15, 0.1, 0.2, 'type="capsule" size="0.03 0.1" euler="0 1.5707963 0.4"'),
        "can": (0.0, -0.2, 0.1, 'type="cylinder" size="0.04 0.1"'),
        "egg": (0.2, -0.2, 0.1, 'type="ellipsoid" size="0.04 0.06 0.1"'),
    }
    scene = gantry(solids, shape)
    assert SHAPE_CLASSES[drop_tables(scene).shape_class] == shape
    rng = np.random.default_rng(1)
    q = np.column_stack([rng.uniform(-0.2, 0.2, (20, 2)), rng.uniform(-0.4, 0.0, 20), rng.uniform(-3, 3, 20)])
    qd = rng.normal(scale=0.5, size=(20, 4))
    found = drop(scene, q, qd)
    expected = [slow_drop(scene, DropSettings.shipped(), *state)[1] for state in zip(q, qd, strict=True)]
    np.testing.assert_allclose(found.entity, expected, atol=_TOLERANCE)
    assert found.entity.max() > 0.5


def test_velocities_equal_those_of_mujoco(tasks):
    for task in tasks:
        q, qd = random_states(task, 5, 7)
        speed = np.linalg.norm(qd, axis=1)
        state = release(StateBatch(task.scene, q, qd / speed[:, None], speed), drop_tables(task.scene))
        for i in range(len(q)):
            c, v, w, _ = slow_release(task.scene, q[i], qd[i])
            np.testing.assert_allclose(state.c[i], c, atol=1e-9)
            np.testing.assert_allclose(state.v[i], v, atol=1e-9)
            np.testing.assert_allclose(state.w[i], w, atol=1e-9)


# --- closed forms ---------------------------------------------------------------------------------------------------


def test_the_first_contact_with_a_box_is_the_stated_distribution():
    scene, rng = gantry(BOX), np.random.default_rng(0)
    k = DropSettings.shipped().box
    q, qd = np.array([0.085, 0.06, -0.3, 0.0]), np.array([-0.05, 0.02, 0.0, 0.0])
    # The object's centre is 0.3 below the slides' origin (z = 1), and its lower face 0.05 below the centre.
    h = 1.0 - 0.3 - 0.3 - 0.05 - 0.2
    t = math.sqrt(2.0 * 9.81 * 0.5 * (h + math.hypot(h, 0.01))) / 9.81
    x, y = q[:2] + qd[:2] * (t + k.delay)
    s = math.hypot(k.position_spread, k.velocity_spread * t)
    noise = rng.logistic(scale=s * math.sqrt(3.0) / math.pi, size=(4, 400_000))
    assert noise.std() == pytest.approx(s, rel=0.01)
    u, v = (x + y) / math.sqrt(2.0), (y - x) / math.sqrt(2.0)
    diagonal = 0.1 / math.sqrt(2.0) + 0.07 / math.sqrt(2.0)
    inside = np.abs(x + noise[0]) < 0.08
    inside &= (np.abs(y + noise[1]) < 0.09) & (np.abs(u + noise[2]) < diagonal) & (np.abs(v + noise[3]) < diagonal)
    found = drop(scene, q, qd).contact[0, 0]
    assert 0.2 < found < 0.9
    assert found == pytest.approx(inside.mean(), abs=0.004)


def test_an_object_dropped_squarely_on_a_box_hits_it_first():
    found = drop(gantry(BOX), [0.0, 0.0, -0.3, 0.0])
    assert found.first[0, 0] == pytest.approx(1.0, abs=1e-2)
    assert found.entity[0, 0] == pytest.approx(1.0, abs=1e-2)


def test_speed_carries_the_object_on():
    scene = gantry(BOX)
    h = 1.0 - 0.35 - 0.2
    ahead = -0.6 * (math.sqrt(2.0 * h / 9.81) + DropSettings.shipped().box.delay)
    assert drop(scene, [ahead, 0.0, 0.0, 0.0]).entity[0, 0] < 0.05
    assert drop(scene, [ahead, 0.0, 0.0, 0.0], [0.6, 0.0, 0.0, 0.0]).entity[0, 0] > 0.8


def test_a_higher_top_catches_the_object():
    low = {"low": (0.0, 0.0, 0.05, 'type="box" size="0.04 0.04 0.05"')}
    shelf = low | {"shelf": (0.0, 0.0, 0.3, 'type="box" size="0.4 0.4 0.01"')}
    assert drop(gantry(low), [0.0, 0.0, 0.0, 0.0]).entity[0, 0] > 0.8
    assert drop(gantry(shelf), [0.0, 0.0, 0.0, 0.0]).entity[0, 0] < 0.05


def test_tops_of_one_height_are_met_together():
    pair = {
        "left": (-0.05, 0.0, 0.1, 'type="box" size="0.04 0.05 0.1"'),
        "right": (0.05, 0.0, 0.1, f'type="box" size="0.04 0.05 {0.1 - 0.2 * LEVEL}"'),
    }
    found = drop(gantry(pair), [0.0, 0.0, -0.3, 0.0])
    assert found.contact[0, :2].min() > 0.8
    np.testing.assert_allclose(found.first[0, :2], 0.5, atol=0.02)


def test_an_entity_of_many_parts_is_hit_as_often_as_first_impacts_are_on_it():
    bars = "".join(
        f'<geom name="bar{k}" type="box" size="0.01 0.2 0.02" pos="{0.07 * k - 0.21} 0 {0.001 * k}"/>' for k in range(7)
    )
    rack = {"rack": (0.0, 0.0, 0.1, f'type="box" size="0.001 0.001 0.001"/>{bars[:-2]}')}
    scene = gantry(rack, shape="ball")
    found = drop(scene, [0.0, 0.0, -0.1, 0.0])
    assert found.hit.max() < 0.87
    on_rack = found.first[0, drop_tables(scene).target_entity == 0].sum()
    assert found.entity[0, 0] == pytest.approx(on_rack, abs=1e-12)
    assert on_rack > 0.9


# --- sides in the way -------------------------------------------------------------------------------------------------

_BEHIND = {"behind": (0.8, 0.0, 0.05, 'type="box" size="0.25 0.3 0.05"')}
_BEFORE = {"before": (0.2, 0.0, 0.05, 'type="box" size="0.15 0.3 0.05"')}


def _wall(height, x=0.4):
    return {"wall": (x, 0.0, height / 2.0, f'type="box" size="0.02 0.5 {height / 2.0}"')}


def _flown(targets, q, qd, start=-0.3):
    return dict(zip(targets, drop(gantry(targets), [*q, start, 0.0], [*qd, 0.0, 0.0]).entity[0], strict=True))


def test_an_object_flying_against_a_wall_hits_it_and_falls_in_front():
    open_, walled = _BEHIND | _BEFORE, _BEHIND | _BEFORE | _wall(1.0)
    free, stopped = (_flown(x, (0.2, 0.0), (1.5, 0.0)) for x in (open_, walled))
    assert free["behind"] > 0.9 and free["before"] < 0.3
    assert stopped["wall"] > 0.95 and stopped["before"] > 0.85 and stopped["behind"] < 0.05


def test_a_wall_below_or_behind_the_flight_has_no_effect():
    for wall in (_wall(0.2), _wall(1.0, x=-0.4)):
        free, found = (_flown(_BEHIND | x, (0.2, 0.0), (1.5, 0.0)) for x in ({}, wall))
        assert found["wall"] < 0.25 and found["behind"] == pytest.approx(free["behind"], abs=0.05)


def test_an_object_flying_along_a_wall_keeps_its_speed():
    ahead = {"ahead": (0.25, 0.6, 0.05, 'type="box" size="0.15 0.2 0.05"')}
    for across in (0.0, 1.0):
        targets = ahead | {"wall": (0.4, 0.5, 0.5, 'type="box" size="0.02 1.0 0.5"')}
        assert _flown(targets, (0.3, 0.0), (across, 1.6))["ahead"] > 0.9


def test_only_fixed_sides_stop_the_object():
    scene = gp.load_scene("desk").tasks["bring_coffee"].scene
    tables = drop_tables(scene)
    loose = np.array([name in ("laptop", "phone") for name in scene.entities])
    assert not tables.target_fixed[loose[tables.target_entity] & (tables.target_entity >= 0)].any()
    assert tables.target_fixed.any()


@pytest.mark.parametrize("half, ends", [(0.1, 0.5), (1e-3, 0.0), (1.0, 1.0)])
def test_wide_tops_end_nearly_all_falls(half, ends):
    tables = drop_tables(gantry({"top": (0.0, 0.0, 0.1, f'type="box" size="{half} 2 0.1"')}))
    constants, top = DropSettings.shipped().box, list(tables.target_entity).index(0)
    more = (catching(tables, constants)[top] - constants.catch) / (1.0 - constants.catch)
    assert more == pytest.approx(ends, abs=0.011)


@pytest.mark.parametrize("shape", ["cylinder", "box", "plate"])
def test_only_beyond_the_edges_of_a_wide_top_it_falls_to_the_floor(shape):
    scene = gantry({"desk": (0.0, 0.0, 0.3, 'type="box" size="0.8 0.8 0.02"'), **_FLOOR}, shape)
    floor = list(scene.entities).index("floor")
    height = -0.28  # the object is let go a few centimetres above the desk
    inside, edge, outside = (drop(scene, [x, 0.0, height, 0.0]).entity[0, floor] for x in (0.0, 0.78, 1.1))
    assert inside < 0.02 < edge < outside


def test_steep_boxes_hold_nothing():
    half = [
        drop_tables(gantry({"top": (0.0, 0.0, 0.3, f'type="box" size="0.2 0.2 0.01" euler="0 {slope} 0"')}))
        for slope in (0.0, 0.2, 0.45, 1.0)
    ]
    shares = [
        t.target_carries[list(t.target_entity).index(0)] / t.target_half[list(t.target_entity).index(0)] for t in half
    ]
    assert shares[0] == pytest.approx(1.0) and shares[1] == pytest.approx(1.0)
    assert 0.2 < shares[2][0] < 1.0 and shares[3] == pytest.approx(0.2)


def test_parts_of_a_finely_divided_object_are_merged_and_the_error_is_reported(caplog):
    at = np.random.default_rng(0).uniform(-0.08, 0.08, size=(60, 3))
    many = "".join(f'<geom type="box" size="0.006 0.005 0.004" pos="{x} {y} {z}"/>' for x, y, z in at)
    scene = gantry(BOX, load=f'<geom name="load" type="box" size="0.02 0.02 0.02"/>{many}')
    tables = drop_tables(scene)
    assert len(tables.part_half) == CAPACITY["carried parts"]
    (warning,) = caplog.records
    name, count, left, excess = warning.args
    assert (name, count, left) == ("object", 61, len(tables.part_half)) and 0.0 < excess < 100.0  # [mm]
    half = np.einsum("pij,pj->pi", np.abs(tables.part_rotation), tables.part_half)
    extent = (tables.part_offset + half).max(axis=0) - (tables.part_offset - half).min(axis=0)
    np.testing.assert_allclose(np.sort(extent), np.sort(np.ptp(at, axis=0) + [0.012, 0.01, 0.008]))
    drop_tables(gantry(BOX))
    assert caplog.records == [warning] and drop(scene, [0.0, 0.0, 0.0, 0.0]).entity[0, 0] > 0.8


# --- laws -----------------------------------------------------------------------------------------------------------

_state = st.tuples(*[st.floats(-0.3, 0.3)] * 2, st.floats(-0.5, 0.2), st.floats(-3.0, 3.0))
_speed = st.tuples(*[st.floats(-1.5, 1.5)] * 4)
_CROWD = BOX | {
    "tower": (0.12, 0.03, 0.2, 'type="box" size="0.03 0.03 0.2" euler="0 0 0.5"'),
    "can": (-0.11, 0.05, 0.1, 'type="cylinder" size="0.04 0.1"'),
    "mat": (0.0, 0.0, 0.005, 'type="box" size="0.5 0.3 0.005"'),
}


@pytest.fixture(scope="module")
def crowd():
    return gantry(_CROWD)


@given(q=_state, qd=_speed)
@settings(max_examples=25, deadline=None)
def test_probabilities_are_probabilities(crowd, q, qd):
    found = drop(crowd, q, qd)
    for value in (found.first, found.contact, found.hit, found.entity):
        assert value.min() >= 0.0 and value.max() <= 1.0
    assert found.first.sum() <= 1.0
    assert np.all(found.hit >= found.contact - 1e-12)


@given(turn=st.floats(-3.0, 3.0), shift=st.tuples(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0)), q=_state, qd=_speed)
@settings(max_examples=15, deadline=None)
def test_the_model_is_invariant_to_moving_the_world(crowd, turn, shift, q, qd):
    moved = drop(gantry(_CROWD, turn=turn, shift=shift), q, qd)
    np.testing.assert_allclose(moved.entity, drop(crowd, q, qd).entity, atol=1e-7)  # the ground ends 50 m away


@given(q=_state, qd=_speed)
def test_each_state_stands_alone(crowd, q, qd):
    others = np.random.default_rng(0).normal(scale=0.2, size=(3, 4))
    together = drop(crowd, np.vstack([others, q]), np.vstack([others, qd])).entity[-1]
    np.testing.assert_allclose(together, drop(crowd, q, qd).entity[0], atol=1e-12)


@pytest.mark.parametrize("shape", SHAPE_CLASSES)
def test_the_model_is_symmetric_at_rest(shape):
    row = {f"at{x}": (x, 0.0, 0.1, 'type="box" size="0.04 0.06 0.1"') for x in (-0.3, -0.1, 0.1, 0.3)}
    found = drop(gantry(row, shape), [0.0, 0.0, -0.3, 0.0]).entity[0]
    np.testing.assert_allclose(found, found[::-1], atol=1e-12)


def test_nothing_is_hit_from_far_away():
    found = drop(gantry(BOX), [[x, 0.0, 0.0, 0.0] for x in (0.3, 1.0, 3.0, 10.0)]).entity[:, 0]
    assert np.all(np.diff(found) <= 0.0)
    assert found[2] < 1e-6


@pytest.mark.parametrize("height", first_quick([0.0, 1e-4, 0.02, 0.2]))
def test_the_model_is_smooth_also_at_rest_and_without_height(crowd, height):
    """Both gradients, in q and velocity, equal central differences at two step sizes."""
    q0 = np.array([0.03, 0.02, -0.45 + height, 0.2])
    for direction in np.eye(4):

        def P(e, direction=direction):
            return drop(crowd, q0 + e * direction).entity[0]

        def Pv(e, direction=direction):
            return drop(crowd, q0, e * direction).entity[0]

        for f in (P, Pv):
            coarse, fine = ((f(e) - f(-e)) / (2.0 * e) for e in (2e-5, 1e-5))
            ahead, behind = (f(1e-6) - f(0.0)) / 1e-6, (f(0.0) - f(-1e-6)) / 1e-6
            np.testing.assert_allclose(coarse, fine, atol=2e-3)
            np.testing.assert_allclose(ahead, behind, atol=3e-2)


# --- as a model -----------------------------------------------------------------------------------------------------


def test_rows_of_components(tasks):
    task = tasks[2]
    q, qd = random_states(task, 3, 0)
    speed = np.linalg.norm(qd, axis=1)
    batch = StateBatch(task.scene, q, qd / speed[:, None], speed)
    P = FailureMixture().probability(batch)
    names = list(task.scene.components)
    assert P.shape == (3, len(names), len(task.scene.entities))
    np.testing.assert_array_equal(P[:, names.index("body")], 0.0)
    np.testing.assert_allclose(P[:, names.index("carried")], dropped(batch).entity, atol=1e-9)
    # For contents see test_spill_model.py.
    assert 0.0 < P[:, names.index("contents")].max() <= 1.0


def test_impact_cost_accepts_the_model_by_name(tasks):
    task = tasks[0]
    path = gp.Path(np.stack([task.start, np.atleast_2d(task.goal)[0]]))
    cost = gp.evaluate(path, task.scene, gp.Objective(impact=gp.ImpactCost(model="mixture"), w=1.0))
    assert 0.0 < cost.impact < math.inf


def test_without_an_object_nothing_falls():
    scene = gp.load_scene("tabletop")
    batch = StateBatch(scene, np.zeros((2, 7)))
    assert not FailureMixture().probability(batch).any()


def test_no_states_and_many_states(crowd):
    n = len(crowd.components), len(crowd.entities)
    assert FailureMixture().probability(StateBatch(crowd, np.zeros((0, 4)))).shape == (0, *n)
    q = np.random.default_rng(0).uniform(-0.2, 0.2, size=(3000, 4))
    whole = FailureMixture().probability(StateBatch(crowd, q))
    alone = FailureMixture().probability(StateBatch(crowd, q[:10]))
    np.testing.assert_allclose(whole[:10], alone, rtol=0.0, atol=1e-12)  # states share SIMD lanes


# --- constants ------------------------------------------------------------------------------------------------------


def _values(**change):
    return {name: getattr(DropSettings.shipped().box, name) for name in DropConstants.__dataclass_fields__} | change


@pytest.mark.parametrize(
    ("name", "value"),
    [("position_spread", 0.0), ("delay", -0.1), ("catch", 1.5), ("drift", math.nan), ("carry", math.inf)],
)
def test_constants_out_of_range_are_refused(name, value):
    with pytest.raises(SettingError, match=name):
        DropConstants(**_values(**{name: value}))


def test_broken_files_are_refused(tmp_path):
    file = tmp_path / "constants.yaml"
    file.write_text("version: 2\n")
    with pytest.raises(SceneError, match="only version 1"):
        DropSettings.load(file)
    file.write_text("version: 1\nshared: {delay: 0.1}\nclasses: {}\n")
    with pytest.raises(SceneError, match="needs the key"):
        DropSettings.load(file)
    file.write_text("version: 1\nshared: {speed: 0.1}\nclasses: {}\n")
    with pytest.raises(SceneError, match="unknown key 'speed'"):
        DropSettings.load(file)


def test_shipped_constants_have_a_provenance():
    settings_ = DropSettings.shipped()
    assert {settings_.of(i) for i in range(4)} == {settings_.box, settings_.cylinder, settings_.plate, settings_.ball}
