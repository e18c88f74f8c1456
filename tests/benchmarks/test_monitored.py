"""Plan and monitor: tables from stored episodes."""

from __future__ import annotations

import math
from dataclasses import replace

from benchmarks.monitored import CONDITIONS, WATCHED, Episodes, tables


def episodes(
    task: str, condition: str, harm: float, *, healthy: float = 0.0, degree: str = "severe", delay: float = 0.1
) -> Episodes:
    """Return episodes with a drop that is noticed after `delay` (NaN: missed) and noise that is missed."""
    watched = CONDITIONS[condition][1]
    faults = [f"{name}/{degree}" for name in ("gripper_failure", "noise")]
    return Episodes(
        task=task,
        condition=condition,
        robot=0,
        harm=dict.fromkeys(faults, harm),
        delay=dict(zip(faults, (delay if watched else math.nan, math.nan), strict=True)),
        kind=dict.fromkeys(faults, "opening" if watched else ""),
        healthy=healthy,
        stopped=[False, True] if watched else [],
        duration=2.0,
        seconds=1.0,
        degree=degree,
    )


def whole(task: str, least: float, healthy: float = 0.0) -> list[Episodes]:
    """Return all conditions of a task: 6 at w = 0, `least` for plan and monitor, 3 for each alone."""
    harm = {"w = 0": 6.0, WATCHED: least}
    return [episodes(task, c, harm.get(c, 3.0), healthy=healthy) for c in CONDITIONS]


def unsolved(task: str) -> list[Episodes]:
    """Return all conditions of a task for which the planner finds no motion."""
    nothing = {"harm": {}, "delay": {}, "kind": {}, "stopped": [], "healthy": math.nan, "duration": math.nan}
    return [replace(one, **nothing) for one in whole(task, 1.0)]


def test_targets_are_medians_over_the_tasks():
    text = "\n".join(tables([*whole("a/x", 1.0), *whole("b/y", 2.0), *whole("c/z", 3.0)]))
    assert "3 tasks, 3 robots" in text
    assert "median of tasks | >= 3 | 3 [2, 6] | yes |" in text
    assert "stopped by a false alarm | <= 0.01 | 0.5 [" in text
    assert "duration over that of w = 0, median of tasks | <= 1.05 | 1 [1, 1] | yes |" in text
    assert "| b/y | 12.00 | 6.00 | 6.00 | 4.00 | +0 % |" in text


def test_tasks_without_a_motion_or_with_harm_by_the_healthy_robot_are_named_and_left_out():
    text = "\n".join(tables([*whole("a/x", 1.0), *whole("b/y", 1.0, healthy=5.0), *unsolved("c/z")]))
    assert "1 tasks, 1 robots" in text
    assert "harm without a failure and a monitor: `b/y`. The monitor stops 2 of 4" in text
    assert "finds no motion: `c/z`" in text
    assert "No task is finished" in "\n".join(tables(unsolved("c/z")))


def test_notices_are_counted_by_degree():
    minor = episodes("a/x", WATCHED, 0.0, degree="minor", delay=math.nan)
    critical = episodes("a/x", WATCHED, 9.0, degree="critical", delay=0.05)
    harmful = [*whole("b/y", 1.0, healthy=5.0), episodes("b/y", WATCHED, 1.0, degree="minor")]
    text = "\n".join(tables([*whole("a/x", 1.0), minor, critical, *harmful]))
    assert "| gripper_failure | 0 of 1 | 0 of 0 | 1 of 1, 0.10 s | 1 of 1, 0.05 s |" in text
    assert "| noise | 0 of 1 | 0 of 0 | 0 of 1 | 0 of 1 |" in text
    assert "| gripper_failure | 0 of" not in "\n".join(tables(whole("a/x", 1.0)))
    assert "1 tasks, 1 robots" in text  # other degrees are no other robots
