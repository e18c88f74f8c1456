"""Recorded rollouts on the page: found by fault, replayed, predicted harm next to observed harm."""

from __future__ import annotations

import re

import pytest
from browsing import choose, click, enter, errors, state, text, until

import failbench as fb
import graceful_plan as gp

pytestmark = [
    pytest.mark.long,
    pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning"),
]


@pytest.fixture(scope="module")
def viewer(browser_parts, tmp_path_factory):
    """A viewer of a sweep of two faults on one short motion, two rollouts of each."""
    pytest.importorskip("pyarrow")
    from failbench.sweeps.definition import PlanSettings
    from failbench.sweeps.sweep import sweep_of

    folder = tmp_path_factory.mktemp("sweep") / "data"
    patterns = [f"tabletop/lift_to_goal/{fault}/severe" for fault in ("gripper_failure", "noise")]
    fb.generate_dataset(sweep_of(patterns, 2, plans=[PlanSettings(iterations=50)]), folder)
    with gp.view(str(folder), port=8390, time_limit=0.3) as viewer:
        yield viewer


def harm(page):
    """Return the harm on the page, predicted and observed."""
    found = until(lambda: re.search(r"all\s+([\d.]+)\s+([\d.]+)", text(page)))
    return float(found[1]), float(found[2])


def test_a_rollout_is_chosen_by_fault_and_happens_again(page, viewer):
    click(page, "Rollouts")
    until(lambda: "Let it happen again" in text(page))
    choose(page, "Fault", "gripper_failure")
    tab = viewer._page.controls.recorded
    until(lambda: "gripper_failure, severe" in text(page) and "of 2" in text(page))
    row = tab.rollouts[tab.number]
    assert f"{row.impact:.3g}" in text(page)
    click(page, "Let it happen again")
    predicted, observed = harm(page)
    assert observed == pytest.approx(row.impact, abs=0.006)
    assert predicted == pytest.approx(sum(state(viewer).replay.predicted.values()), abs=0.006)
    until(lambda: viewer._page.player.t > state(viewer).replay.onset)
    assert errors(page) == []


def test_another_failure_is_made_up_beside_them(page, viewer):
    click(page, "Failure")
    until(lambda: "Let it fail" in text(page))  # both tabs have a list of faults
    choose(page, "Fault", "power_loss")
    choose(page, "Degree", "critical")
    enter(page, "Moment [%]", 25)
    until(lambda: viewer._page.controls.moment.value == 25)
    click(page, "Let it fail")
    until(lambda: "power_loss, critical, at 25%" in text(page))
    replay = state(viewer).replay
    assert harm(page) == pytest.approx([sum(x.values()) for x in (replay.predicted, replay.observed)], abs=0.006)
    click(page, "Healthy motion again")
    until(lambda: state(viewer).replay is None)
    assert errors(page) == []
