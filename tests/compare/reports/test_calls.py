import math
from dataclasses import replace

import pytest
from bench_cases import comparison, solved

from graceful_plan import compare as bench
from graceful_plan.compare.reports.calls import ALL, call_summaries
from graceful_plan.compare.reports.report import page


def made_up():
    """Two kinds of problem, two problems each; the last start is refused."""
    kinds = {"a1": "a", "a2": "a", "b1": "b", "b2": "b", "disc": "analytic"}
    walls, over = (0.01, 0.02, 0.03), (-0.1, 0.001, 0.2)
    runs = [
        replace(
            solved(name, "p", 0, 1.0, first=wall / 10),
            seconds=0.5 + late,
            motion_wall=wall,
            motion_cpu=2 * wall,
            early=(early, 1.0),
        )
        for name, wall, late, early in zip(("a1", "a2", "b1"), walls, over, (math.inf, 2.0, 3.0), strict=True)
    ]
    refused = bench.Run(problem="b2", planner="p", seed=0, status="INVALID_START", seconds=0.01)
    return replace(comparison([*runs, refused, solved("disc", "p", 0, 1.0)], ("p",), tuple(kinds)), groups=kinds)


def test_calls_by_hand():
    a, b, every = call_summaries(made_up())
    assert (a.group, b.group, every.group) == ("a", "b", ALL)
    assert (a.runs, a.solved, a.refused) == (2, 2, 0)
    assert (b.runs, b.solved, b.refused) == (2, 1, 1)
    assert (a.search, a.motion_wall, a.motion_cpu) == pytest.approx((0.002, 0.02, 0.04))
    # The median of two is the worse one, and unsolved runs count as infinite.
    assert b.search == math.inf
    assert a.early == (math.inf, 1.0)
    assert every.motion_wall == pytest.approx(0.02)
    assert every.early == (3.0, 1.0)
    assert (a.most_over, b.most_over) == pytest.approx((0.001, 0.2))


def test_problems_in_the_plane_are_no_calls():
    assert all(row.group != "analytic" for row in call_summaries(made_up()))
    assert call_summaries(comparison([solved("disc", "p", 0, 1.0)], ("p",), ("disc",))) == ()


def test_calls_are_on_the_page_and_in_the_terminal():
    summary = bench.summarise(made_up())
    assert "Calls by kind of problem" in page(summary)
    assert "refused" in bench.text(summary)
    assert [row["group"] for row in summary.to_document()["calls"]] == ["a", "b", ALL]


def test_a_planner_that_solves_nothing_is_in_the_table_of_calls():
    refused = [bench.Run(problem=name, planner="q", seed=0, status="TIMEOUT", seconds=0.01) for name in ("a1", "a2")]
    good = made_up()
    for planners in (("p", "q"), ("q", "p")):
        both = replace(comparison([*good.runs, *refused], planners, tuple(good.groups)), groups=good.groups)
        lines = bench.text(bench.summarise(both)).splitlines()
        assert any("path 10 ms" in line or "path" in line for line in lines)
        row = next(line for line in lines if line.startswith("a ") and " q " in line)
        assert row.split()[2] == "0/2" and row.rstrip().endswith("–")
