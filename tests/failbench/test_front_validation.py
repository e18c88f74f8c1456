from dataclasses import replace

import numpy as np
import pytest

import graceful_plan as gp
from failbench import ExecutionRefused, HealthyHarm, ObjectLost, cli, front_validation, validate_front
from failbench.front_validation import FrontValidation, PointValidation
from graceful_plan.exceptions import FormatError, SettingError


@pytest.fixture(scope="module")
def task():
    return gp.load_scene("tabletop").tasks["lift_to_goal"]


@pytest.fixture(scope="module")
def front(task):
    return gp.pareto(task.start, task.goal, task.scene, points=2, iterations=150, speed=0.5)


@pytest.fixture(scope="module")
def found(task, front):
    return validate_front(front, task.scene, n=4, horizon=0.3)


@pytest.mark.long
def test_every_point_is_validated_with_the_same_failures(front, found):
    assert [p.motion for p in found.points] == front.costs[:, 0].tolist()
    reports = [p.report for p in found.points]
    assert all(report is not None and report.n >= 4 for report in reports)
    assert [job.seed for job in reports[0].jobs] == [job.seed for job in reports[1].jobs]
    assert [job.fault for job in reports[0].jobs] == [job.fault for job in reports[1].jobs]


def test_documents_and_tables_hold_both(found):
    document = found.to_document()
    for entry, point in zip(document["points"], found.points, strict=True):
        assert entry["predicted"] == point.report.predicted
        assert entry["observed"]["mean"] == point.report.observed.mean
        assert entry["observed_per_task"]["mean"] == point.report.observed_per_task.mean
        assert entry["duration"] == point.report.duration > 0.0
    assert str(found).count("\n") == 3 + len(found.points)
    first, last = (point.report.impacts for point in (found.points[0], found.points[-1]))
    assert document["points"][0]["against_shortest"]["mean"] == 0.0
    assert document["points"][-1]["against_shortest"]["mean"] == pytest.approx(np.mean(last - first))


def test_motions_that_cannot_be_executed_are_reported(task, front, monkeypatch):
    def refuse(*arguments, **settings):
        raise ExecutionRefused("joint 4", 0.2, "stuck")

    monkeypatch.setattr(front_validation, "validate", refuse)
    found = validate_front(front, task.scene, n=2)
    assert all(p.report is None and "joint 4" in p.refused and "stuck" in p.refused for p in found.points)
    assert np.isnan(found.rank_correlation)
    assert found.to_document()["points"][0]["observed"] is None
    assert "refused" in str(found)


def test_harm_without_failure_is_reported_first(found, task, front, monkeypatch):
    assert "HARM" not in str(found)
    assert all(entry["healthy"]["harm"] == 0.0 for entry in found.to_document()["points"])
    spilt = HealthyHarm(carried="green", contents="hot", spilled=1.0, by_entity={"red1": 8.0})
    point = replace(found.points[0], report=replace(found.points[0].report, healthy=spilt))
    told = replace(found, points=(point, *found.points[1:]))
    assert str(told).startswith(f"motion V {point.motion:.4g}: HARM WITHOUT FAILURE: the healthy robot pours out 100 %")
    assert told.to_document()["points"][0]["healthy"]["harm"] == 8.0

    def lose(*arguments, **settings):
        raise ObjectLost("the object 'green'", 0.2, "it has slipped", spilt)

    monkeypatch.setattr(front_validation, "validate", lose)
    lost = validate_front(front, task.scene, n=2)
    assert all(p.report is None and p.healthy is spilt for p in lost.points)
    assert "HARM WITHOUT FAILURE" in str(lost)


def test_rank_correlation_of_known_orders(found):
    report = found.points[0].report

    def of(pairs):
        points = [
            PointValidation(
                motion=1.0, impact=1.0, report=replace(report, predicted=p, observed=replace(report.observed, mean=o))
            )
            for p, o in pairs
        ]
        return FrontValidation(scene="s", points=tuple(points), n=1, seed=0).rank_correlation

    assert of([(3.0, 9.0), (2.0, 5.0), (1.0, 1.0)]) == pytest.approx(1.0)
    assert of([(3.0, 1.0), (2.0, 5.0), (1.0, 9.0)]) == pytest.approx(-1.0)
    assert of([(3.0, 9.0), (2.0, 1.0), (1.0, 5.0)]) == pytest.approx(1.0 / 3.0)
    assert np.isnan(of([(1.0, 2.0), (1.0, 3.0)]))


def test_invalid_fronts_are_refused(task, tmp_path):
    with pytest.raises(SettingError, match="TIMEOUT"):
        validate_front(gp.ParetoFront(status=gp.PlanStatus.TIMEOUT), task.scene)
    with pytest.raises(FormatError, match="cannot be read"):
        validate_front(tmp_path / "nowhere.json", task.scene)


def test_command_line(front, tmp_path, capsys):
    front.save(tmp_path / "front.json")
    argv = ["validate-front", str(tmp_path / "front.json"), "--scene", "tabletop", "--task", "lift_to_goal"]
    assert cli.main([*argv, "-n", "2", "--horizon", "0.04"]) == cli.DONE
    assert "Kendall's tau" in capsys.readouterr().out
    assert cli.main([*argv[:1], str(tmp_path / "none.json")]) == cli.MISUSE
    assert "none.json" in capsys.readouterr().err
