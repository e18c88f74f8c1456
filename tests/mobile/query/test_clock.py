"""Steps of a base's call are begun if they fit, and what they take is learnt."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.mobile.query import clock as clock_module
from graceful_plan.mobile.query.clock import Clock, Paces, paces_of


@pytest.fixture
def still(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """Stop the time that clocks read, at `still.now`."""
    time_of = SimpleNamespace(now=0.0, perf_counter=lambda: time_of.now)
    monkeypatch.setattr(clock_module, "time", time_of)
    return time_of


def _clock(seconds: float, **steps: list[float]) -> Clock:
    paces = Paces()
    for step, runs in steps.items():
        for run in runs:
            paces.took(step, run)  # type: ignore[arg-type]
    return Clock(clock_module.time.perf_counter() + seconds, paces)


@pytest.mark.usefixtures("still")
def test_there_is_room_for_what_ends_in_time() -> None:
    assert _clock(10.0, judging=[1.0, 2.0, 3.0], timing=[1.0]).has_room("timing", "judging")
    assert not _clock(3.5, judging=[1.0, 2.0, 3.0], timing=[1.0]).has_room("timing", "judging")
    assert not _clock(0.0, judging=[0.1]).has_room("judging")
    assert Clock().has_room("timing", "judging")


@pytest.mark.usefixtures("still")
def test_somebody_has_to_try() -> None:
    """Before there are any runs nothing is known that would be against one, but time is kept for it."""
    assert _clock(-1.0).has_room("judging") and _clock(-1.0, timing=[1.0]).has_room("timing", "judging")
    assert 0.01 < _clock(1.0).reserve(1.0) < 0.2


@pytest.mark.usefixtures("still")
def test_a_single_long_run_is_forgotten_sooner_than_what_runs_mostly_take() -> None:
    def tries(clock: Clock) -> int:
        return next(k for k in range(1000) if clock.has_room("judging"))

    single, always = _clock(1.0, judging=[0.1, 0.1, 5.0]), _clock(1.0, judging=[5.0])
    assert 5 < tries(single) < 100 < tries(always)
    always.paces.took("judging", 5.0)  # it was too late, and is not tried again so soon
    assert tries(always) > 100


def test_predictions_of_those_who_move_keep_what_was_learnt(task) -> None:
    person = gp.MovingEntity("person", "adult", size=[0.2, 0.85], t=[0.0], position=[[9.0, 9.0, 0.85]])
    crossing = task.scene.with_moving(person)
    assert paces_of(crossing) is paces_of(task.scene) is paces_of(crossing.without_moving())


@pytest.mark.usefixtures("still")
def test_what_a_call_needs_is_tried_if_it_mostly_fits() -> None:
    clock = _clock(1.0, judging=[0.1, 0.1, 0.1, 5.0])
    assert not clock.has_room("judging") and clock.may_do("judging")
    assert not _clock(1.0, judging=[0.1, 5.0, 5.0]).may_do("judging")
    assert not _clock(-1.0, judging=[0.1]).may_do("judging")


def test_what_is_kept_follows_what_was_measured(still: SimpleNamespace) -> None:
    slow, quick = (_clock(1.0, judging=[x], timing=[x], ending=[0.0]) for x in (0.1, 0.001))
    assert slow.reserve(10.0) == pytest.approx(0.4)
    assert quick.reserve(10.0) == pytest.approx(0.1) and quick.reserve(0.01) == pytest.approx(0.004)
    assert slow.reserve(0.1) < 0.1  # something is left to search
    assert slow.reserve(10.0, insured=True) == pytest.approx(0.2)  # one more motion, and the judge
    with quick.measured("timing"):
        still.now += 0.02
    assert quick.paces.longest("timing") == pytest.approx(0.02)
    endless = Clock()
    endless.ended(-np.inf)
    assert endless.paces.longest("ending") == 0.0


@pytest.mark.usefixtures("still")
@pytest.mark.parametrize(("left", "plenty", "insured"), [(0.1, False, False), (0.3, False, True), (0.5, True, True)])
def test_who_has_a_motion_begins_another_later(left, plenty, insured) -> None:
    clock = _clock(left, judging=[0.1], timing=[0.1])
    assert clock.has_plenty("timing", "judging") is plenty
    assert clock.has_plenty("timing", "judging", insured=True) is insured
