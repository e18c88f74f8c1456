"""Descents of curves along which a base rolls: exact derivatives, and fixed ends."""

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.core import _native
from graceful_plan.mobile.motions.rolling_spline import RollingCurves
from graceful_plan.planners.native import native_space
from graceful_plan.planners.scene_problem import SceneProblem
from hall import hall

ANN = gp.MovingEntity(
    "ann", "adult", size=[0.25, 0.85], t=[0.0, 4.0], position=[[0.0, -1.6, 0.85], [0.0, 1.6, 0.85]], spread=0.05
)
HALL, WITH_ARM = hall(), hall(arm=True)
AMONG = hall(walls="").with_moving(ANN)
PATH = np.array([[-4.0, -0.8, 0.0], [-1.0, -1.1, 0.0], [1.0, -1.1, 0.0], [4.0, -0.8, 0.0]])


def descent(scene, w=0.0, path=PATH, controls=11, **kind):
    """Return a descent from a path, with the arm at rest except at its last vertex."""
    nq = len(scene.joints)
    q = np.column_stack([path, np.zeros((len(path), nq - 3))])
    q[-1, 3:] = 0.4
    objective = gp.Objective(w=w).bind(scene)
    problem = SceneProblem(kernels=objective.kernels, start=q[0], goals=q[-1:], margin=0.002)
    curves = RollingCurves(scene.base, before=float(q[0, 2]), after=float(q[-1, 2]), **kind)
    found = _native.MotionDescent(
        native_space(problem, objective),
        path=q,
        velocity=scene.limits.velocity,
        acceleration=scene.limits.acceleration,
        controls=controls,
        density=4,
        time_price=0.3,
        rolling=curves.rolling,
    )
    return found, curves


@pytest.mark.parametrize("turns", [(False, False), (True, True)])
@pytest.mark.parametrize(("scene", "w"), [(HALL, 0.0), (HALL, 1.0), (WITH_ARM, 0.0), (AMONG, 0.0), (AMONG, 1.0)])
def test_derivatives_equal_differences(scene, w, turns):
    found, _ = descent(scene, w, turns_before=turns[0], turns_after=turns[1])
    rng, columns = np.random.default_rng(0), len(scene.joints)
    x = found.inner.ravel() + 0.05 * rng.normal(size=found.inner.size)
    x[columns - 1 :: columns] = -rng.uniform(0.05, 0.6, len(x) // columns)  # shares of the speed
    value, slope = found.energy(x)
    assert value > 8.0
    right = 0
    for i in range(len(x)):
        step = 1e-6 * np.eye(len(x))[i]
        known = (found.energy(x + step)[0] - found.energy(x - step)[0]) / 2e-6
        right += abs(known - slope.ravel()[i]) < 1e-3 * max(1.0, abs(known))
    assert right >= 0.97 * len(x)  # it has kinks


@pytest.mark.parametrize("forward", [True, False])
def test_ends_and_their_headings_stay(forward):
    found, curves = descent(HALL, forward=forward)
    before = found.value
    assert found.run(30, np.inf) > 0
    q = curves.curve(found.controls).even(200)
    assert found.value < before
    np.testing.assert_allclose(q[[0, -1], :2], PATH[[0, -1], :2], atol=1e-12)
    np.testing.assert_allclose(np.sin(q[[0, -1], 2]), 0.0, atol=1e-9)
    np.testing.assert_allclose(np.cos(q[[0, -1], 2]), 1.0, atol=1e-9)


def test_a_base_that_may_turn_first_does_so_where_that_is_shorter():
    aside = PATH.copy()
    aside[0, 2] = 2.5
    kept, _ = descent(HALL, path=aside)
    turned, curves = descent(HALL, path=aside, turns_before=True)
    for one in (kept, turned):
        one.run(60, np.inf)
    assert turned.value < kept.value
    assert abs(curves.curve(turned.controls).even(50)[0, 2]) < 1.0


def test_the_base_is_slower_near_entities_in_tight_places():
    narrow = hall(walls='<body name="south" pos="0 -.6 .5"><geom type="box" size="6 .05 .5"/></body>')
    straight = np.array([[-4.0, 0.0, 0.0], [4.0, 0.0, 0.0]])
    shares = []
    for w in (0.0, 30.0):
        found, curves = descent(narrow, w, straight)
        found.run(120, np.inf)
        shares.append(curves.curve(found.controls).share(np.linspace(0.0, 8.0, 100)))
    assert shares[0].min() > 0.95
    assert shares[1].min() < 0.85 and shares[1].max() <= 1.0


def test_gaps_to_moving_entities_are_at_the_times_of_the_motion():
    through = PATH.copy()
    through[1:-1, 1] = 0.0
    found, _ = descent(AMONG, path=through)
    assert found.gap < 0.0  # the pedestrian is in the middle when the base arrives
    found.run(80, np.inf)
    assert found.gap > 0.0
    alone, _ = descent(HALL)
    assert alone.gap == np.inf
