from __future__ import annotations

import dataclasses
import inspect
import json
import re
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import graceful_plan as gp
from failbench import (
    AtFraction,
    ContactEvent,
    Fault,
    HealthyHarm,
    ObjectLost,
    Rollout,
    RolloutRequest,
    SimSettings,
    Uniform,
)
from failbench.comparison import compare, harm_ratio
from failbench.fault.registry import GripperFailure, Noise, PowerLoss
from failbench.report import ValidationReport
from failbench.scenario import scenarios
from failbench.validation import chosen_faults, predicted_impact, validate
from graceful_plan import ImpactCost, Objective, PlanningFailed, PlanResult, PlanStatus
from graceful_plan.costs.objective import moving_batch
from graceful_plan.exceptions import SettingError, UnknownNameError

_EXACT = 1e-9
"""Sums agree up to rounding."""


@cache
def scene() -> gp.Scene:
    return gp.load_scene("tabletop").tasks["green_to_blue"].scene


@cache
def motion(w: float = 0.0) -> gp.Trajectory:
    task = gp.load_scene("tabletop").tasks["green_to_blue"]
    return gp.plan(task.start, task.goal, scene(), w=w, iterations=20, speed=0.5).unwrap()


@cache
def report(w: float = 0.0, importance: bool = False) -> ValidationReport:
    return validate(motion(w), scene(), "drop/*/severe", n=30, horizon=0.5, threads=2, importance=importance)


# --- with simulation -------------------------------------------------------------------------------------------------


def test_shares_add_up() -> None:
    found = report()
    assert (found.n, found.effective_n, found.diverged) == (30, 30.0, 0)
    assert sum(entity.impact.mean for entity in found.by_entity.values()) == pytest.approx(found.observed.mean)
    assert sum(entity.predicted for entity in found.by_entity.values()) == pytest.approx(found.predicted)
    assert list(found.by_fault) == ["gripper_failure/severe", "weak_grip/severe", "stuck_gripper/severe"]
    assert np.mean([e.mean for e in found.by_fault.values()]) == pytest.approx(found.observed.mean)
    assert {e.n for e in found.by_fault.values()} == {10}
    assert list(found.by_entity) == [*scene().entities, "green"]
    own = found.by_entity["green"]
    assert own.impact == found.own_loss
    assert own.impact.mean == pytest.approx(scene().own_severity * own.probability.mean)
    assert 0.0 < own.probability.mean < 1.0 and own.predicted > 0.0
    assert found.dropped.mean > 0.9
    assert found.observed.mean > 0.0
    assert found.energy.mean <= found.observed.mean


def test_the_same_seed_gives_the_same_report_on_any_number_of_threads() -> None:
    again = validate(motion(), scene(), ["drop/*/severe"], n=30, horizon=0.5, threads=1)
    assert again.to_json() == report().to_json()
    assert np.array_equal(again.impacts, report().impacts)


def test_configurations_are_timed_first() -> None:
    q = motion().sample(0.5).q
    found = validate(q, scene(), GripperFailure(), n=2, horizon=0.1)
    assert found.n == 2


def test_importance_sampling_estimates_the_same() -> None:
    weighted, even = report(importance=True), report()
    assert weighted.effective_n < even.effective_n
    assert weighted.predicted == even.predicted
    low, high = max(weighted.observed.low, even.observed.low), min(weighted.observed.high, even.observed.high)
    assert low < high
    with pytest.raises(SettingError, match="no importance sampling"):
        compare(weighted, even)


# --- prediction ------------------------------------------------------------------------------------------------------


def test_the_prediction_is_the_planners_own_impact_per_second() -> None:
    cost = gp.evaluate(motion(), scene(), Objective(exposure="time"))
    per_second = cost.impact / motion().duration
    found = report()
    assert found.predicted == pytest.approx(per_second, rel=0.01)
    for name, share in cost.impact_by_entity.items():
        assert found.by_entity[name].predicted == pytest.approx(share / motion().duration, abs=0.01 * per_second)


