from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import graceful_plan as gp
from failbench.comparison import compare, harm_ratio
from failbench.report import ValidationReport
from failbench.validation import validate
from graceful_plan.exceptions import SettingError


@cache
def scene() -> gp.Scene:
    return gp.load_scene("tabletop").tasks["green_to_blue"].scene


@cache
def motion(lift: float) -> gp.Trajectory:
    """Return a motion to the same goal that lifts joint 2 by `lift` [rad] halfway."""
    task = gp.load_scene("tabletop").tasks["green_to_blue"]
    ends = np.stack([task.start, task.goal[0]])
    middle = ends.mean(axis=0) - lift * np.eye(7)[1]
    return gp.retime(gp.Path(np.stack([ends[0], middle, ends[1]])), scene().limits, scene().joints, speed=0.5)


@cache
def report(lift: float) -> ValidationReport:
    return validate(motion(lift), scene(), "drop/*/severe", n=30, horizon=0.5, threads=2)


@pytest.mark.long
def test_pairs_share_their_random_numbers() -> None:
    first, second = report(0.0), report(0.5)
    difference = compare(first, second)
    assert difference.mean == pytest.approx(first.observed.mean - second.observed.mean)
    assert difference == compare(motion(0.0), motion(0.5), scene(), "drop/*/severe", n=30, horizon=0.5)
    back = compare(second, first)
    assert (back.mean, back.low, back.high) == pytest.approx((-difference.mean, -difference.high, -difference.low))
    assert compare(first, first).mean == 0.0


def test_per_task_longer_motions_count_for_more() -> None:
    first, second = report(0.0), report(0.5)
    assert first.duration != second.duration
    difference = compare(first, second, per="task")
    assert difference.mean == pytest.approx(first.observed_per_task.mean - second.observed_per_task.mean)
    slow = replace(first, duration=2.0 * first.duration)
    assert compare(slow, first).mean == 0.0 < compare(slow, first, per="task").low
    assert harm_ratio(slow, first).mean == pytest.approx(2.0)
    assert harm_ratio(slow, first, per="failure").mean == pytest.approx(1.0)


def test_ratios_do_not_depend_on_the_rate() -> None:
    pair = report(0.0), report(0.5)
    ratio = harm_ratio(*pair)
    assert ratio.mean == pytest.approx(pair[0].observed_per_task.mean / pair[1].observed_per_task.mean)
    assert ratio.low < ratio.mean < ratio.high
    often = [replace(found, rate=60.0) for found in pair]
    assert harm_ratio(*often).mean == pytest.approx(ratio.mean)
    assert harm_ratio(*often).low == pytest.approx(ratio.low)


def test_diverged_rollouts_are_in_no_pair() -> None:
    impacts = report(0.0).impacts.copy()
    impacts[:10] = np.nan
    assert compare(replace(report(0.0), impacts=impacts), report(0.5)).n == 20
    assert harm_ratio(report(0.5), replace(report(0.0), impacts=impacts)).n == 20


def test_misuse_is_refused() -> None:
    with pytest.raises(SettingError, match="scene = None"):
        compare(motion(0.0), motion(0.0))
    with pytest.raises(SettingError, match="n, seed"):
        compare(report(0.0), replace(report(0.0), jobs=report(0.0).jobs[:-1]))
    with pytest.raises(SettingError, match=r"per = 'hour'.*'failure'.*'task'"):
        harm_ratio(report(0.0), report(0.0), per="hour")
    with pytest.raises(SettingError, match=r"0\.001"):
        harm_ratio(report(0.0), replace(report(0.0), rate=1.0))
