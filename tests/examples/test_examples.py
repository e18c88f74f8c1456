"""The examples run and print what their texts promise."""

import importlib.util

import numpy as np
import pytest
from places import ROOT

import failbench as fb
import graceful_plan as gp

_EXAMPLES = ROOT / "examples"


def _load(name):
    spec = importlib.util.spec_from_file_location(name, _EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


SHORT = (
    "own_robot",
    "perception_loop",
    "custom_cost",
    "compare_planners",
    "tune_weight",
    "validate_plan",
    "fragile_last",
)


@pytest.mark.parametrize("name", SHORT)
def test_examples_are_short(name):
    assert len((_EXAMPLES / f"{name}.py").read_text().splitlines()) <= 40


@pytest.mark.long
def test_a_custom_robot_is_planned_for_and_fails(capsys):
    results = _load("own_robot").main(iterations=200, n=12)
    assert all(result.status is gp.PlanStatus.SOLVED for result in results.values())
    assert results[1.0].cost.impact < results[0.0].cost.impact
    assert capsys.readouterr().out.count("observed") == 2


@pytest.mark.long
def test_a_sensing_robot_carries_coffee_past_a_moving_box():
    example = _load("perception_loop")
    motion, took = example.main(seconds=1.5, iterations=5)
    assert len(took) >= 30
    state = motion.at(np.arange(0.0, motion.duration, 0.001))
    desk = gp.load_scene("desk").tasks["bring_coffee"].scene
    steps = np.abs(np.diff(state.qd, axis=0))
    assert np.all(steps <= 0.001 * desk.limits.acceleration * (1.0 + 1e-6))  # no jump, also where motions are joined
    assert gp.verify(motion, desk).passed
    executed = fb.execute(motion, fb.build_world(desk))
    assert executed.healthy.spilled < 0.01 and executed.tracking_error.max() < 0.02


@pytest.mark.long
def test_planners_are_compared_by_cost():
    found = _load("compare_planners").main(("rrt_connect", "auto"), iterations=300)
    assert len(found) == 2 and all(0.0 < totals["auto"] <= 1.05 * totals["rrt_connect"] for totals in found.values())


@pytest.mark.long
def test_a_weight_is_chosen_by_the_detour_it_costs():
    front, w = _load("tune_weight").main(iterations=2000)
    assert len(front) >= 3 and w is not None and 0.0 < w < 10.0


@pytest.mark.long
def test_a_motion_with_regard_for_failures_does_less_harm_in_simulation():
    reports = _load("validate_plan").main(n=60, iterations=500)
    assert reports["graceful"].observed.mean < 0.5 * reports["ordinary"].observed.mean


@pytest.mark.long
def test_custom_cost_keeps_the_mug_away(capsys):
    results = _load("custom_cost").main(iterations=2000)  # no time limit: it must pass on any machine
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


@pytest.mark.long
def test_a_pedestrian_on_a_map_is_avoided(capsys, tmp_path):
    results = _load("map_with_people").main(tmp_path / "floor.png", iterations=30_000)
    assert results["with regard for time"].verdict.checks["passing_by"].passed
    assert "drives into 'ben'" in capsys.readouterr().out and (tmp_path / "floor.png").exists()


@pytest.mark.long
def test_a_whole_task_is_planned_and_compared_with_the_opposite_order(capsys):
    result = _load("fragile_last").main(iterations=8)
    assert [step.kind for step in result.unwrap()] == ["pick", "place"] * 2
    assert "order" in capsys.readouterr().out
