"""Drops on moving entities: laws, the static model as reference, the core against NumPy."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jaxtyping import TypeCheckError
from moving_twin import OffPrediction, moving_spheres, touched
from test_drop import BOX, gantry

import graceful_plan as gp
from graceful_plan.costs.cost import StateBatch
from graceful_plan.costs.fault_prior import FaultPrior
from graceful_plan.costs.models.drop.constants import DropSettings
from graceful_plan.costs.models.mixture.mixture import FailureMixture
from graceful_plan.costs.models.moving.model import MovingModel
from graceful_plan.costs.models.moving.position_samples import PLACES, cell_of, normal_places
from graceful_plan.exceptions import SettingError
from graceful_plan.scene.elements import COMPONENTS

_STANDING = (0.03, 0.15)
"""Largest mean and single difference from the static model. Here the object is followed down an entity's side, not
only to its top; a part that falls off is caught slightly differently; and an entity beside the drop does not catch an
object that would hit another one."""
_CORE = 0.25
"""Relative difference of mean probabilities: the core keeps entities fixed while the object falls."""
_SIZES = {"box": [0.05, 0.08, 0.1], "cylinder": [0.06, 0.1]}


@pytest.fixture(scope="module")
def scene():
    return gantry(BOX)


def walker(x=0.3, y=0.0, *, size="box", speed=0.0, heading=0.0, passes=0.0, turn=0.0, shift=(0.0, 0.0), **more):
    """An entity 0.2 m high on the ground that passes (x, y) at a given time; the whole is rotated, then moved."""
    times = passes + np.array([-1.0, 1.0])
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    along = speed * np.array([np.cos(heading), np.sin(heading)])
    place = (np.array([x, y]) + np.outer(times - passes, along)) @ R.T + shift
    yaw = np.full(2, 0.4 + turn)
    position = np.column_stack([place, [0.1, 0.1]])
    return gp.MovingEntity("walker", "pet", size=_SIZES[size], t=times, position=position, yaw=yaw, **more)


def moving_probability(batch, components=COMPONENTS, places=PLACES):
    return sum(MovingModel(places=places).sources(batch, components).values())


def probability(scene, entity, q, qd=None, time=None, component="carried"):
    q = np.atleast_2d(np.asarray(q, float))
    qd = np.zeros_like(q) if qd is None else np.atleast_2d(np.asarray(qd, float))
    speed = np.linalg.norm(qd, axis=1)
    direction = np.divide(qd, speed[:, None], out=np.zeros_like(qd), where=speed[:, None] > 0.0)
    times = None if time is None else np.broadcast_to(np.asarray(time, float), (len(q),))
    batch = StateBatch(scene.with_moving(entity), q, direction, speed, times)
    P = moving_probability(batch)
    return P[:, list(scene.components).index(component), 0]


places = st.floats(-0.5, 0.5)
states = st.tuples(places, places, st.floats(-0.4, 0.3), st.floats(-3.0, 3.0)).map(list)
rates = st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=4)


# --- laws -------------------------------------------------------------------------------------------------------------


@given(states, rates, places, places, st.floats(0.0, 2.0), st.floats(0.0, 1.0), st.sampled_from(sorted(_SIZES)))
def test_probabilities_are_probabilities(scene, q, qd, x, y, speed, spread, size):
    entity = walker(x, y, size=size, speed=speed, spread=spread)
    for time in (None, 0.3):
        P = probability(scene, entity, q, qd, time)
        assert np.all((P >= 0.0) & (P <= 1.0))


@settings(max_examples=25)
@given(states, rates, places, places, st.floats(-3.0, 3.0), places, places)
def test_the_model_is_invariant_to_moving_the_world(scene, q, qd, x, y, turn, dx, dy):
    moved = gantry(BOX, turn=turn, shift=(dx, dy))
    here = probability(scene, walker(x, y, speed=1.0, heading=0.7), q, qd, 0.1)
    there = probability(moved, walker(x, y, speed=1.0, heading=0.7, turn=turn, shift=(dx, dy)), q, qd, 0.1)
    np.testing.assert_allclose(here, there, atol=1e-9)


@settings(max_examples=25)
@given(states, rates, st.floats(-5.0, 5.0), st.floats(-1.0, 1.0))
def test_only_differences_of_times_matter(scene, q, qd, seconds, time):
    entity = walker(speed=1.0, heading=2.0, growth=0.1)
    now = probability(scene, entity, q, qd, time)
    np.testing.assert_allclose(now, probability(scene, entity.later(seconds), q, qd, time + seconds), atol=1e-9)


def test_an_entity_that_arrives_later_is_not_hit():
    scene = gantry({})
    entity = walker(0.0, 0.0, speed=1.5, passes=3.0)
    over = np.zeros(4)
    assert probability(scene, entity, over, time=2.65)[0] > 0.9  # 0.5 m before (0, 0), with a fall of 0.3 s
    for time in (1.0, 3.6):
        assert probability(scene, entity, over, time=time)[0] < 1e-3


def test_entities_move_on_during_the_fall():
    scene = gantry({})
    height = 0.7 - 0.05 - 0.2  # of the object's bottom above the entity's top [m]
    fall = np.sqrt(2.0 * height / 9.81) + DropSettings.shipped().box.delay
    times = np.linspace(-1.0, 1.0, 201)
    P = probability(scene, walker(0.0, 0.0, speed=1.0, size="cylinder"), np.zeros((201, 4)), time=times)
    sure = times[P > 0.9]
    assert len(sure) > 5
    # Slightly earlier, since the object may hit the entity's side on its way to the ground.
    assert -fall - 0.08 < sure.mean() < -fall


def test_a_more_uncertain_place_is_less_likely_hit(scene):
    over = [0.3, 0.0, 0.0, 0.0]
    P = [probability(scene, walker(spread=spread), over, time=0.0)[0] for spread in (0.0, 0.05, 0.1, 0.2, 0.5, 2.0)]
    assert P[0] > 0.9
    assert np.all(np.diff(P) < 0.0)
    assert P[-1] < 0.02
    beside = [0.75, 0.0, 0.0, 0.0]
    near, wide = (probability(scene, walker(spread=spread), beside, time=0.0)[0] for spread in (0.0, 0.3))
    assert wide > 10.0 * near


def test_uncertainty_grows_with_time(scene):
    grown = probability(scene, walker(growth=0.2), [0.3, 0.0, 0.0, 0.0], time=np.array([4.0]))
    assert grown[0] < 0.5 * probability(scene, walker(), [0.3, 0.0, 0.0, 0.0], time=4.0)[0]


def test_without_a_time_the_probability_is_the_mean_over_the_path(scene):
    entity, rng = walker(speed=0.5, heading=0.5), np.random.default_rng(0)
    q = np.column_stack([rng.uniform(-0.5, 0.5, (30, 2)), rng.uniform(-0.3, 0.2, 30), rng.uniform(-3, 3, 30)])
    times = np.linspace(-1.0, 1.0, 401)
    each = probability(scene, entity, np.repeat(q, 401, axis=0), time=np.tile(times, 30)).reshape(30, 401)
    assert each.mean(axis=1).max() > 0.1
    np.testing.assert_allclose(probability(scene, entity, q), each.mean(axis=1), atol=0.01)


def test_a_higher_entity_catches_the_object():
    table = {"table": (0.0, 0.0, 0.3, 'type="box" size="0.6 0.6 0.02"')}
    under, open_ = (probability(gantry(t), walker(0.0, 0.0), np.zeros(4), time=0.0)[0] for t in (table, {}))
    assert under < 0.05
    assert open_ > 0.9


def test_a_tall_entity_is_hit_from_the_side_on_the_way_down():
    scene, flies = gantry({}), [2.0, 0.0, 0.0, 0.0]
    tall = gp.MovingEntity("walker", "adult", size=[0.2, 0.85], t=[0.0], position=[[0.55, 0.0, 0.85]])
    assert probability(scene, tall, np.zeros(4), flies, 0.0)[0] > 0.9  # 2 m/s for 0.3 s
    assert probability(scene, tall, np.zeros(4), np.zeros(4), 0.0)[0] < 0.2


@pytest.mark.parametrize("size", sorted(_SIZES))
def test_an_entity_that_passes_diagonally_is_not_hit(size):
    scene, heading, times = gantry({}), 0.4 + np.pi / 8, np.linspace(-1.0, 1.0, 81)
    across = np.array([-np.sin(heading), np.cos(heading)])

    def most(beside):
        entity = walker(*beside * across, size=size, speed=1.5, heading=heading)
        return probability(scene, entity, np.zeros((81, 4)), time=times).max()

    assert most(0.0) > 0.9
    assert most(0.22) < 0.1  # the object reaches 0.05 m to the sides, the entity 0.12 m


def test_nothing_falls_through_a_table():
    table = {"table": (0.0, 0.0, 0.3, 'type="box" size="0.6 0.6 0.02"')}
    scene, slides = gantry(table), [1.0, 0.5, 0.0, 0.0]
    below = gp.MovingEntity("cat", "pet", size=[0.2, 0.1, 0.05], t=[0.0], position=[[0.1, 0.1, 0.05]])
    assert probability(scene, below, np.zeros(4), slides, 0.0)[0] < 1e-3
    beside = gp.MovingEntity("cat", "pet", size=[0.2, 0.1, 0.05], t=[0.0], position=[[0.75, 0.0, 0.05]])
    assert probability(scene, beside, [0.55, 0.0, 0.0, 0.0], slides, 0.0)[0] > 0.02


@pytest.mark.parametrize("count", [4, 8, 16, PLACES])
def test_places_stand_for_a_normal_distribution(count):
    places = normal_places(count)
    assert len(np.unique(places.round(9), axis=0)) == count
    np.testing.assert_allclose(places.mean(axis=0), 0.0, atol=1e-9)
    np.testing.assert_allclose(places.T @ places / count + cell_of(count) ** 2 * np.eye(2), np.eye(2), atol=1e-9)


@pytest.mark.parametrize("places", [0, 3, 14, 26, 8.0])
def test_too_many_places_are_refused(places):
    for model in (FailureMixture, MovingModel):
        with pytest.raises((SettingError, TypeCheckError), match="places"):
            model(places=places)


def test_few_places_are_close_to_many(scene):
    batch = _near_a_walker(scene, 400)
    many, few = (moving_probability(batch, ("carried",), places).sum(axis=(1, 2)) for places in (PLACES, 12))
    assert many.sum() > 10.0 and few.sum() == pytest.approx(many.sum(), rel=0.1)
    assert np.corrcoef(few, many)[0, 1] > 0.85


def test_many_times_at_once_equal_one_by_one(scene):
    batch = _near_a_walker(scene, 40, same=8)
    whole = moving_probability(batch, ("carried",))
    assert whole.max() > 0.1
    for i in range(len(batch)):
        one = batch[i : i + 1]
        np.testing.assert_allclose(moving_probability(one, ("carried",))[0], whole[i], atol=1e-12)


def _near_a_walker(scene, n, same=1):
    """States around an uncertain moving entity, each at several times."""
    rng = np.random.default_rng(5)
    q = np.column_stack(
        [rng.uniform(-0.2, 0.8, n // same), rng.uniform(-0.5, 0.5, n // same), np.zeros((n // same, 2))]
    )
    q, time = np.repeat(q, same, axis=0), rng.uniform(-0.5, 0.5, n)
    entity = walker(speed=0.8, spread=0.2)
    return StateBatch(scene.with_moving(entity), q, np.zeros_like(q), np.zeros(n), time)


def test_places_in_contact_with_the_arm_are_excluded():
    scene = gantry({})
    tall = gp.MovingEntity("p", "adult", size=[0.2, 0.85], t=[0.0], position=[[0.3, 0.0, 0.85]], spread=0.1)
    P = probability(scene, tall, np.zeros(4), time=0.0)[0]
    blind = probability(scene, tall, np.zeros(4))[0]  # without a time
    assert P < 0.6 * blind  # at most places from which it would be hit, it already touches the arm
    inside = gp.MovingEntity("p", "adult", size=[0.2, 0.85], t=[0.0], position=[[0.0, 0.0, 0.85]], spread=0.02)
    assert probability(scene, inside, np.zeros(4), time=0.0)[0] > 0.9  # no place is free, so all are used


@pytest.mark.parametrize("size", ["box", "cylinder"])
def test_entities_in_contact_are_those_of_a_loop_over_all_spheres(size):
    scene, rng, n = gp.load_scene("tabletop").tasks["right_to_left"].scene, np.random.default_rng(0), 600
    entity = walker(0.4, size=size, speed=0.4, spread=0.3)
    entity = replace(entity, position=entity.position + [0.0, 0.0, 0.5])
    low, high = scene.limits.position.T
    batch = StateBatch(scene, rng.uniform(low, high, (40, len(low))))
    state, time = rng.integers(0, 40, n), rng.uniform(-1.0, 1.0, n)
    who = OffPrediction(entity, rng.normal(size=(n, 2)), 0.3)
    centre, radius = moving_spheres(batch)
    here, there, half = who.at(time), entity.at(time), entity.half_size
    expected = np.zeros(n, dtype=bool)
    for i in range(n):
        away = centre[state[i]] - [*here[i], there.position[i, 2]]
        c, s = np.cos(there.yaw[i]), np.sin(there.yaw[i])
        away = np.abs(away @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]))
        if entity.is_round:
            away = np.stack([np.linalg.norm(away[:, :2], axis=1), away[:, 2]], axis=1)
        gap = np.maximum(away - half[-away.shape[1] :], 0.0)
        expected[i] = (np.linalg.norm(gap, axis=1) < radius - batch.compiled.robot.protrusion).any()
    assert 0.05 < expected.mean() < 0.9
    np.testing.assert_array_equal(touched(batch, who, state, time), expected)


@pytest.mark.parametrize("geom", ["box", "cylinder"])
def test_a_standing_moving_entity_is_hit_like_a_static_one(geom):
    # A free joint, since a moving entity does not stop a flying object as a wall does.
    post = f'type="{geom}" size="{" ".join(map(str, _SIZES[geom]))}" euler="0 0 0.4"/><freejoint'
    place = {"post": (0.3, 0.1, 0.1, post)}
    rng = np.random.default_rng(2)
    q = np.column_stack([rng.uniform(-0.3, 0.7, (400, 2)), rng.uniform(-0.35, 0.3, 400), rng.uniform(-3, 3, 400)])
    qd = rng.normal(scale=0.4, size=(400, 4))
    still, empty = gantry(BOX | place), gantry(BOX)
    free = gp.clearance(q, still) > 0.0
    speed = np.linalg.norm(qd, axis=1)
    expected = FailureMixture().probability(StateBatch(still, q, qd / speed[:, None], speed))
    row, column = list(still.components).index("carried"), list(still.entities).index("post")
    found = probability(empty, walker(0.3, 0.1, size=geom), q, qd, 0.0)
    error = np.abs(found - expected[:, row, column])[free]
    assert free.sum() > 200
    assert expected[free, row, column].max() > 0.9
    assert error.mean() < _STANDING[0]
    assert np.quantile(error, 0.99) < _STANDING[1]


# --- arms, components -------------------------------------------------------------------------------------------------


def test_arms_reach_near_entities_that_are_not_below_them():
    task = gp.load_scene("tabletop").tasks["right_to_left"]
    hand = task.scene.data_at(task.start).site(task.scene.tool).xpos
    for offset, low, high in (((0, 0, 0), 0.9, 1.0), ((0, 0, -1.0), 0.9, 1.0), ((0, 0, 1.0), 0.0, 0.01),
                              ((0.8, -0.8, 0), 0.0, 0.01)):  # fmt: skip
        entity = gp.MovingEntity("p", "adult", size=[0.1, 0.1], t=[0.0], position=[hand + offset])
        assert low <= probability(task.scene, entity, task.start, time=0.0, component="body")[0] <= high


def test_other_components_are_zero():
    task = gp.load_scene("desk").tasks["bring_coffee"]
    place = task.scene.data_at(task.start).site(task.scene.tool).xpos * [1, 1, 0] + [0, 0, 0.8]
    near = task.scene.with_moving(gp.MovingEntity("p", "adult", size=[0.2, 0.05], t=[0.0], position=[place]))
    batch = StateBatch(near, task.start[None])
    P = moving_probability(batch, ("contents",))[0, :, 0]
    asked = np.array([name == "contents" for name in near.components])
    assert P[asked] > 0.5
    assert not P[~asked].any()


def test_without_an_object_only_the_arm_hits():
    scene = gp.load_scene("tabletop")
    P = probability(scene, walker(), scene.tasks["lift_to_goal"].start, time=0.0, component="body")
    assert P.shape == (1,)


def test_no_states(scene):
    assert probability(scene, walker(), np.zeros((0, 4))).shape == (0,)


# --- costs ------------------------------------------------------------------------------------------------------------


def test_impact_adds_up_and_severity_counts(scene):
    batch = StateBatch(scene.with_moving(walker()), np.array([[0.3, 0.0, 0.0, 0.0]]), time=np.zeros(1))
    cost = gp.ImpactCost(model="mixture")
    still = cost.state(StateBatch(scene, batch.q))
    P = probability(scene, walker(), batch.q, time=0.0)
    np.testing.assert_allclose(cost.state(batch), still + P * batch.scene.moving_severity["walker"]["carried"])
    for severity in (0.0, 1.0, 50.0):
        entity = walker(severity=severity)
        np.testing.assert_allclose(
            cost.state(StateBatch(scene.with_moving(entity), batch.q, time=batch.time)), still + P * severity
        )


def test_sources_add_up(scene):
    batch = StateBatch(scene.with_moving(walker()), np.array([[0.3, 0.0, 0.0, 0.0]]), time=np.zeros(1))
    for model in ("mixture", "box_overlap"):
        cost = gp.ImpactCost(model=model, components=("body", "carried", "contents"))
        np.testing.assert_allclose(sum(cost.sources(batch).values()), cost.probability(batch), atol=1e-12)
        assert cost.probability(batch).shape == (1, len(scene.components), len(cost.harmed_entities(batch.scene)))
        own = model == "mixture"
        assert cost.harmed_entities(batch.scene)[len(batch.scene.entity_names) :] == (
            (batch.scene.carried.body,) if own else ()
        )


def test_the_core_guides_searches_about_right(scene):
    entity = walker(0.3, 0.0, speed=0.4, heading=1.0)
    moving, rng = scene.with_moving(entity), np.random.default_rng(3)
    q0 = np.column_stack([rng.uniform(-0.4, 0.6, (60, 2)), rng.uniform(-0.2, 0.2, 60), rng.uniform(-3, 3, 60)])
    q1 = q0 + rng.normal(scale=0.2, size=q0.shape)
    objective = gp.Objective(impact=gp.ImpactCost(model="mixture"))
    kernel = objective.impact.kernel(moving, objective.bind(moving).paces)
    assert kernel is not None
    alone = objective.bind(moving.with_severity({"target": 0.0}))
    core = alone.edges(q0, q1)[:, 1]
    slow = np.array([alone.breakdown(gp.Path(np.stack(edge))).impact for edge in zip(q0, q1, strict=True)])
    assert core.sum() == pytest.approx(slow.sum(), rel=_CORE)
    assert np.corrcoef(core, slow)[0, 1] > 0.9


@dataclass(frozen=True)
class Nothing(gp.InteractionModel):
    """A custom model in which static entities are never hit."""

    def probability(self, batch):
        return np.zeros((len(batch), len(batch.scene.components), len(batch.scene.entities)))


@pytest.mark.parametrize("consequence", ["contact", "energy"])
def test_moving_entities_use_the_shipped_drop_model_with_every_model(scene, consequence):
    batch = StateBatch(scene.with_moving(walker()), np.array([[0.3, 0.0, 0.0, 0.0]]), time=np.zeros(1))
    components = ("body", "carried", "contents")
    own, aabb = (gp.ImpactCost(model, components, consequence) for model in (Nothing(), "box_overlap"))
    n, shipped = len(scene.entities), moving_probability(batch)
    assert shipped.max() > 0.9
    for cost in (own, aabb):
        np.testing.assert_allclose(cost.probability(batch)[..., n:], shipped)
        assert set(cost.sources(batch)) >= {"drop", "collapse"}
    assert not own.probability(batch)[..., :n].any()
    assert own.kernel(batch.scene, (1.0, 1.0)) is None and own.gradient(batch) is None


def test_weights_scale_probabilities(scene):
    entity, q = walker(), np.array([[0.3, 0.0, 0.0, 0.0]])
    batch = StateBatch(scene.with_moving(entity), q, time=np.zeros(1))
    prior = FaultPrior({"weak_grip": 1.0}, {"weak_grip": {"drop": 0.25}})
    models = FailureMixture().moving(), FailureMixture(faults=prior).moving()
    often, rarely = (model.sources(batch)["drop"] for model in models)
    assert often.max() > 0.9
    np.testing.assert_allclose(rarely, 0.25 * often)
    severity = np.ones((len(scene.components), 1)) * [[name != "body"] for name in scene.components]
    cores = [model.kernels(batch.scene, severity, (1.0, 1.0)) for model in models]
    severity[0] = 1.0
    assert next(iter(scene.components)) == "body" and models[0].kernels(batch.scene, severity, (1.0, 1.0)) is not None
    assert replace(models[0], collapse=1.0).kernels(batch.scene, severity, (1.0, 1.0)) is None
    impacts = [sum(kernel.states(q)[0] for kernel in kernels) for kernels in cores]
    assert impacts[1] == pytest.approx(0.25 * impacts[0])
