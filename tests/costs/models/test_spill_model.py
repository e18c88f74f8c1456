"""The spill model: the slow oracle, laws, simple spills, the core, unhappy paths."""

import dataclasses
from dataclasses import asdict, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spill_oracle import slow_spill
from spill_twin import pour, spread_out

import graceful_plan as gp
from graceful_plan.core.compile import compile_scene
from graceful_plan.costs.cost import StateBatch
from graceful_plan.costs.models.drop.constants import DropSettings
from graceful_plan.costs.models.drop.kernel import ROWS, SPILL_CONSTANTS, DropKernel, drop_kernel
from graceful_plan.costs.models.drop.tables import drop_tables
from graceful_plan.costs.models.spill.constants import USES, SpillConstants, SpillSettings
from graceful_plan.costs.models.spill.tables import spill_tables
from graceful_plan.exceptions import SceneError, SettingError

DROP, SPILL = DropSettings.shipped(), SpillSettings.shipped()
TASKS = [("desk", "bring_coffee"), ("dining_table", "serve_stew"), ("kitchen_counter", "shelve_jar")]
_CUP = """<geom name="cup" type="cylinder" size="0.04 0.05"/>
  <geom name="object_contents" type="cylinder" size="0.04 0.03" pos="0 0 -0.02" contype="0" conaffinity="0"/>"""


