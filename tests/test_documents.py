import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from graceful_plan import documents
from graceful_plan.exceptions import FormatError
from graceful_plan.path import Path
from graceful_plan.result import Check, CostBreakdown, PlanResult, PlanStatus, Verdict
from graceful_plan.timing.trajectory import Trajectory

NUMBERS = st.floats(-1e6, 1e6)


def some_trajectory() -> Trajectory:
    q = np.array([[0.0, 1.0], [0.5, 0.5]])
    return Trajectory(np.array([0.0, 1.0]), q, 0 * q, 0 * q, ("a", "b"))


@given(q=hnp.arrays(float, st.tuples(st.integers(1, 5), st.integers(1, 7)), elements=NUMBERS))
def test_path_survives_a_round_trip(q, tmp_path_factory):
    file = tmp_path_factory.mktemp("path") / "path.json"
    file.write_text(documents.to_json(documents.path_document(Path(q))))
    read = documents.read_motion(file)
    assert isinstance(read, Path)
    np.testing.assert_array_equal(read.q, q)


def test_reads_trajectories_and_results(tmp_path):
    trajectory = some_trajectory()
    (tmp_path / "t.json").write_text(trajectory.to_json())
    result = PlanResult(status=PlanStatus.SOLVED, path=trajectory.path, trajectory=trajectory)
    (tmp_path / "r.json").write_text(documents.to_json(documents.result_document(result)))
    for name in ("t.json", "r.json"):
        read = documents.read_motion(tmp_path / name)
        assert isinstance(read, Trajectory)
        np.testing.assert_array_equal(read.q, trajectory.q)


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("[1, 2", FormatError, "not JSON"),
        ("[" * 100_000, FormatError, "not JSON"),
        ("[1, 2]", FormatError, "neither a path nor a trajectory"),
        ('{"schema": "graceful_plan.result", "path": null}', FormatError, "neither a path nor a trajectory"),
        ('{"schema": "graceful_plan.path", "version": 2, "q": [[0]]}', FormatError, "keys schema, version"),
        ('{"schema": "graceful_plan.path", "version": 1}', FormatError, "keys schema, version"),
        ('{"schema": "graceful_plan.path", "version": 1, "q": [[0], [0, 1]]}', FormatError, "path has shape"),
        ('{"schema": "graceful_plan.path", "version": 1, "q": [["a"]]}', FormatError, "path has shape"),
        ('{"schema": "graceful_plan.path", "version": 1, "q": [[NaN]]}', FormatError, "path is not finite"),
        ('{"schema": "something else"}', FormatError, "missing keys"),
    ],
)
def test_other_documents_are_refused(text, error, message, tmp_path):
    file = tmp_path / "file.json"
    file.write_text(text)
    with pytest.raises(error, match=message) as raised:
        documents.read_motion(file)
    assert str(raised.value).startswith(str(file))


def test_missing_file_is_named(tmp_path):
    with pytest.raises(FormatError, match=r"nowhere\.json: .*No such file"):
        documents.read_motion(tmp_path / "nowhere.json")


def test_json_is_strict():
    text = documents.to_json({"a": math.inf, "b": [math.nan, 1.5], "c": (1, "x", None, True)})
    assert json.loads(text) == {"a": None, "b": [None, 1.5], "c": [1, "x", None, True]}


def test_unsolved_result_has_no_cost_and_a_reason():
    document = json.loads(
        documents.to_json(documents.result_document(PlanResult(status=PlanStatus.TIMEOUT, detail="x")))
    )
    assert (document["status"], document["detail"], document["cost"], document["trajectory"]) == (
        "TIMEOUT",
        "x",
        None,
        None,
    )
    assert document["verdict"] == {"passed": False, "checks": {}}


def test_verdict_document_names_the_failed_check():
    verdict = Verdict(checks={"a": Check(passed=True, worst=1.0), "b": Check()})
    document = json.loads(documents.to_json(documents.verdict_document(verdict)))
    assert not document["passed"]
    assert document["checks"]["b"] == {"passed": False, "worst": None, "limit": 0.0, "first": None, "detail": ""}


def test_cost_table_puts_the_worst_first_and_leaves_out_the_harmless():
    first = CostBreakdown(motion=1.0, impact=3.0, w=0.0, impact_by_entity={"a": 1.0, "b": 2.0, "c": 0.0})
    second = CostBreakdown(motion=2.0, impact=0.5, w=1.0, impact_by_entity={"a": 0.5, "b": 0.0, "c": 0.0})
    lines = [line.split() for line in documents.cost_table({"x": first, "y": second}).splitlines()]
    assert lines[0] == ["x", "y"]
    assert lines[2:] == [
        ["motion", "1", "2"],
        ["impact", "3", "0.5"],
        ["motion", "+", "w", "*", "impact", "1", "2.5"],
        ["entity", "b", "2", "0"],
        ["entity", "a", "1", "0.5"],
    ]


@given(st.lists(st.tuples(st.text("abc", max_size=9), NUMBERS), min_size=1, max_size=5))
def test_table_columns_line_up(rows):
    header, rule, *body = documents.table(["name", "value"], rows).splitlines()
    assert set(rule) == {"-"}
    assert {len(line) for line in body} == {len(header)}
