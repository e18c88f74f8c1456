"""Objects that stand on a tray: limits from their geoms, at rest, in retiming, and in plans."""

from __future__ import annotations

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.constraints.scene_constraints import SceneConstraints
from graceful_plan.exceptions import SettingError, UnknownNameError

CAKES = [gp.KeepStanding("cake_left"), gp.KeepStanding("cake_right")]


@pytest.fixture(scope="module")
def tray():
    return gp.load_scene("dining_table").tasks["serve_cake"]


def test_settings_come_from_the_geom(tray):
    rule = CAKES[0].rule(tray.scene)
    # A cylinder 6 cm high and 10 cm wide whose bottom is on the tray, 1.6 cm above the origin.
    assert rule.support == pytest.approx(0.05 / 0.03)
    assert rule.axis == pytest.approx((0.0, 0.0, 1.0)) and rule.point == pytest.approx((-0.11, 0.0, 0.046))
    tall = gp.KeepStanding("cake_left", height=0.1, support=0.02, friction=0.5).rule(tray.scene)
    assert tall.point == pytest.approx((-0.11, 0.0, 0.116))
    assert (tall.support, tall.friction) == (pytest.approx(0.2), 0.5)


def test_at_rest_felt_gravity_is_gravity(tray):
    keep = gp.KeepStanding("cake_left", friction=0.3, share=1.0)
    q = np.random.default_rng(0).uniform(*tray.scene.limits.position.T, size=(200, 7))
    batch = gp.StateBatch(tray.scene, q)
    tilt = np.arccos(np.clip(batch.object_poses[:, 2, 2], -1.0, 1.0))
    assert keep.residual(batch) == pytest.approx(tilt - 0.9 * np.arctan(0.3), abs=1e-6)


def duration(task, constraints):
    path = gp.Path(np.vstack([task.start, np.atleast_2d(task.goal)[0]]))
    return SceneConstraints(task.scene, constraints).retimed(path, deviation=0.05)


def test_earlier_sliding_or_tipping_never_makes_a_motion_faster(tray):
    for name, values in (("friction", (0.6, 0.4, 0.2)), ("support", (0.03, 0.02, 0.01))):
        motions = [duration(tray, [gp.KeepStanding("cake_left", **{name: value})]) for value in values]
        durations = [motion.duration for motion in motions]
        assert durations == sorted(durations) and durations[-1] > durations[0]
        for motion, value in zip(motions, values, strict=True):
            asked = gp.KeepStanding("cake_left", **{name: value})
            check = gp.verify(motion, tray.scene, constraints=[asked]).checks["keep_standing"]
            assert check.passed and ("slides" if name == "friction" else "tips") in check.detail


@pytest.mark.long
def test_plans_keep_cakes_on_the_tray(tray):
    free = gp.plan(tray.start, tray.goal, tray.scene, seed=1, iterations=300, constraints=[])
    kept = gp.plan(tray.start, tray.goal, tray.scene, seed=1, iterations=300, constraints=CAKES)
    assert free.status is kept.status is gp.PlanStatus.SOLVED
    for result, well in ((free, False), (kept, True)):
        checks = gp.verify(result.unwrap(), tray.scene, constraints=CAKES).checks
        assert (checks["keep_standing"].passed, checks["keep_standing_2"].passed) == (well, well)
    assert {"keep_standing", "keep_standing_2"} <= set(kept.verdict.checks)


def test_a_tilted_start_is_reported_with_its_angle(tray):
    tilted = np.array(tray.start) + [0.0, 0.0, 0.0, 0.0, 0.0, 0.9, 0.0]
    result = gp.plan(tilted, tray.goal, tray.scene, constraints=[gp.KeepStanding("cake_left", friction=0.3)])
    assert result.status is gp.PlanStatus.INVALID_START
    assert "'cake_left'" in result.detail and "degrees" in result.detail


def test_misuse_is_refused(tray):
    for wrong in ({"height": 0.0}, {"support": -1.0}, {"friction": np.inf}, {"share": 0.0}):
        with pytest.raises(SettingError, match=next(iter(wrong))):
            gp.KeepStanding("cake_left", **wrong)
    with pytest.raises(UnknownNameError, match="cake_right"):
        gp.KeepStanding("bread").rule(tray.scene)
    with pytest.raises(SettingError, match="something is carried"):
        gp.KeepStanding("cake_left").rule(gp.load_scene("tabletop"))
