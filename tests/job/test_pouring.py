"""Pouring: contents move from one vessel to the other, over its opening, at the tilt that the fill gives."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from order_jobs import action_state
from places import ROOT

import graceful_plan as gp
from graceful_plan.exceptions import SettingError, UnknownNameError
from graceful_plan.job.actions import Action, Deed
from graceful_plan.job.job_state import JobState, pose_key
from graceful_plan.job.motions import Motions, Refusal
from graceful_plan.scene.roles import FROM_ABOVE
from graceful_plan.scene.rules.vessel import find_vessel

POUR = ROOT / "tests" / "support" / "scenes" / "pour.yaml"
FILL = 0.2


def job(*allowed: Action) -> gp.Job:
    return gp.Job(gp.load_scene(POUR)).place("kettle", at=[0.5, 0.35, 0.4]).allow(*allowed)


@cache
def poured() -> tuple[Deed, JobState, Motions]:
    action = gp.Pour("kettle", into="pot", fill=FILL)
    state, motions = action_state(job(action))
    for choice in action.candidates(state, motions):
        deed = action.motion(state, choice, motions)
        if isinstance(deed, Deed):
            return deed, state, motions
    raise AssertionError("no choice is possible")


def test_every_motion_is_verified_and_begins_where_the_last_one_ended() -> None:
    deed, state, _ = poured()
    at = state.q
    for _, _, pieces in deed.steps:
        for piece in pieces:
            np.testing.assert_allclose(piece.trajectory.q[0], at, atol=1e-9)
            assert gp.verify(piece.trajectory, piece.scene).passed, piece.label
            at = piece.trajectory.q[-1]
    np.testing.assert_array_equal(at, deed.state.q)


def test_the_vessel_is_tilted_over_the_receiver_until_the_fill_is_left() -> None:
    deed, state, _ = poured()
    tilted = [piece for piece in deed.steps[1][2] if piece.label == "pour"]
    full = find_vessel(state.world.attach("kettle", X_TO=FROM_ABOVE))
    assert full is not None
    capacity = float(np.pi * full.radius**2 * full.height)
    angles = []
    for q in [*tilted[0].trajectory.q, *tilted[2].trajectory.q]:
        body = tilted[0].scene.data_at(q).body("kettle")
        R, p = body.xmat.reshape(3, 3), body.xpos
        axis = R @ full.axis
        angles.append(float(np.arccos(np.clip(axis[2], -1.0, 1.0))))
        if float(full.capacity(np.array(angles[-1]))) < full.volume:
            # The lowest point of the rim, over which contents leave, is over the opening of the pot.
            down = -np.array([0.0, 0.0, 1.0]) + axis[2] * axis
            lip = p + R @ full.p_BR + full.radius * down / np.linalg.norm(down)
            assert np.linalg.norm(lip[:2] - state.pose("pot")[:2, 3]) < 0.065 and 0.48 < lip[2] < 0.7
    stays = replace(full, volume=FILL * capacity)
    assert max(angles) == pytest.approx(stays.brim_tilt, abs=0.01)
    assert angles[0] == pytest.approx(0.0, abs=0.01) and angles[-1] == pytest.approx(0.0, abs=0.01)


def test_contents_are_conserved_and_later_spills_cost_less() -> None:
    deed, state, motions = poured()
    before, after = (one.world.notes.objects for one in (state, deed.state))
    volumes = [after[name].contents.volume for name in ("kettle", "pot")]  # type: ignore[union-attr]
    assert sum(volumes) == pytest.approx(before["kettle"].contents.volume)  # type: ignore[union-attr]
    assert 0.0 < volumes[0] < 0.1 and after["pot"].contents.temperature == 90.0  # type: ignore[union-attr]
    np.testing.assert_allclose(deed.state.pose("kettle"), state.pose("kettle"))
    here = pose_key(state.pose("kettle"))
    grasp = next(motions.grasps(state, "kettle", [here]))
    stance = motions.stance(state, "kettle", grasp, here)
    assert not isinstance(stance, Refusal)
    full, light = (
        gp.evaluate(stance.lift, one.holding("kettle", grasp, ("table",)), gp.Objective(w=1.0)).impact
        for one in (state, deed.state)
    )
    assert light < 0.8 * full


def test_it_is_done_once_and_only_if_more_is_in_the_vessel_than_shall_stay() -> None:
    deed, state, motions = poured()
    assert not list(gp.Pour("kettle", into="pot", fill=0.1).candidates(deed.state, motions))
    assert not list(gp.Pour("kettle", into="pot", fill=0.95).candidates(state, motions))
    assert not list(gp.Pour("kettle", into="pot").candidates(state.with_contents("kettle", None), motions))


def test_a_receiver_without_space_is_told() -> None:
    _, state, motions = poured()
    action = gp.Pour("kettle", into="pot")
    crowded = state.with_contents("pot", gp.Liquid(0.9))
    found = action.motion(crowded, next(iter(action.candidates(crowded, motions))), motions)
    assert isinstance(found, Refusal) and "fit" in found.why


def test_misuse_is_named() -> None:
    with pytest.raises(SettingError, match="contents"):
        job(gp.Pour("pot", into="kettle"))
    with pytest.raises(UnknownNameError, match="laptop_contents"):
        job(gp.Pour("kettle", into="laptop"))
    with pytest.raises(SettingError, match="fill"):
        gp.Pour("kettle", into="pot", fill=1.0)
    with pytest.raises(SettingError, match="another"):
        gp.Pour("kettle", into="kettle")


@pytest.mark.long
def test_pouring_pays_from_some_weight_on() -> None:
    scene = gp.load_scene(POUR).with_severity({"laptop": {"contents": 300.0}})
    allowed = gp.Job(scene).place("kettle", at=[0.5, 0.35, 0.4]).allow(gp.Pour("kettle", into="pot"))
    kinds = [[step.kind for step in gp.plan_job(allowed, w, grasps=2, iterations=8).unwrap()] for w in (0.0, 3.0)]
    assert "pour" not in kinds[0] and "pour" in kinds[1]
