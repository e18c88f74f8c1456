"""The carried object as an entity: closed forms on a flat floor, hard and soft surfaces, severity."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm
from wrapped import Wrapped

import graceful_plan as gp
from graceful_plan.costs.models.drop.loss import LANDING_LOSS
from graceful_plan.scene.harm.fragility import Fragility, FragilityTable
from graceful_plan.testing import check_cost

_WORLD = """<mujoco><worldbody>
  <body name="floor"><geom type="plane" size="0 0 1"/></body>
  <body name="sofa" pos="3 0 0.2"><geom type="box" size="0.8 0.8 0.2"/></body>
  <body name="table" pos="-3 0 0.2"><geom type="box" size="0.8 0.8 0.2"/></body>
  <body name="arm" pos="0 0 1"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
    <joint name="x" type="slide" axis="1 0 0" range="-5 5"/><joint name="y" type="slide" axis="0 1 0" range="-5 5"/>
    <joint name="z" type="slide" axis="0 0 1" range="-1 5"/>
    <geom name="hand" type="sphere" size="0.01" pos="0 0 0.5"/><site name="tool"/></body>
  <body name="cup" pos="9 9 1"><freejoint/><geom type="cylinder" size="0.04 0.05" mass="0.3"/></body>
</worldbody></mujoco>"""
_HALF = 0.05


def room(object_class: str = "glass", ground: str = "floor", **severity: float | dict[str, float]) -> gp.Scene:
    scene = gp.Scene.from_mjcf(
        _WORLD,
        robot="arm",
        tool="tool",
        velocity=[1.0] * 3,
        acceleration=[1.0] * 3,
        entities={"floor": ground, "sofa": "textile", "table": "table"},
        severity=severity,
    )
    return scene.attach("cup", X_TO=np.eye(4), object_class=object_class)


def damage(
    scene: gp.Scene, x: float, height: float, speed: tuple[float, ...] = (0.0, 0.0, 0.0), **cost: object
) -> float:
    """Return P that the cup is damaged when released with its bottom at some height above the floor [m]."""
    q, qd = np.array([[x, 0.0, height + _HALF - 1.0]]), np.array([speed])
    norm_ = np.linalg.norm(qd, axis=1)
    batch = gp.StateBatch(scene, q, qd / np.where(norm_ > 0.0, norm_, 1.0)[:, None], norm_)
    return float(gp.ImpactCost(**cost).probability(batch)[0, list(scene.components).index("carried"), -1])  # type: ignore[arg-type]


def expected(energy: float, median: float, spread: float = 0.7) -> float:
    """Return P(Z spread + X <= ln(E / median)) for X exponential."""
    x = np.linspace(0.0, 30.0 * LANDING_LOSS, 200_001)
    density = np.exp(-x / LANDING_LOSS) / LANDING_LOSS
    return float(np.trapezoid(density * norm.cdf((math.log(energy / median) - x) / spread), x))


# --- height, speed, surface -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("height", [0.05, 0.2, 0.5, 1.0, 2.0])
def test_on_a_floor_damage_follows_the_energy_of_the_fall(height: float) -> None:
    median = FragilityTable.shipped().carried["glass"].median
    assert damage(room(), 0.0, height) == pytest.approx(expected(0.3 * 9.81 * height, median), abs=0.03)


def test_only_vertical_speed_damages() -> None:
    scene = room()
    still = damage(scene, 0.0, 0.2)
    assert damage(scene, 0.0, 0.2, (0.5, 0.0, 0.0)) == pytest.approx(still, abs=0.01)
    down, up = damage(scene, 0.0, 0.2, (0.0, 0.0, -1.5)), damage(scene, 0.0, 0.2, (0.0, 0.0, 1.5))
    assert down == pytest.approx(up, abs=1e-6)  # an object thrown upwards returns at the same speed
    assert down > 1.3 * still


@given(st.floats(0.03, 1.9), st.floats(0.01, 0.5))
@settings(max_examples=30, deadline=None)
def test_deeper_is_worse(height: float, more: float) -> None:
    scene = room()
    assert damage(scene, 0.0, height) <= damage(scene, 0.0, height + more) + 1e-9


def test_soft_surfaces_spare_the_object() -> None:
    scene = room()
    floor, table, sofa = damage(scene, 0.0, 0.9), damage(scene, -3.0, 0.9), damage(scene, 3.0, 0.9)
    assert floor > table > 3.0 * sofa > 0.0
    table_, carpet = FragilityTable.shipped(), room(ground="textile")
    energy = 0.3 * 9.81 * table_.rows["textile"].hardness
    for height in (0.5, 1.9):
        found = damage(carpet, 0.0, height)
        assert found == pytest.approx(expected(energy * height, table_.carried["glass"].median), abs=0.03)


def test_falling_off_an_edge_counts() -> None:
    scene = room()
    inside, edge = damage(scene, -3.0, 0.45), damage(scene, -3.0 + 0.8, 0.45)
    assert edge > 2.0 * inside
    assert edge < damage(scene, 0.0, 0.45) + 1e-6


def test_sturdier_objects_are_damaged_less() -> None:
    found = [damage(room(kind), 0.0, 0.6) for kind in ("glass", "light", "heavy", "sharp")]
    assert found == sorted(found, reverse=True) and found[0] > 4.0 * found[-1]
    assert damage(room("medium"), 0.0, 0.6) == damage(room("light"), 0.0, 0.6)


def test_a_custom_table_of_fragilities() -> None:
    never = FragilityTable({}, Fragility(1e9, 0.0, 0.7))
    always = FragilityTable({}, Fragility(1e9, 0.0, 0.7), {"glass": Fragility(1e-9, 0.0, 0.7)})
    assert damage(room(), 0.0, 1.0, consequence=never) < 1e-9
    assert damage(room(), 0.0, 1.0, consequence=always) == pytest.approx(1.0, abs=1e-3)
    energy = damage(room(), 0.0, 1.0, consequence="energy")
    assert energy == damage(room(), 0.0, 1.0)  # loss of the object always uses the energy


# --- severity, and objectives that use it ---------------------------------------------------------------------------


def path(scene: gp.Scene) -> gp.Path:
    del scene
    return gp.Path(np.array([[-1.0, 0.0, -0.5], [1.0, 0.3, -0.2]]))


def test_the_loss_has_the_name_of_the_object() -> None:
    scene = room(floor=0.0)
    assert scene.own_severity == 10.0
    cost = gp.evaluate(path(scene), scene)
    assert list(cost.impact_by_entity) == [*scene.entities, "cup"]
    assert cost.impact == pytest.approx(cost.impact_by_entity["cup"], rel=1e-4)
    assert cost.impact_by_component["carried"] == pytest.approx(cost.impact, rel=1e-4)
    assert "severity of the loss of cup: 10" in scene.describe()


def test_its_severity_can_be_set() -> None:
    base = gp.evaluate(path(room()), room()).impact_by_entity["cup"]
    dear, worthless = room(carried={"glass": 30.0}), room(carried=0.0)
    assert gp.evaluate(path(dear), dear).impact_by_entity["cup"] == pytest.approx(3.0 * base)
    assert gp.evaluate(path(worthless), worthless).impact_by_entity["cup"] == 0.0
    twice = room().with_severity({"carried": {"glass": 20.0}})
    assert gp.evaluate(path(twice), twice).impact_by_entity["cup"] == pytest.approx(2.0 * base)
    rows = {name: dict(row) for name, row in gp.SeverityTable.shipped().rows.items() if name != "carried"}
    unknown = room().with_severity(gp.SeverityTable(rows, gp.SeverityTable.shipped().components))
    assert unknown.own_severity == 0.0


@pytest.mark.parametrize(
    "impact",
    [
        gp.ImpactCost(own_loss=False),
        gp.ImpactCost(model="box_overlap"),
        gp.ImpactCost(model="box_overlap", consequence="energy"),
        gp.ImpactCost(components=("contents",)),
    ],
)
def test_the_loss_is_optional_and_absent_in_algorithm_1(impact: gp.ImpactCost) -> None:
    scene = room()
    cost = gp.evaluate(path(scene), scene, gp.Objective(impact=impact))
    assert "cup" not in cost.impact_by_entity
    assert impact.harmed_entities(scene) == scene.entity_names and not impact.counts_own_loss(scene)


def test_without_the_loss_the_rest_is_the_same() -> None:
    scene = room()
    with_it, without = (
        gp.evaluate(path(scene), scene, gp.Objective(impact=gp.ImpactCost(own_loss=own))) for own in (True, False)
    )
    assert with_it.impact - with_it.impact_by_entity["cup"] == pytest.approx(without.impact)
    assert not gp.ImpactCost().counts_own_loss(gp.load_scene("desk"))  # no carried object


@pytest.mark.parametrize("faults", ["drop_only", "arm", "service_robot"])
def test_the_loss_is_weighed_like_drops(faults: str) -> None:
    scene, model = room(), gp.FailureMixture(faults=faults)
    batch = gp.StateBatch(scene, np.array([[0.0, 0.0, 0.0], [3.0, 0.0, -0.3]]))
    weight = model.prior.weights()["drop"]
    lost = gp.ImpactCost(model=model).probability(batch)[..., -1].sum(axis=1) if weight else np.zeros(2)
    alone = gp.ImpactCost().probability(batch)[..., -1].sum(axis=1)
    np.testing.assert_allclose(lost, weight * alone)
    assert gp.ImpactCost(model=model).counts_own_loss(scene) == (weight > 0.0)


def test_kernels_gradients_and_custom_models_agree() -> None:
    scene = room(floor=0.0)
    check_cost(gp.ImpactCost(), scene)
    native, generic = (gp.Objective(impact=gp.ImpactCost(model=model)).bind(scene) for model in ("mixture", Wrapped()))
    assert native.kernel is not None and generic.kernel is None
    q = path(scene).q
    np.testing.assert_allclose(native.edges(q[:-1], q[1:]), generic.edges(q[:-1], q[1:]), rtol=1e-6)
    assert gp.ImpactCost(model=Wrapped()).gradient(gp.StateBatch(scene, q)) is None
    wide = gp.ImpactCost(own_loss=False).widened(0.05)
    assert wide is not None and not wide.own_loss


def test_an_explanation_names_the_loss_of_the_object() -> None:
    scene = room(floor=0.0, table=0.0, sofa=0.0)
    found = gp.explain(path(scene), scene)
    (row,) = found.contributions
    assert (row.event, row.entity, row.component, row.source) == ("cup itself, by its fall", "cup", "carried", "drop")
    assert row.severity == 10.0 and found.entities[-1] == "cup"


def test_planners_carry_low_over_the_hard_floor() -> None:
    """Only the object can be harmed: over the hard floor it is carried low."""
    scene = room(floor=0.0, table=0.0, sofa=0.0)
    start, goal = np.array([-1.5, 0.0, 0.0]), np.array([1.5, 0.0, 0.0])
    found = gp.plan(start, goal, scene, w=5.0, iterations=500).unwrap()
    assert found.q[:, 2].min() < -0.5
    straight = gp.plan(start, goal, scene, w=0.0, iterations=50).unwrap()
    assert gp.evaluate(found.path, scene).impact < 0.7 * gp.evaluate(straight.path, scene).impact