def test_the_prediction_is_taken_where_failures_begin(simulated: Callable[..., None]) -> None:
    simulated(lambda job: ())
    at = {
        fraction: validate(motion(), scene(), GripperFailure(when=AtFraction(fraction)), n=1).predicted
        for fraction in (0.2, 0.7)
    }
    for fraction, predicted in at.items():
        state = motion().at(motion().t[0] + fraction * motion().duration)
        q, qd = state.q, state.qd
        exact = ImpactCost().state(moving_batch(scene(), q[None], qd[None]))[0]
        assert predicted == pytest.approx(exact, abs=_EXACT)
    both = [GripperFailure(when=AtFraction(fraction)) for fraction in at]
    assert validate(motion(), scene(), both, n=2).predicted == pytest.approx(np.mean(list(at.values())))


def test_another_impact_cost_predicts_otherwise(simulated: Callable[..., None]) -> None:
    simulated(lambda job: ())
    arm = ImpactCost(model="box_overlap", components=("body",))
    times = np.linspace(0.0, motion().duration, 2001)
    exact = predicted_impact(motion(), scene(), times, arm).sum(axis=1).mean()
    found = validate(motion(), scene(), GripperFailure(), n=1, prediction=arm)
    assert found.predicted == pytest.approx(exact, rel=0.01)
    assert exact > 0.0


# --- statistics, on invented rollouts ---------------------------------------------------------------------------------


def event(entity: str, striker: str = "carried", secondary: bool = False) -> ContactEvent:
    return ContactEvent(
        striker=striker,
        entity=entity,
        time=0.1,
        position=(0.0, 0.0, 0.0),
        peak_force=1.0,
        impulse=1.0,
        speed=1.0,
        energy=1e3,
        secondary=secondary,
    )


