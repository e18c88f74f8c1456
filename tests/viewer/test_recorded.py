"""Datasets in the viewer: the list of rollouts, and replays that equal the recording."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import failbench as fb
import graceful_plan as gp
from graceful_plan.exceptions import FormatError, SettingError, UnknownNameError
from graceful_plan.viewer.browser import words
from graceful_plan.viewer.failing import recorded_replay
from graceful_plan.viewer.recorded import Recorded, RecordedRollouts
from graceful_plan.viewer.state import ViewerState

pytest.importorskip("pyarrow")
_LONG = 60.0
"""Seconds after which a test fails."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A sweep of two faults on one short motion, two rollouts of each."""
    from failbench.sweeps.definition import PlanSettings
    from failbench.sweeps.sweep import sweep_of

    folder = tmp_path_factory.mktemp("sweep") / "data"
    patterns = [f"tabletop/lift_to_goal/{fault}/severe" for fault in ("gripper_failure", "noise")]
    fb.generate_dataset(sweep_of(patterns, 2, plans=[PlanSettings(iterations=50)]), folder)
    return folder


@pytest.fixture(scope="module")
def rollouts(folder):
    return RecordedRollouts(folder, time_limit=0.2)


@pytest.mark.long  # needs a sweep
def test_rollouts_are_found_by_harm_motion_and_fault(rollouts):
    assert len(rollouts) == 4 and rollouts.faults == ("gripper_failure", "noise") and len(rollouts.motions) == 1
    order = rollouts.worst_first()
    harm = [rollouts[int(i)].impact for i in order]
    assert sorted(order.tolist()) == [0, 1, 2, 3] and harm == sorted(harm, reverse=True) and harm[0] > 0.0
    dropped = rollouts.worst_first(faults=["gripper_failure"])
    assert {rollouts[int(i)].fault for i in dropped} == {"gripper_failure"} and len(dropped) == 2
    assert all(rollouts[int(i)].dropped for i in dropped)
    with pytest.raises(UnknownNameError, match="'juggling'"):
        rollouts.worst_first(faults=["juggling"])
    with pytest.raises(SettingError, match=r"rollout = 4.*3"):
        rollouts[4]


@pytest.mark.long  # needs a sweep
def test_diverged_rollouts_are_last(rollouts, monkeypatch):
    monkeypatch.setattr(rollouts, "_impact", np.array([np.nan, 0.0, 2.0, 1.0]))
    assert rollouts.worst_first().tolist() == [2, 3, 1, 0]


@pytest.mark.long  # needs a sweep
def test_a_rollout_happens_again_as_it_was_written_down(rollouts):
    for number in (0, 2):
        row, replay = rollouts[number], recorded_replay(rollouts, number)
        assert (replay.failure.fault, replay.failure.degree) == (row.fault, row.degree)
        assert replay.onset == pytest.approx(row.onset, abs=1e-9)
        assert sum(replay.observed.values()) == pytest.approx(row.impact, abs=1e-6)
        assert len(replay.hits) == row.contacts and not any("dataset has" in note for note in replay.notes)


@pytest.mark.long  # needs a sweep
def test_differing_replays_are_reported(rollouts, monkeypatch):
    row = rollouts[0]
    monkeypatch.setattr(RecordedRollouts, "__getitem__", lambda self, number: row._replace(impact=row.impact + 1.0))
    assert any(f"The dataset has {row.impact + 1.0:.2f}" in note for note in recorded_replay(rollouts, 0).notes)


@pytest.mark.long  # needs a sweep
def test_faults_from_files_of_others_are_not_run(rollouts, tmp_path, monkeypatch):
    file = tmp_path / "theirs.py"
    file.write_text("raise RuntimeError('this ran')\n")
    theirs = {"fault": f"{file}:Theirs", "degree": "severe"}
    monkeypatch.setattr(rollouts, "sweep", replace(rollouts.sweep, faults=(theirs, theirs)))
    with pytest.raises(SettingError, match=r"failbench replay.*theirs\.py"):
        recorded_replay(rollouts, 0)


@pytest.mark.long  # needs a sweep
def test_the_viewer_keeps_a_replay_while_the_ordinary_motion_is_planned(rollouts):
    question, answer = rollouts.shown(0)
    errors: list[Exception] = []
    state = ViewerState(question, failed=errors.append, answer=answer)
    state.ask(question)
    replay = state.happen_again(rollouts, 0)
    assert state.worker.wait(_LONG) and errors == []
    assert state.replay is replay and state.motion is answer.chosen
    assert state.at(replay.onset + 0.1).failed
    state.ask(question.weighted(1.0))
    assert state.worker.wait(_LONG) and state.replay is None
    state.close()


ROW = Recorded(
    0, "<b>x</b>", "noise", "severe", onset=0.5, diverged=False, impact=2.0, dropped=True, spilled=0.25, contacts=3
)


def test_the_text_has_the_values_of_the_dataset():
    said = words.recorded_words(ROW, 4)
    assert "noise, severe" in said and "0, of 4" in said and "25%" in said and "<b>x</b>" not in said
    assert "blew up" in words.recorded_words(ROW._replace(diverged=True, impact=None), 4)
    assert "no such rollout" in words.recorded_words(None, 0)


def test_damaged_datasets_are_refused_by_name(tmp_path):
    (tmp_path / "manifest.json").write_text(json.dumps({"schema": "other"}))
    with pytest.raises(FormatError, match=r"manifest\.json"):
        RecordedRollouts(tmp_path, time_limit=1.0)


@pytest.mark.long  # needs a sweep
def test_the_scene_of_a_dataset_may_be_missing(rollouts, monkeypatch):
    motion = replace(rollouts.sweep.motions[0], scene="elsewhere")
    fresh = object.__new__(RecordedRollouts)
    fresh.__dict__.update(vars(rollouts), _shown={}, sweep=replace(rollouts.sweep, motions=(motion,)))
    with pytest.raises(gp.GracefulPlanError, match="unknown scene 'elsewhere'"):
        fresh.shown(0)
