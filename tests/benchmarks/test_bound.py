"""Bound of `prevention`, the choice by rollouts, and noticed failures: figures from stored lines."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from benchmarks.prevention.bound import bound_table, read_bounds
from benchmarks.prevention.bound_record import DEFAULT, NAMED, PRIORS, SIZES, TASKS, Bound, Modelled
from benchmarks.prevention.bound_tables import limit_of, rank_of, share_of
from benchmarks.prevention.choosing import Choice, choice_section, read_choices
from benchmarks.prevention.noticed import ARM, GRIPPER, Noticed, noticed_section, read_noticed
from benchmarks.prevention.runs import NONE
from benchmarks.suite import unseen_scenes

from benchmarks import store


def seen(motion: float = 1.0, impact: float = 1.0) -> Modelled:
    return Modelled(motion=motion, impact=dict.fromkeys(PRIORS, impact), height=1.0, aside=0.0, end=0.0)


def bound(
    task: str, plain: float, default: float, best: float, longer: float = 1.0, modelled: Modelled | None = None
) -> Bound:
    """Return a task in which the named motions do the same harm, and another motion is the best."""
    harm = {name: default for name in NAMED} | {NONE: plain, "other": best}
    duration = dict.fromkeys(harm, 1.0) | {"other": longer}
    each, chosen = {kind: harm for kind in SIZES}, dict.fromkeys(SIZES, "other")
    return Bound(
        task=task,
        duration=duration,
        modelled=dict.fromkeys(harm, seen()) | {"other": modelled or seen()},
        first=each,
        second=each,
        others=each,
        best=chosen,
        best_at_speed=chosen,
    )


def test_the_share_sums_reductions_over_tasks():
    two = [bound("a/x", 4.0, 2.0, 1.0), bound("b/y", 1.0, 1.0, 0.5)]
    found = share_of(two, "drops", DEFAULT)
    assert found.mean == pytest.approx((0.5 + 0.0) / (0.75 + 0.5))
    assert found.low <= found.mean <= found.high
    assert share_of([bound("a/x", 4.0, 1.0, 1.0)], "mixed", DEFAULT).mean == pytest.approx(1.0)


def test_a_best_motion_that_does_more_harm_than_at_w_0_leaves_nothing_attainable():
    two = [bound("a/x", 4.0, 2.0, 8.0), bound("b/y", 4.0, 2.0, 2.0)]
    assert share_of(two, "drops", DEFAULT).mean == pytest.approx((0.5 + 0.5) / (0.0 + 0.5))


def test_harm_per_task_counts_the_duration():
    slow = bound("a/x", 4.0, 2.0, 1.0, longer=2.0)
    assert slow.less("drops", "other") == pytest.approx(0.5)


def test_the_tables_show_every_task_and_the_best_motion():
    text = bound_table([bound("desk/x", 4.0, 2.0, 1.0), bound("studio/y", 1.0, 1.0, 0.5)], SIZES)
    assert f"2 of {len(TASKS)} tasks, 1 of them unseen" in text
    assert "| desk/x | drops | 8 | 2.00 | 2.00 | 2.00 | 2.00 | 2.00 | 4.00 | 4.00 | other | +0 % |" in text
    assert len([line for line in text.splitlines() if "share of the attainable |" in line and ">= 0.9" in line]) == (
        len(PRIORS) * len(SIZES)
    )
    assert "| drops | default | 1 | 1.00 [1.00, 1.00] | 1.00 [1.00, 1.00] | 0 | 0 | +0 % |" in text
    assert "No task is finished" in bound_table([], SIZES)


@pytest.mark.parametrize(
    ("best", "limit"),
    [
        (seen(motion=0.9, impact=0.5), "search"),
        (seen(motion=2.0, impact=0.5), "weight"),
        (seen(motion=1.0, impact=2.0), "model"),
    ],
)
def test_what_keeps_the_planner_from_the_best_motion(best: Modelled, limit: str):
    assert limit_of(bound("a/x", 4.0, 2.0, 1.0, modelled=best), "drops") == limit
    assert limit_of(bound("a/x", 4.0, 2.0, 1.95, modelled=best), "drops") == ""  # too little to tell


def test_the_model_picks_by_cost_or_by_predicted_harm_among_motions_at_the_same_speed():
    one = bound("a/x", 4.0, 2.0, 1.0, modelled=seen(motion=3.0, impact=0.5))
    fast = "w = 0.3, speed 0.65"
    one = replace(one, duration={**one.duration, fast: 0.7}, modelled={**one.modelled, fast: seen(0.1, 0.1)})
    assert one.least("default", 0.3) == NONE  # first of those with 1 + 0.3
    assert one.least("default", 10.0) == "other"  # 3 + 5
    assert one.least("default", math.inf) == "other"
    assert one.less_first("drops", "other") == pytest.approx(0.75)


def test_the_rank_correlation_is_that_of_predicted_and_raced_harm():
    impacts = dict(zip(NAMED, np.linspace(1.0, 2.0, len(NAMED)), strict=True))
    one = bound("a/x", 4.0, 2.0, 1.0)
    one = replace(one, modelled={name: seen(impact=x) for name, x in impacts.items()})
    assert rank_of(replace(one, first={"drops": impacts}), "drops") == pytest.approx(1.0)
    reverse = {name: -x for name, x in impacts.items()}
    assert rank_of(replace(one, first={"drops": reverse}), "drops") == pytest.approx(-1.0)


def test_half_of_the_tasks_are_unseen():
    unseen = [name for name in TASKS if name.split("/")[0] in unseen_scenes()]
    assert len(TASKS) >= 12 and 2 * len(unseen) == len(TASKS)


def test_tasks_without_the_motions_to_compare_are_left_out(tmp_path):
    file = tmp_path / "bound.jsonl"
    one, other = bound("a/x", 4.0, 2.0, 1.0), bound("b/y", 1.0, 1.0, 0.5)
    refused = replace(bound("c/z", 1.0, 1.0, 1.0), duration={"other": 1.0})
    file.write_text("".join(store.line(x) for x in (one, refused, other)), encoding="utf-8")
    assert read_bounds(file) == [one, other]


def test_choices_are_summed_up(tmp_path):
    file = tmp_path / "choices.jsonl"
    found = [
        Choice(task="a/x", candidates=4, best=2, less=(2.0, 1.5, 2.5), longer=1.1, seconds=9.0),
        Choice(task="b/y", candidates=3),
        Choice(task="c/z", candidates=3, best=1, less=(0.8, 0.7, 0.9)),
        Choice(task="d/w", refused="too fast"),
    ]
    file.write_text("".join(store.line(x) for x in found), encoding="utf-8")
    text = "\n".join(choice_section(read_choices(file)))
    assert "own motion, median | >= 1.1 | 1 | **no** |" in text
    assert "more harm beyond their interval | none | 1 | **no** |" in text
    assert f"3 of {len(TASKS)} tasks; geometric mean {np.exp(np.log([2.0, 1.0, 0.8]).mean()):.2f}" in text
    assert "| d/w | too fast |" in text
    assert "No task is finished" in "\n".join(choice_section([]))


def test_noticed_failures_are_summed_up(tmp_path):
    file = tmp_path / "noticed.jsonl"
    harm = {fault: [4.0, 2.0] for fault in (*ARM, *GRIPPER)}
    half = {fault: [2.0, 1.0] for fault in (*ARM, *GRIPPER)}
    found = [Noticed(task=name, observed=harm, predicted=half) for name in ("a/x", "b/y")]
    file.write_text("".join(store.line(x) for x in found), encoding="utf-8")
    text = "\n".join(noticed_section(read_noticed(file)))
    assert "| arm | 4.00 | 2.00 | 2.00 | 1.00 | 0.5 [0.5, 0.5] |" in text
    assert "| a/x | 4.00 | 2.00 | 2.00 | 1.00 | 0.50 |" in text
    assert "No task is finished" in "\n".join(noticed_section([]))