@pytest.fixture
def simulated(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Return a function that replaces the simulation: hits are a function of the job."""

    def replace(
        touched: Callable[[RolloutRequest], tuple[ContactEvent, ...]],
        diverged: Callable[[RolloutRequest], bool] | None = None,
    ):
        def run(execution, jobs, **_):
            return [
                Rollout(
                    job=job,
                    onset=job.onset,
                    events=touched(job),
                    status="diverged" if diverged is not None and diverged(job) else "completed",
                )
                for job in jobs
            ]

        monkeypatch.setattr(sys.modules["failbench.validation"], "run_rollouts", run)

    return replace


def early(job: RolloutRequest) -> bool:
    return job.onset < 0.25 * motion().duration


def test_severities_of_components_and_entities_add_up(simulated: Callable[..., None]) -> None:
    simulated(lambda job: (event("red1"), event("red1", "body"), event("table")) if early(job) else ())
    found = validate(motion(), scene(), GripperFailure(), n=400)
    # 10 for each hit of the red box, 1 for the table, and 2 for the object, which arrives with 1 kJ.
    assert found.observed.mean == pytest.approx(0.25 * 23.0)
    assert found.by_entity["red1"].probability.mean == pytest.approx(0.25)
    assert found.by_entity["red1"].impact.mean == pytest.approx(5.0)
    assert found.by_entity["table"].impact.mean == pytest.approx(0.25)
    assert found.by_entity["green"].impact.mean == found.own_loss.mean == pytest.approx(0.5)
    assert found.by_entity["red2"].impact.mean == 0.0
    assert 0.0 < found.by_entity["red2"].probability.high < 0.01
    assert found.observed.low < 5.75 < found.observed.high


def test_the_objects_own_loss_counts_if_it_is_predicted(simulated: Callable[..., None]) -> None:
    simulated(lambda job: (event("table"),))
    without = validate(motion(), scene(), GripperFailure(), n=20, prediction=ImpactCost(own_loss=False))
    assert without.observed.mean == 1.0 and without.own_loss.mean == pytest.approx(2.0)
    assert "green" not in without.by_entity
    both = validate(motion(), scene(), GripperFailure(), n=20)
    assert both.observed.mean == pytest.approx(3.0)
    assert both.predicted == pytest.approx(without.predicted + both.by_entity["green"].predicted)
    # Algorithm 1 has no loss of the object, but it is observed all the same.
    published = validate(motion(), scene(), GripperFailure(), n=20, prediction=ImpactCost(model="box_overlap"))
    assert published.observed == both.observed and published.by_entity["green"].predicted == 0.0


def test_secondary_touches_are_kept_apart(simulated: Callable[..., None]) -> None:
    simulated(lambda job: (event("red1", "white1", secondary=True),))
    found = validate(motion(), scene(), GripperFailure(), n=10)
    assert found.observed.mean == 0.0
    assert found.by_entity["red1"].probability.mean == 0.0
    assert found.secondary.mean > 0.0


def test_diverged_rollouts_are_counted_and_in_no_mean(simulated: Callable[..., None]) -> None:
    simulated(lambda job: (event("red1"),), diverged=early)
    found = validate(motion(), scene(), GripperFailure(), n=40)
    assert (found.n, found.diverged, found.observed.n) == (40, 10, 30)
    assert found.observed.mean == pytest.approx(10.0 + scene().own_severity)
    assert np.count_nonzero(np.isnan(found.impacts)) == 10
    assert "10 diverged" in str(found)
    assert json.loads(found.to_json())["diverged"] == 10
    simulated(lambda job: (event("red2"),))
    sound = validate(motion(), scene(), GripperFailure(), n=40)
    assert compare(found, sound).n == 30


def test_if_everything_diverges_nothing_is_known(simulated: Callable[..., None]) -> None:
    simulated(lambda job: (), diverged=lambda job: True)
    found = validate(motion(), scene(), GripperFailure(), n=3)
    assert np.isnan(found.observed.mean)
    assert found.observed.high == found.greatest == 10.0
    assert json.loads(found.to_json())["observed"] == {"mean": None, "low": 0.0, "high": 10.0, "n": 0}
    assert "nan" in str(found)


def test_importance_sampling_is_unbiased(simulated: Callable[..., None]) -> None:
    simulated(lambda job: (event("red1"),) if early(job) else ())
    without = ImpactCost(own_loss=False)
    found = validate(motion(), scene(), GripperFailure(), n=4000, importance=True, prediction=without)
    assert found.observed.mean == pytest.approx(2.5, abs=0.05)
    assert found.by_entity["red1"].probability.mean == pytest.approx(0.25, abs=0.005)
    assert found.by_fault["gripper_failure/severe"] == found.observed


def test_progress_reaches_the_end(simulated: Callable[..., None]) -> None:
    simulated(lambda job: ())
    seen: list[tuple[int, int]] = []
    validate(motion(), scene(), GripperFailure(), n=300, progress=lambda done, n: seen.append((done, n)))
    assert seen[-1] == (300, 300)
    assert len(seen) > 1
    assert seen == sorted(seen)


def test_harm_per_task_is_that_per_failure_times_the_failures(simulated: Callable[..., None]) -> None:
    simulated(lambda job: (event("red1"),) if early(job) else ())
    found = validate(motion(), scene(), GripperFailure(), n=40, rate=3.6)
    assert found.duration == pytest.approx(motion().duration)
    assert found.failures_per_task == pytest.approx(3.6 / 3600.0 * motion().duration)
    assert found.observed_per_task.mean == pytest.approx(found.observed.mean * found.failures_per_task)
    assert found.observed_per_task.high == pytest.approx(found.observed.high * found.failures_per_task)
    assert found.predicted_per_task == pytest.approx(found.predicted * found.failures_per_task)
    assert "at 3.6 failures/h" in str(found)
    never = validate(motion(), scene(), GripperFailure(), n=4, rate=0.0)
    assert never.observed_per_task.high == 0.0 < never.observed.high


# --- harm without failure --------------------------------------------------------------------------------------------


@cache
def pouring() -> ValidationReport:
    """Return the report on a motion that turns the mug of coffee over the laptop."""
    task = gp.load_scene("desk").tasks["bring_coffee"]
    turn = 1.6 * np.eye(7)[5] * np.sign(task.scene.limits.position[5].mean() - task.start[5])
    path = gp.Path(np.stack([task.start, task.start + turn]))
    over = gp.retime(path, task.scene.limits, task.scene.joints, speed=0.2)
    return validate(over, task.scene, GripperFailure(), n=8, horizon=0.5, settings=SimSettings(grasp="weld"))


def test_spills_of_the_healthy_robot_are_reported_first() -> None:
    found = pouring()
    assert found.healthy.spilled > 0.98 and found.healthy.by_entity["laptop"] == 20.0
    first, *others = str(found).split("\n\n")
    assert first.startswith(
        "HARM WITHOUT FAILURE: the healthy robot pours out 100 % of the contents of 'mug' (hot): harm "
    )
    assert others[0].startswith("desk: 8 failures")
    assert re.search(r"^  without any failure +\d", str(found), flags=re.MULTILINE)
    document = json.loads(found.to_json())
    assert list(document)[:3] == ["schema", "version", "healthy"]
    assert document["healthy"]["harm"] == found.healthy.harm
    assert document["per_task"]["healthy"] == found.certain_per_task


def test_harm_without_failure_comes_with_probability_1() -> None:
    found = pouring()
    failures = found.failures_per_task
    assert 0.0 < failures < 1e-5
    assert found.certain_per_task == pytest.approx(found.healthy.harm, rel=2.0 * failures)
    expected = (1.0 - failures) * found.healthy.harm + failures * found.whole.mean
    assert found.observed_per_task.mean == pytest.approx(expected)
    assert (found.wholes >= found.impacts).all()
    always = dataclasses.replace(found, rate=3600.0 / found.duration)
    assert always.certain_per_task == 0.0 and always.observed_per_task.mean == pytest.approx(found.whole.mean)
    later = [i for i, job in enumerate(found.jobs) if job.onset > max(found.healthy.poured.values())]
    least, most = found.healthy.harm, found.impacts[later] + found.healthy.harm  # pairs hit by both count once
    assert later and (found.wholes[later] >= least - _EXACT).all() and (found.wholes[later] <= most + _EXACT).all()


def test_harm_without_failure_is_compared_per_task() -> None:
    found = pouring()
    level = dataclasses.replace(found, healthy=HealthyHarm(), whole=found.observed, wholes=found.impacts)
    assert compare(found, level).mean == 0.0 == harm_ratio(found, found, per="failure").mean - 1.0
    difference = compare(found, level, per="task")
    assert difference.mean == pytest.approx(found.observed_per_task.mean - level.observed_per_task.mean)
    assert difference.low > 0.99 * found.healthy.harm
    ratio = harm_ratio(found, level)
    assert ratio.mean == pytest.approx(found.observed_per_task.mean / level.observed_per_task.mean)
    assert ratio.low > 1e3


def test_where_nothing_is_spilt_nothing_changes() -> None:
    found = report()
    assert found.healthy.harmless and found.certain_per_task == 0.0
    assert found.whole == found.observed and np.array_equal(found.wholes, found.impacts)
    assert found.observed_per_task == found.observed.scaled(found.failures_per_task)
    assert "HARM" not in str(found)


def test_a_lost_object_is_refused_with_its_harm() -> None:
    bottle = gp.load_scene("dining_table").tasks["pass_bottle"]
    with pytest.raises(ObjectLost, match=r"harm .*probability 1"):
        validate(np.stack([bottle.start, bottle.goal[0]]), bottle.scene, n=3)


# --- choice of faults -------------------------------------------------------------------------------------------------


def test_faults_are_chosen_by_pattern_or_given() -> None:
    assert chosen_faults("drop/*") == tuple(dict.fromkeys(scenario.fault for scenario in scenarios("drop/*")))
    assert len(chosen_faults(["drop/*", "end_effector/*", "*/noise/minor"])) == 13
    own = Noise(degree="minor", when=Uniform(0.5, 1.0))
    assert chosen_faults(own) == (own,)
    assert chosen_faults([own, "tabletop/lift_to_goal/noise/minor"]) == (own, Noise(degree="minor"))


def test_faults_of_one_kind_keep_their_own_names(simulated: Callable[..., None]) -> None:
    simulated(lambda job: ())
    faults: list[Fault] = [PowerLoss(), PowerLoss(brake="none"), PowerLoss(brake="immediate")]
    found = validate(motion(), scene(), faults, n=3)
    assert list(found.by_fault) == ["power_loss/severe", "power_loss/severe (2)", "power_loss/severe (3)"]


def test_misuse_is_refused() -> None:
    with pytest.raises(UnknownNameError, match=r"'drip/\*'.*drop/\*"):
        validate(motion(), scene(), "drip/*")
    with pytest.raises(SettingError, match="fault"):
        validate(motion(), scene(), [])
    with pytest.raises(SettingError, match="n = 0"):
        validate(motion(), scene(), n=0)
    with pytest.raises(SettingError, match=r"confidence = 1\.0"):
        validate(motion(), scene(), n=1, confidence=1.0)
    with pytest.raises(SettingError, match=r"rate = -1\.0"):
        validate(motion(), scene(), n=1, rate=-1.0)
    with pytest.raises(UnknownNameError, match="unknown target 'elbow'"):
        validate(motion(), scene(), Noise(targets=("elbow",)), n=1)
    with pytest.raises(PlanningFailed, match="TIMEOUT"):
        validate(PlanResult(status=PlanStatus.TIMEOUT), scene())


# --- text -------------------------------------------------------------------------------------------------------------


def test_the_table_lists_hit_entities() -> None:
    text = str(report())
    assert re.search(r"tabletop: 30 .*0\.5 s.*seed 0\n", text)
    assert re.search(r"^observed impact +\S+ +\[\S+, \S+\]$", text, flags=re.MULTILINE)
    assert re.search(r"^predicted impact +\d", text, flags=re.MULTILINE)
    assert re.search(r"^per task of \S+ s at 0\.001 failures/h +mean +95 %$", text, flags=re.MULTILINE)
    assert re.search(r"^observed harm +\S+ +\[\S+, \S+\]$", text, flags=re.MULTILINE)
    for name, entity in report().by_entity.items():
        shown = re.search(rf"^{name} ", text, flags=re.MULTILINE) is not None
        assert shown == bool(entity.probability.mean > 0.0 or entity.predicted > 0.0)


def test_the_document_holds_everything(tmp_path: Path) -> None:
    text = report().to_json(tmp_path / "report.json")
    assert (tmp_path / "report.json").read_text() == text
    document = json.loads(text)
    fields = {field.name for field in dataclasses.fields(ValidationReport)} - {"jobs", "impacts", "wholes"}
    assert document.keys() == fields | {"schema", "version", "per_task"}
    assert document["per_task"]["observed"] == dataclasses.asdict(report().observed_per_task)
    assert document["per_task"]["predicted"] == report().predicted_per_task
    assert document["observed"] == dataclasses.asdict(report().observed)
    assert document["by_entity"]["red1"]["predicted"] == report().by_entity["red1"].predicted


def test_the_field_table_lists_the_fields() -> None:
    rows = re.findall(r"^\s*\| (\w+) ", inspect.getdoc(ValidationReport) or "", flags=re.MULTILINE)
    assert rows == ["field", *(field.name for field in dataclasses.fields(ValidationReport))]


def test_drops_without_anything_in_the_gripper_are_refused():
    scene = gp.load_scene("tabletop")
    still = np.stack([scene.tasks["green_to_blue"].start] * 2)
    with pytest.raises(SettingError, match="scene = 'tabletop'"):
        validate(still, scene, "drop/*/severe", n=3)
