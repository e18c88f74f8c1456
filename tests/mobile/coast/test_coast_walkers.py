"""Failing bases and moving entities: the result is that of static entities at their predicted places."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import graceful_plan as gp
from graceful_plan.costs.cost import moving_batch
from graceful_plan.mobile.coast.coast import Coast
from graceful_plan.mobile.coast.constants import CoastSettings
from graceful_plan.mobile.coast.moving_entities import moving_coast, planar_shapes
from graceful_plan.mobile.coast.reduced import reduced_settings
from hall import hall

SHIPPED = CoastSettings.shipped()
SCENE = hall()
ALONE = hall(extra='<body name="ann" pos="-1 -1.2 .85"><geom type="cylinder" size=".25 .85"/></body>')


def walker(position, t=None, **given):
    t = [0.0] if t is None else t
    return gp.MovingEntity("bob", "adult", size=[0.25, 0.85], t=t, position=position, **given)


def met(entity, q, qd, t, scene=SCENE, settings=SHIPPED):
    return moving_coast(scene.with_moving(entity), settings).probability(q, qd, np.full(len(q), float(t)))[:, 0]


def states(n, around, seed=0):
    rng = np.random.default_rng(seed)
    q = np.column_stack([rng.uniform(-2, 2, (n, 2)) + around, rng.uniform(-3, 3, n)])
    v, omega = rng.uniform(-2, 2, n), rng.uniform(-2, 2, n)
    return q, np.column_stack([v * np.cos(q[:, 2]), v * np.sin(q[:, 2]), omega])


def test_a_standing_moving_entity_equals_a_static_one():
    q, qd = states(200, [2.0, 0.8])
    P = met(walker([[2.0, 0.8, 0.85]]), q, qd, 3.0, hall(extra="").edit(remove=["person"]))
    known = Coast(SHIPPED).probability(moving_batch(SCENE, q, qd))[:, 0, 0]
    assert (known > 0.1).sum() > 5
    np.testing.assert_allclose(P, known, atol=1e-9)


@given(st.floats(-5.0, 5.0))
@settings(max_examples=5, deadline=None)
def test_only_the_time_since_the_prediction_counts(shift):
    entity = walker([[0.0, -1.5, 0.85], [0.0, 1.5, 0.85]], t=[0.0, 3.0], spread=0.05, growth=0.1)
    q, qd = states(40, [-0.5, 0.0])
    np.testing.assert_allclose(met(entity, q, qd, 1.0), met(entity.later(shift), q, qd, 1.0 + shift), atol=1e-9)


def test_entities_are_hit_only_if_they_are_there_when_the_base_arrives():
    q, qd = np.array([[-3.0, 1.2, 0.0]]), np.array([[1.5, 0.0, 0.0]])
    crossing = walker([[-2.0, -6.0, 0.85], [-2.0, 8.0, 0.85]], t=[0.0, 14.0])  # at y = 1.2 after 7.2 s
    soon = SHIPPED.only("wheels_locked", "runaway", "delayed")  # these failures end before the next entity arrives
    before, at, after = (met(crossing, q, qd, t, settings=soon)[0] for t in (4.0, 6.8, 9.5))
    assert at > 0.3 and before < 0.05 * at and after < 0.01 * at


def test_rest_does_no_harm_and_heights_count():
    q = np.array([[1.5, 0.8, 0.0]])
    here = walker([[2.0, 0.8, 0.85]])
    assert met(here, q, np.zeros((1, 3)), 0.0)[0] == 0.0
    above = gp.MovingEntity("bob", "pet", size=[0.2, 0.1], t=[0.0], position=[[2.0, 0.8, 1.0]])
    assert met(above, q, np.array([[1.0, 0.0, 0.0]]), 0.0)[0] == 0.0


def test_impact_counts_them_and_paths_meet_them_anywhere_along_their_way():
    entity = walker([[0.0, -1.5, 0.85], [0.0, 1.5, 0.85]], t=[0.0, 3.0])
    scene = SCENE.with_moving(entity)
    q, qd = np.array([[-1.5, 1.2, 0.0]]), np.array([[1.5, 0.0, 0.0]])
    cost = gp.ImpactCost()
    moving = cost.moving_impact(scene)
    t = np.linspace(0.0, 3.0, 400)
    rows = len(t)
    timed = moving.impact(np.repeat(q, rows, 0), np.repeat(qd, rows, 0), t)
    assert moving.impact(q, qd, None)[0] == pytest.approx(timed.mean(), rel=0.1)
    whole = cost.state(moving_batch(scene, q, qd, np.array([2.6])))
    still = cost.state(moving_batch(SCENE, q, qd))
    assert whole == pytest.approx(still + moving.impact(q, qd, np.array([2.6])))
    assert cost.sources(moving_batch(scene, q, qd, np.array([2.6])))["coast"][0, 0, -1] > 0.0


@pytest.mark.parametrize("arm", [False, True])
def test_failures_have_the_same_shares_as_among_entities_that_stand(arm):
    bob = walker([[2.0, 0.8, 0.85]])
    scene = hall(arm=arm, extra="", entities={"person": "adult"}).with_moving(bob)
    q, qd = states(100, [2.0, 0.8])
    rest = np.zeros((len(q), int(arm)))
    batch = moving_batch(scene, np.hstack([q, rest]), np.hstack([qd, rest]), np.zeros(len(q)))
    found = gp.FailureMixture().moving().sources(batch)["coast"][:, 0, 0]
    alone = met(bob, batch.q, batch.qd, 0.0, scene.without_moving())
    assert (alone > 0.1).sum() > 5
    np.testing.assert_allclose(found, SHIPPED.of_base(scene) * alone, atol=1e-12)


def test_outlines_velocities_and_spreads():
    entity = gp.MovingEntity(
        "cart", "adult", size=[0.4, 0.2, 0.5], t=[0.0, 2.0], position=[[0, 0, 0.5], [4, 2, 0.5]], yaw=[0.0, 1.0],
        spread=0.3, growth=0.2,
    )  # fmt: skip
    shape, velocity, spread = planar_shapes(entity, np.array([1.0]))
    np.testing.assert_allclose(shape[0], [2.0, 1.0, np.cos(0.5), np.sin(0.5), 0.4, 0.2, 0.0])
    np.testing.assert_allclose(velocity[0], [2.0, 1.0])
    assert spread[0] == pytest.approx(np.hypot(0.3, 0.2))


def test_few_ways_to_fail_are_close_to_all():
    crossing = walker([[0.0, -1.6, 0.85], [0.0, 1.6, 0.85]], t=[0.0, 4.0], spread=0.05)
    q, qd = states(600, [0.0, 0.0])
    many, few = (met(crossing, q, qd, 2.0, settings=ways) for ways in (SHIPPED, reduced_settings(SHIPPED)))
    assert many.sum() > 10.0 and few.sum() == pytest.approx(many.sum(), rel=0.05)
    assert np.corrcoef(many, few)[0, 1] > 0.99
