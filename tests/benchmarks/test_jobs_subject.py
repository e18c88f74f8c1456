"""The benchmark `jobs`: drawn variants are reproducible and bounded, and simple orders are what their names say."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.jobs.runs import BLIND_ORDER, OURS, Measured, Way, fragile_last, nearest_first
from benchmarks.jobs.variants import FACTOR, GOAL_SHIFT, KINDS, SHIFT, eight_objects, variant
from benchmarks.subjects.jobs import less

import graceful_plan as gp


def _severity(scene: gp.Scene, body: str) -> float:
    return (scene.moving_severity[body] if body in scene.moving else scene.entities[body].severity)["body"]


@pytest.mark.parametrize("name", KINDS)
def test_variants_are_drawn_within_bounds_and_again_alike(name: str) -> None:
    plain, drawn, again = variant(name, 0), variant(name, 1), variant(name, 1)
    ready = plain.scene.keyframes["ready"]
    for body in plain.goals:
        places = [one.scene.data_at(ready).body(body).xpos for one in (plain, drawn, again)]
        np.testing.assert_array_equal(places[1], places[2])
        assert 0.0 < np.abs(places[1] - places[0]).max() <= SHIFT
        assert 0.0 < np.abs(drawn.goals[body] - plain.goals[body]).max() <= GOAL_SHIFT
    for body in plain.kind.precious:
        severities = [_severity(one.scene, body) for one in (plain, drawn)]
        assert 1.0 / FACTOR <= severities[1] / severities[0] <= FACTOR and severities[0] != severities[1]
    assert set(drawn.job().goals) == {*plain.kind.goals, *plain.kind.on_tray}


def test_simple_orders() -> None:
    order = variant("order", 0)
    assert fragile_last(order) == ("crate", "dome") and nearest_first(order)[0] == "crate"
    assert len(nearest_first(variant("tray", 0))) == 3
    assert len(eight_objects().job().goals) == 8


def test_harm_is_compared_per_executed_job() -> None:
    ways = {OURS: Way(status="SOLVED", harm=2.0), BLIND_ORDER: Way(status="SOLVED", harm=5.0)}
    assert less(Measured(run={}, objects=1, ways=ways), BLIND_ORDER) == 2.5
    ways[OURS].harm = 0.0
    assert np.isnan(less(Measured(run={}, objects=1, ways=ways), BLIND_ORDER))
