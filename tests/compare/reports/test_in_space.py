"""The 3-D view on the page of a comparison: the right motions, or the reason why there is none."""

from __future__ import annotations

import importlib.util
from dataclasses import replace

import numpy as np
import pytest
from bench_cases import comparison, solved

import graceful_plan as gp
from graceful_plan import compare as bench
from graceful_plan.compare.reports import in_space as module
from graceful_plan.compare.reports.report import page

TASK = "tabletop/lift_to_goal"


def moving(planner, total, pieces=3, problem=TASK):
    """Return an invented run with a short motion."""
    task = gp.load_scene("tabletop").tasks["lift_to_goal"]
    q = np.linspace(task.start, task.start + 0.1, pieces)
    motion = gp.retime(gp.Path(q), task.scene.limits, task.scene.joints)
    rows = {name: tuple(map(tuple, x.tolist())) for name, x in (("path", motion.q), ("velocities", motion.qd))}
    run = solved(problem, planner, 0, total)
    return replace(run, times=tuple(motion.t.tolist()), duration=motion.duration, **rows)


def summary(runs, source="tabletop", digest=""):
    problems = tuple(dict.fromkeys(run.problem for run in runs))
    found = comparison(runs, tuple(dict.fromkeys(run.planner for run in runs)), problems)
    notes = [
        {"name": name, "kind": "task", "source": source, "item": "lift_to_goal", "group": "tabletop"}
        | {"ends": [None, None], "digest": digest}
        for name in problems
    ]
    return bench.summarise(replace(found, settings={"problems": notes}))


@pytest.fixture
def asked(monkeypatch):
    """Record the arguments of the view, which has its own tests."""
    asked = []
    monkeypatch.setattr(module, "report_view", lambda *all: asked.append(all) or ("<p>a view</p></script>", ""))
    return asked


def test_the_view_shows_the_problem_on_which_planners_differ_most(asked):
    others = [moving(name, total, problem="tabletop/other") for name, total in (("a", 5.0), ("b", 6.0), ("c", 5.5))]
    runs = [*others, moving("a", 3.0, 4), moving("b", 2.0, 5), moving("c", 2.5, 6)]
    found = bench.in_space(summary(runs))
    assert found["of"].startswith(f"{TASK}, on which totals differ most: b, seed 0, total 2 in ")
    assert "as a ghost a, seed 0, total 3 in" in found["of"]
    ((motion, scene, other, label),) = asked
    assert label == "a" and scene.notes.name == "tabletop"
    assert [len(motion.q), len(other.q)] == [len(runs[4].path), len(runs[3].path)]


def test_a_single_planner_is_shown_without_ghost(asked):
    found = bench.in_space(summary([moving("a", 2.0)]))
    assert "ghost" not in found["of"] and asked[0][2] is None


def test_untimed_and_unsolved_runs_are_not_shown(asked):
    untimed = replace(moving("a", 2.0), times=(), velocities=())
    assert bench.in_space(summary([untimed])) is None
    failed = replace(moving("a", 2.0), status="TIMEOUT")
    assert bench.in_space(summary([failed])) is None and asked == []


def test_missing_scenes_are_named(asked):
    assert "without --report-only" in bench.in_space(summary([moving("a", 2.0)], digest="12"))["why"]
    elsewhere = moving("a", 2.0)
    assert "cannot be shown" in bench.in_space(summary([elsewhere], source="desk"))["why"]
    assert "scene 'moon'" in bench.in_space(summary([elsewhere], source="moon"))["why"]
    assert asked == []


@pytest.mark.long
def test_the_view_cannot_end_its_script(asked):
    found = summary([moving("a", 2.0)])
    text = page(found, bench.in_space(found))
    assert text.count("</script>") == 1 and "\\u003cp>a view\\u003c/p>\\u003c/script>" in text
    without = page(found, {"of": "x", "page": "", "why": "<none>"})
    assert "&lt;none&gt;" in without and "<script" not in without and "<iframe" not in without


@pytest.mark.skipif(importlib.util.find_spec("viser") is None, reason="viser is not installed")
def test_the_view_is_a_whole_document():
    assert "__VISER_EMBED_DATA__" in bench.in_space(summary([moving("a", 2.0), moving("b", 3.0)]))["page"]
