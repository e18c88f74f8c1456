"""Spills by protective stops: the specification, its derivatives, and simple stops."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spill_twin import pour, spread_out
from test_spill_model import CUP_OF_TEA, DROP, SPILL, TABLE, gantry, moving, states

import graceful_plan as gp
from graceful_plan.costs.fault_prior import FaultPrior
from graceful_plan.costs.models.drop.kernel import ROWS, drop_kernel
from graceful_plan.costs.models.drop.tables import drop_tables
from graceful_plan.costs.models.spill.constants import StopSettings
from graceful_plan.costs.models.spill.stop import stop_spill
from graceful_plan.costs.models.spill.tables import spill_tables
from graceful_plan.exceptions import SceneError, SettingError
from graceful_plan.scene.rules.vessel import find_vessel

STOP = StopSettings.shipped()
STOPPED = ROWS.index("stopped")


@pytest.fixture(scope="module")
def table():
    return gantry(TABLE, CUP_OF_TEA)


def reached(scene, q, qd, stop=STOP):
    """Return P [n, entity] from the core."""
    return drop_kernel(scene, DROP, SPILL, None, stop).probability(q, qd)[:, STOPPED]


def onward(speed, n=1):
    """Return a state with the cup above the middle of the table, moving along x."""
    return np.zeros((n, 4)), np.tile([speed, 0.0, 0.0, 0.0], (n, 1))


# --- the specification ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "task"), [("desk", "bring_coffee"), ("dining_table", "serve_stew"), ("kitchen_counter", "shelve_jar")]
)
def test_the_core_is_the_specification(name, task):
    scene = gp.load_scene(name).tasks[task].scene
    q, qd = states(scene, 150, seed=1)
    batch, tables, more = moving(scene, q, qd), drop_tables(scene), spill_tables(scene)
    out = stop_spill(batch)
    hit = spread_out(tables, more, STOP.places, pour(batch, tables, more, DROP.of(tables.shape_class)), out.lost)
    expected = np.zeros((len(q), len(scene.entities)))
    for k, owner in enumerate(tables.target_entity):
        if owner >= 0:
            expected[:, owner] = np.maximum(expected[:, owner], out.chance * hit[:, k])
    np.testing.assert_allclose(reached(scene, q, qd), expected, atol=1e-10)
    assert expected.max() > 0.3


@pytest.mark.parametrize(("name", "task"), [("desk", "lift_coffee"), ("kitchen_counter", "season")])
def test_gradients_equal_differences(name, task):
    task = gp.load_scene(name).tasks[task]
    scene, rng = task.scene, np.random.default_rng(0)
    kernel = drop_kernel(scene, DROP, SPILL, None, STOP)
    q = task.start + 0.1 * rng.standard_normal((60, len(task.start)))
    qd = 0.6 * rng.standard_normal(q.shape)
    severity = np.zeros((len(ROWS), len(scene.entities)))
    severity[STOPPED] = rng.random(len(scene.entities))
    impact, by_q, by_qd = kernel.gradient(q, severity, qd)
    np.testing.assert_allclose(impact, kernel.impact(q, severity, qd), atol=1e-12)
    h = 1e-6
    for j in range(q.shape[1]):
        d = h * np.eye(q.shape[1])[j]
        along_q = kernel.impact(q + d, severity, qd) - kernel.impact(q - d, severity, qd)
        along_qd = kernel.impact(q, severity, qd + d) - kernel.impact(q, severity, qd - d)
        np.testing.assert_allclose(along_q / (2.0 * h), by_q[:, j], atol=1e-5)
        np.testing.assert_allclose(along_qd / (2.0 * h), by_qd[:, j], atol=1e-5)
    assert np.abs(by_qd).max() > 0.1


# --- laws and simple stops --------------------------------------------------------------------------------------------


def test_at_rest_a_stop_spills_nothing(table):
    q, _ = states(table, 40, seed=0)
    assert not reached(table, q * 0.05, np.zeros_like(q)).any()
    assert not drop_kernel(table, DROP).probability(q * 0.05)[:, STOPPED].any()
    assert not stop_spill(moving(table, q, np.zeros_like(q))).chance.any()


@given(speed=st.floats(0.01, 1.5), more=st.floats(1.0, 4.0))
@settings(max_examples=30, deadline=None)
def test_faster_and_harder_stops_spill_more(table, speed, more):
    def chance(v, stop):
        return float(stop_spill(moving(table, *onward(v)), stop).chance[0])

    assert chance(more * speed, STOP) >= chance(speed, STOP) - 1e-12
    assert chance(speed, replace(STOP, deceleration=more)) >= chance(speed, STOP) - 1e-12
    assert 0.0 <= chance(speed, STOP) <= 1.0


def test_contents_spill_where_the_brim_is_level_with_the_tilted_surface(table):
    vessel = find_vessel(table)
    fast = 30.0  # a stop so long that only its deceleration matters
    brim = 9.81 * np.tan(vessel.brim_tilt)
    for share, expected in ((0.6, 0.0), (1.0, 0.5), (1.6, 1.0)):
        stop = replace(STOP, deceleration=share * brim, amplification=1.0)  # joint accelerations are limited to 1 m/s^2
        assert stop_spill(moving(table, *onward(fast)), stop).chance[0] == pytest.approx(expected, abs=0.1)


def test_contents_are_thrown_forward(table):
    scene = filled(0.3)  # nearly full
    at = list(scene.entities).index("phone")
    stop = replace(STOP, deceleration=10.0)
    forward, backward = (reached(scene, *onward(v), stop)[0, at] for v in (0.6, -0.6))
    assert forward > 2.0 * backward


def filled(litres):
    return gantry(TABLE, gp.Liquid(volume=litres))


def test_a_less_full_cup_spills_less():
    hard = replace(STOP, deceleration=8.0)
    full, half = (stop_spill(moving(filled(litres), *onward(1.0)), hard) for litres in (0.4, 0.15))
    assert full.chance[0] > half.chance[0] + 0.1
    assert full.lost[0] > half.lost[0]


def test_the_prior_tells_the_footprint_of_stops():
    task = gp.load_scene("desk").tasks["lift_coffee"]
    scene = task.scene
    q = np.tile(task.start, (3, 1))
    batch = moving(scene, q, np.full_like(q, 0.8))
    prior = FaultPrior({"protective_stop": 1.0})
    model = gp.FailureMixture(faults=prior)
    row = list(scene.components).index("contents")
    expected = drop_kernel(scene, DROP).probability(batch.q, batch.qd)[:, STOPPED]
    np.testing.assert_allclose(model.probability(batch)[:, row], expected)
    assert list(model.sources(batch)) == ["stop"]
    gentle = gp.FailureMixture(faults=prior, stop=replace(STOP, deceleration=0.05))
    assert gentle.probability(batch).sum() < 0.2 * model.probability(batch).sum()
    assert "stop" in gp.FailureMixture(faults="service_robot").sources(batch)


# --- unhappy paths ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value"), [("deceleration", 0.0), ("amplification", -1.0), ("response", 0.0), ("spread", float("nan"))]
)
def test_constants_out_of_range_are_named(name, value):
    with pytest.raises(SettingError, match=name):
        replace(STOP, **{name: value})


def test_broken_files_are_named(tmp_path):
    file = tmp_path / "stop.yaml"
    text = StopSettings.shipped_file.read_text()
    file.write_text(text.replace("  spread: 0.15\n", ""))
    with pytest.raises(SceneError, match="spread"):
        StopSettings.load(file)
