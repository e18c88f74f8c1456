"""The worked examples of CONTRIBUTING.md are complete, keep their contracts, and work as described."""

import ast
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from places import ROOT

import failbench as fb
import graceful_plan as gp
from failbench.testing import check_fault
from graceful_plan.planners.planner import path_total
from graceful_plan.testing import PlannerTrial, check_cost, check_planner

TEXT = (ROOT / "CONTRIBUTING.md").read_text()
SNIPPETS = re.findall(r"^```python\n(.*?)^```", TEXT, flags=re.MULTILINE | re.DOTALL)


def defined() -> Mapping[str, Any]:
    """Return the classes of the snippets by name."""
    known: dict[str, Any] = {"gp": gp, "fb": fb, "np": np, "dataclass": dataclass, "path_total": path_total}
    for snippet in SNIPPETS:
        exec(compile(snippet, "CONTRIBUTING.md", "exec"), known)
    return known


@pytest.fixture(scope="module")
def examples():
    return defined()


@pytest.fixture(scope="module")
def task():
    return gp.load_scene("tabletop").tasks["lift_to_goal"]


def test_there_is_a_cost_a_fault_and_a_planner():
    assert [len(re.findall(rf"\({base}\)", "".join(SNIPPETS))) for base in ("gp.Cost", "fb.Fault", "gp.Planner")] == [
        1
    ] * 3


def test_the_cost_keeps_its_contract_and_counts(examples, task):
    check_cost(examples["Height"](), task.scene)
    plain, low = (
        gp.plan(
            task.start, task.goal, task.scene, objective=gp.Objective(impact=examples["Height"](), w=w), iterations=300
        )
        for w in (0.0, 5.0)
    )
    assert low.cost.impact < plain.cost.impact


def test_the_fault_keeps_its_contract_and_can_be_validated(examples, task):
    fault = examples["Brownout"](targets=("panda/joint2",))
    check_fault(fault)
    result = gp.plan(task.start, task.goal, task.scene, iterations=50, speed=0.5)
    assert fb.validate(result, task.scene, fault, n=4) is not None


@pytest.mark.long
def test_the_planner_keeps_its_contract_and_plans(examples, task):
    check_planner(examples["Retried"](), PlannerTrial(iterations=200, overrun=10.0))  # late, on a busy machine
    result = gp.plan(task.start, task.goal, task.scene, w=0.0, planner=examples["Retried"](), iterations=300)
    assert result.status is gp.PlanStatus.SOLVED


@pytest.mark.parametrize("line", re.findall(r"^`((?:gp|fb)\..*)`$", TEXT, flags=re.MULTILINE))
def test_the_line_below_an_example_is_a_call_that_python_understands(line):
    assert isinstance(ast.parse(line, mode="eval").body, ast.Call)
