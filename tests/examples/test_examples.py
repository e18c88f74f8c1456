"""The examples run, and do what they say."""

import importlib.util

import pytest
from places import ROOT

import graceful_plan as gp

_EXAMPLES = ROOT / "examples"


def _load(name):
    spec = importlib.util.spec_from_file_location(name, _EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.long
def test_custom_cost_keeps_the_mug_away(capsys):
    results = _load("custom_cost").main(iterations=2000)  # no clock: it has to hold on any machine
    assert results["away"].cost.impact < 0.8 * results["shortest"].cost.impact
    assert "away: SOLVED" in capsys.readouterr().out


@pytest.mark.long
@pytest.mark.parametrize("planner", sorted(gp.PLANNERS))
def test_every_planner_takes_the_custom_cost(planner):
    task = gp.load_scene("tabletop_l1").tasks["far_to_near"]
    objective = gp.Objective(impact=_load("custom_cost").Nearness((0.0, -0.4, 0.5)), w=1.0)
    result = gp.plan(task.start, task.goal, task.scene, objective=objective, planner=planner, iterations=100)
    assert result.status in (gp.PlanStatus.SOLVED, gp.PlanStatus.TIMEOUT)
    if result.status is gp.PlanStatus.SOLVED:
        assert result.cost.impact == pytest.approx(gp.evaluate(result.trajectory, task.scene, objective).impact)


@pytest.mark.long
def test_a_patient_robot_spares_the_walking_person(capsys):
    example = _load("walking_person")
    results = example.main(iterations=300)
    scene = gp.load_scene("tabletop").tasks["right_to_left"].scene.with_moving(example.walking_person())
    spared, alone = (
        gp.evaluate(results[name].unwrap(), scene, example.OBJECTIVE).impact_by_entity["person"]
        for name in ("patient", "alone")
    )
    assert spared < 0.1 * alone
    assert "patient: waits" in capsys.readouterr().out