def gantry(targets, contents, turn=0.0, shift=(0.0, 0.0)):
    """An arm of three slides and a hinge that holds a cup above boxes; all rotated and shifted."""
    bodies = "".join(
        f'<body name="{name}" pos="{x} {y} {z}"><geom name="{name}" {geom}/></body>'
        for name, (x, y, z, geom) in targets.items()
    )
    joints = "".join(
        f'<joint name="{name}" type="slide" axis="{axis}" limited="true" range="-20 20"/>'
        for name, axis in (("x", "1 0 0"), ("y", "0 1 0"), ("z", "0 0 1"))
    )
    text = f"""<mujoco model="gantry"><compiler angle="radian"/><worldbody>
      <frame pos="{shift[0]} {shift[1]} 0" euler="0 0 {turn}">
        <geom name="ground" type="plane" size="0 0 1"/>{bodies}
        <body name="arm" pos="0 0 1"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>{joints}
          <body name="hand"><joint name="wrist" axis="0 1 0" limited="true" range="-4 4"/>
            <geom name="hand" type="sphere" size="0.01"/><site name="tool" pos="0 0 -0.2"/></body></body>
        <body name="object" pos="3 3 1"><freejoint/>{_CUP}</body>
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
    return scene.attach("object", X_TO=X, contents=contents)


CUP_OF_TEA = gp.Liquid(volume=0.25)
TABLE = {
    "table": (0.0, 0.0, 0.25, 'type="box" size="0.6 0.6 0.25"'),
    "phone": (0.15, 0.0, 0.505, 'type="box" size="0.05 0.03 0.005"'),
    "lamp": (0.0, 0.15, 0.6, 'type="cylinder" size="0.03 0.1"'),
    "bag": (0.75, 0.0, 0.05, 'type="box" size="0.1 0.1 0.05"'),
    "far": (9.0, 0.0, 0.5, 'type="box" size="0.1 0.1 0.5"'),
}


def reached(scene, q, qd=None, spill=SPILL):
    """Return P [n, use, entity] from the core."""
    q = np.atleast_2d(np.asarray(q, float))
    qd = np.zeros_like(q) if qd is None else np.atleast_2d(np.asarray(qd, float))
    return drop_kernel(scene, DROP, spill).probability(q, qd)[:, 1 : 1 + len(USES)]


def moving(scene, q, qd):
    speed = np.linalg.norm(qd, axis=1)
    return StateBatch(scene, q, qd / np.where(speed > 0.0, speed, 1.0)[:, None], speed)


def numpy_reached(scene, q, qd, spill=SPILL):
    batch = moving(scene, q, qd)
    tables, more = drop_tables(scene), spill_tables(scene)
    poured = pour(batch, tables, more, DROP.of(tables.shape_class))
    P = np.zeros((len(q), len(USES), len(scene.entities)))
    for row, use in enumerate(USES):
        hit = spread_out(tables, more, spill.of(use), poured)
        for k, owner in enumerate(tables.target_entity):
            if owner >= 0:
                P[:, row, owner] = np.maximum(P[:, row, owner], hit[:, k])
    return P


def states(scene, n, seed, fastest=1.5):
    rng = np.random.default_rng(seed)
    q = rng.uniform(*scene.limits.position.T, size=(n, len(scene.joints)))
    return q, scene.limits.velocity * rng.uniform(-1.0, 1.0, q.shape) * rng.uniform(0.0, fastest, (n, 1))


@pytest.fixture(scope="module")
def scenes():
    return [gp.load_scene(scene).tasks[task].scene for scene, task in TASKS]


@pytest.fixture(scope="module")
def table():
    return gantry(TABLE, CUP_OF_TEA)


# --- the specification ------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_the_model_equals_the_slow_oracle(scenes, table):
    for seed, scene in enumerate([*scenes, table]):
        q, qd = states(scene, 6, seed)
        if scene is table:
            q *= 0.05
        expected = [
            [slow_spill(scene, DROP, SPILL.of(use), *state) for use in USES] for state in zip(q, qd, strict=True)
        ]
        np.testing.assert_allclose(numpy_reached(scene, q, qd), expected, atol=1e-9)
        assert np.max(expected) > 0.3


@pytest.mark.parametrize("name", ["desk", "dining_table", "kitchen_counter"])
def test_the_core_is_the_specification(name):
    for seed, task in enumerate(gp.load_scene(name).tasks.values()):
        if task.scene.contents is not None:
            q, qd = states(task.scene, 120, seed)
            q[-40:], qd[-20:] = np.linspace(task.start, task.goal[0], 40), 0.0
            np.testing.assert_allclose(reached(task.scene, q, qd), numpy_reached(task.scene, q, qd), atol=1e-10)


@given(seed=st.integers(0, 10_000), scale=st.floats(1.1, 4.0), fastest=st.floats(0.0, 20.0))
def test_constants_of_all_sizes(scenes, seed, scale, fastest):
    rng, scene = np.random.default_rng(seed), scenes[seed % len(scenes)]
    odd = SpillConstants(**{name: x * scale ** rng.uniform(-1.0, 1.0) for name, x in asdict(SPILL.dropped).items()})
    spill = replace(SPILL, held=odd)
    q, qd = states(scene, 30, seed, fastest)
    found = reached(scene, q, qd, spill)
    np.testing.assert_allclose(found, numpy_reached(scene, q, qd, spill), atol=1e-9)
    assert found.min() >= 0.0 and found.max() <= 1.0


def test_constants_are_handed_over_by_name():
    assert set(SPILL_CONSTANTS) == {field.name for field in dataclasses.fields(SpillConstants)}
    assert ROWS == ("carried", *USES, "stopped")


# --- laws -------------------------------------------------------------------------------------------------------------


def test_without_contents_there_is_no_spill():
    scene = gp.load_scene("tabletop").tasks["green_to_blue"].scene
    assert scene.contents is None
    found = drop_kernel(scene, DROP).probability(*states(scene, 50, seed=0))
    assert not found[:, 1:].any() and found[:, 0].any()


def test_nothing_below_is_reached_by_nothing():
    scene = gantry({}, CUP_OF_TEA)
    assert reached(scene, np.zeros((3, 4))).shape == (3, 2, 0)


@given(turn=st.floats(-3.0, 3.0), x=st.floats(-2.0, 2.0), y=st.floats(-2.0, 2.0), seed=st.integers(0, 99))
@settings(max_examples=10, deadline=None)
def test_the_model_is_invariant_to_turning_the_world(table, turn, x, y, seed):
    q, qd = states(table, 8, seed)
    q *= 0.05
    moved = gantry(TABLE, CUP_OF_TEA, turn, (x, y))
    np.testing.assert_allclose(reached(moved, q, qd), reached(table, q, qd), atol=1e-9)


def test_far_away_stays_dry(table):
    q = np.zeros((1, 4))
    assert reached(table, q)[0, :, list(TABLE).index("far")].max() < 1e-12
    q[0, 0] = 9.0
    assert reached(table, q)[0, :, : list(TABLE).index("far")].max() < 1e-9


def test_an_entity_without_severity_changes_nothing(table):
    q, qd = states(table, 20, seed=3)
    q *= 0.05
    kernel = drop_kernel(table, DROP)
    severity = np.ones((len(ROWS), len(TABLE)))
    severity[:, 2] = 0.0
    P = kernel.probability(q, qd)
    np.testing.assert_allclose(kernel.impact(q, severity, qd), P.sum(axis=(1, 2)) - P[:, :, 2].sum(axis=1), atol=1e-12)
    for row in range(len(ROWS)):
        one = np.zeros_like(severity)
        one[row] = 1.0
        np.testing.assert_allclose(kernel.impact(q, one, qd), P[:, row].sum(axis=1), atol=1e-12)
        assert P[:, row].any()


def test_more_severity_never_lowers_the_impact(table):
    q, qd = states(table, 20, seed=4)
    q *= 0.05
    kernel, rng = drop_kernel(table, DROP), np.random.default_rng(0)
    low = rng.uniform(size=(len(ROWS), len(TABLE)))
    assert np.all(kernel.impact(q, low + rng.uniform(size=low.shape), qd) >= kernel.impact(q, low, qd))


# --- simple spills ----------------------------------------------------------------------------------------------------


def test_a_dropped_cup_wets_the_table_and_near_entities(table):
    P = dict(zip(TABLE, reached(table, [0.0, 0.0, 0.5, 0.0])[0, 0], strict=True))
    assert P["table"] > 0.9 and P["phone"] > 0.4 and P["lamp"] > 0.4 and P["bag"] < 0.1


def test_liquid_over_the_edge_falls_below(table):
    bag = list(TABLE).index("bag")
    middle, edge = reached(table, [[0.0, 0.0, 0.5, 0.0], [0.5, 0.0, 0.5, 0.0]])[:, 0, bag]
    assert edge > 0.3 and middle < 0.1 * edge


def test_set_down_gently_nothing_is_spilled(table):
    low, high = reached(table, [[0.0, 0.0, -0.15, 0.0], [0.0, 0.0, 0.5, 0.0]])
    assert high[0].max() > 0.9 and low[0].max() < 0.6 * high[0].max()
    assert low[1].max() > 0.8  # spills in the gripper do not depend on height


def test_contents_fly_on(table):
    fast = np.array([1.0, 0.0, 0.0, 0.0])
    phone, lamp = (list(TABLE).index(name) for name in ("phone", "lamp"))
    start = [-0.5, 0.0, 0.3, 0.0]
    still, flown = reached(table, start)[0, 0], reached(table, start, fast)[0, 0]
    assert flown[phone] > still[phone] + 0.3 and flown[lamp] > still[lamp]


def test_more_reaches_farther_and_dry_contents_stay_in_a_heap():
    q = [-0.2, 0.0, 0.5, 0.0]
    phone = list(TABLE).index("phone")
    little, much, rice = (
        reached(gantry(TABLE, contents), q)[0, 0, phone]
        for contents in (gp.Liquid(volume=0.05), gp.Liquid(volume=0.4), gp.Granular(volume=0.4))
    )
    assert much > 2.0 * little and much > 2.0 * rice and much > 0.1


def test_a_tilted_cup_holds_less(table):
    phone = list(TABLE).index("phone")
    q = np.zeros((3, 4))
    q[:, 2], q[:, 3], q[:, 0] = 0.5, [0.0, 0.6, 1.2], 0.2 * np.sin([0.0, 0.6, 1.2]) - 0.2
    upright, tilted, lying = reached(table, q)[:, 1, phone]
    assert upright > 1.1 * tilted > 1.2 * lying


def test_the_core_uses_the_spill_model_for_contents(scenes):
    scene = scenes[0]
    q, qd = states(scene, 10, seed=5)
    found = gp.interaction_probability(q, scene, "mixture", qd)
    row = list(scene.components).index("contents")
    np.testing.assert_allclose(found[:, row], reached(scene, q, qd)[:, 0], atol=1e-12)


# --- misuse -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value"),
    [("position_spread", 0.0), ("soft_spread", -1.0), ("reach", -0.1), ("carry", np.nan), ("soft_speed", np.inf)],
)
def test_constants_out_of_range_are_named(name, value):
    with pytest.raises(SettingError, match=name):
        replace(SPILL.dropped, **{name: value})


def test_soft_speed_may_be_negative():
    assert replace(SPILL.dropped, soft_speed=-3.0).soft_speed == -3.0


def test_broken_files_are_named(tmp_path):
    file = tmp_path / "spill.yaml"
    file.write_text("version: 2\nprovenance: none\ndropped: {}\nheld: {}\n", encoding="utf-8")
    with pytest.raises(SceneError, match="version 1"):
        SpillSettings.load(file)
    file.write_text("version: 1\nprovenance: none\ndropped: {}\nheld: {}\n", encoding="utf-8")
    with pytest.raises(SceneError, match="position_spread"):
        SpillSettings.load(file)


def test_tables_that_do_not_fit_are_refused(table):
    tables, more = drop_tables(table), spill_tables(table)
    for broken in (dict(stands=more.stands + 99), dict(radius=0.0)):
        fields = {field.name: getattr(more, field.name) for field in dataclasses.fields(more)}
        with pytest.raises(ValueError, match=r"stands|container"):
            DropKernel(
                tables,
                DROP.of(tables.shape_class),
                compile_scene(table).kernels,
                table.limits.velocity,
                len(table.entities),
                (type(more)(**(fields | broken)), SPILL),
            )
