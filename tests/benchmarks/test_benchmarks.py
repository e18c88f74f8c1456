from __future__ import annotations

import dataclasses
import importlib
import json
import sys

import numpy as np
import pytest
from places import ROOT

import graceful_plan as gp
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import CHECK_STEP

sys.path.insert(0, str(ROOT))

from benchmarks.clearance_twin import ClearanceTwin
from benchmarks.subjects import best_known, kernels, optimisers, planners

from benchmarks import gradients, known, planning, report, suite
from benchmarks import run as runner

TASK = "tabletop_l1/green_to_blue"
FILES = sorted(known.FOLDER.glob("*.json"))


@pytest.fixture(scope="module")
def record() -> planning.Record:
    return planning.run(planning.Job(task=TASK, planner="rrt_connect", time_limit=5.0))


@pytest.fixture
def stored(record, tmp_path, monkeypatch) -> known.BestKnown:
    monkeypatch.setattr(known, "FOLDER", tmp_path / "best_known")
    assert record.path is not None, record
    found = known.offer(TASK, suite.task(TASK), None, record.path, "rrt_connect", 0, 5.0)
    assert found is not None
    run = known.Run(planner="rrt_connect", seed=0, seconds=5.0, total=found.total)
    return dataclasses.replace(found, runs=(run, dataclasses.replace(run, seed=1, total=None)))


@pytest.mark.parametrize("name", runner.SUBJECTS)
def test_every_subject_has_a_title_and_runs(name):
    subject = importlib.import_module(f"benchmarks.subjects.{name}")
    assert subject.TITLE and callable(subject.run)
    assert subject.MEASURED.strip()


def test_results_have_sections_of_known_subjects():
    if not runner.RESULTS.exists():
        pytest.skip("no results yet")
    begins = [line for line in runner.RESULTS.read_text().splitlines() if line.startswith("<!-- begin")]
    assert {line.split()[2] for line in begins} <= set(runner.SUBJECTS)


# --- best known paths -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_best_known_paths_solve_their_tasks_at_the_cost_they_claim(file):
    name = known.read(file).task
    assert known.file_of(name) == file
    found = known.load(name, suite.task(name))
    assert found is not None and found.total == pytest.approx(found.motion + known.W * found.impact)
    assert all(run.total is None or run.total >= found.total * (1.0 - 1e-6) for run in found.runs)


def test_a_stored_path_comes_back(stored):
    known.write(stored)
    assert known.load(TASK, suite.task(TASK)) == stored
    assert known.renewed(TASK, suite.task(TASK)) == stored
    assert [file.name for file in known.FOLDER.iterdir()] == ["tabletop_l1.green_to_blue.json"]


def test_a_task_without_a_file_has_no_best_known(stored):
    assert known.load(TASK, suite.task(TASK)) is None
    assert known.renewed(TASK, suite.task(TASK)) is None


def test_a_total_that_does_not_match_its_path_is_refused_and_renewed(stored):
    known.write(dataclasses.replace(stored, total=0.9 * stored.total))
    with pytest.raises(known.StaleBestKnownError, match="stored total"):
        known.load(TASK, suite.task(TASK))
    renewed = known.renewed(TASK, suite.task(TASK))
    assert renewed is not None and renewed.total == pytest.approx(stored.total)
    assert renewed.runs == ()


def test_a_path_of_another_task_is_refused(stored):
    known.write(stored)
    other = suite.task("tabletop_l1/far_to_near")
    with pytest.raises(known.StaleBestKnownError, match="does not begin at the start"):
        known.load(TASK, other)
    assert known.renewed(TASK, other) is None


def test_a_colliding_path_is_refused(stored):
    inside = suite.task(TASK).start.copy()
    inside[1:4] = [1.5, 0.0, -0.5]  # arm stretched out into the table
    known.write(dataclasses.replace(stored, path=(stored.path[0], tuple(inside), stored.path[-1])))
    with pytest.raises(known.StaleBestKnownError, match="collision"):
        known.load(TASK, suite.task(TASK))
    assert known.renewed(TASK, suite.task(TASK)) is None


@pytest.mark.parametrize(
    "text",
    [
        "{",
        "{}",
        '{"schema": 2, "w": 1.0}',
        '{"schema": 1, "w": 0.5}',
        '{"schema": 1, "w": 1.0, "runs": [], "path": [], "x": 1}',
    ],
)
def test_files_of_another_format_are_refused(stored, text):
    file = known.file_of(TASK)
    file.parent.mkdir()
    file.write_text(text)
    with pytest.raises(known.StaleBestKnownError, match=file.name):
        known.load(TASK, suite.task(TASK))
    assert known.renewed(TASK, suite.task(TASK)) is None


def test_only_a_better_path_replaces_the_best_known(stored):
    task = suite.task(TASK)
    q = np.array(stored.path)
    detour = np.concatenate([q[:1], q[:2], q])  # to the second vertex, back and again
    assert known.offer(TASK, task, stored, detour, "prm", 0, 1.0) is stored
    assert known.offer(TASK, task, stored, q, "prm", 0, 1.0) is stored
    worse = dataclasses.replace(stored, total=stored.total + 1.0)
    better = known.offer(TASK, task, worse, q, "prm", 7, 1.0)
    assert better is not None and (better.total, better.planner, better.seed) == (stored.total, "prm", 7)
    assert better.runs == stored.runs


def test_a_path_that_is_no_solution_is_not_taken(stored):
    assert known.offer(TASK, suite.task(TASK), None, np.array(stored.path)[:-1], "prm", 0, 1.0) is None


def test_runs_that_were_done_are_not_repeated(stored, monkeypatch):
    monkeypatch.setattr(suite, "task_names", lambda options: [TASK])
    monkeypatch.setattr(gp, "PLANNERS", {name: gp.PLANNERS[name] for name in ("auto", "rrt_connect")})
    options = suite.Options(seconds=0.5)
    body = best_known.run(options)
    first = known.load(TASK, suite.task(TASK))
    assert first is not None and f"{first.total:.5g}" in body
    wanted = [("rrt_connect", 0), *(("auto", seed) for seed in range(best_known.SEEDS))]
    assert sorted((run.planner, run.seed) for run in first.runs) == sorted(wanted)
    monkeypatch.setattr(planning, "run", lambda job: pytest.fail(f"{job} again"))
    assert best_known.run(options) == body
    assert known.load(TASK, suite.task(TASK)) == first


def test_the_reference_of_gaps_is_the_best_of_file_and_run(stored, record):
    total = stored.total
    known.write(stored)
    best, doubts = planners.references([], [TASK], keep=True)
    assert (best, doubts) == ({TASK: total}, [])
    known.write(dataclasses.replace(stored, total=2.0 * total))
    best, doubts = planners.references([record], [TASK], keep=False)
    assert best == {TASK: total} and "stored total" in doubts[0]
    known.file_of(TASK).unlink()
    best, doubts = planners.references([record], [TASK], keep=True)
    assert best == {TASK: total} and TASK in doubts[0]
    assert known.load(TASK, suite.task(TASK)) is not None


# --- records and statistics ------------------------------------------------------------------------------------------


def test_records_say_when_which_cost_was_reached(record):
    assert record.solved and record.first == record.trace[0][0] < record.seconds
    assert record.total_at(record.seconds) == pytest.approx(record.total)
    assert record.total_at(0.0) == np.inf
    assert record.total == pytest.approx(known.cost_of(record.path, suite.task(TASK)).total)


def test_what_a_call_raises_is_a_record():
    record = planning.run(planning.Job(task=TASK, planner="no_such_planner"))
    assert (record.status, record.solved, record.first) == ("RAISED", False, np.inf)
    assert "no_such_planner" in record.detail


def test_an_unsolved_run_reaches_no_cost():
    record = planning.Record(job=planning.Job(task=TASK), status="TIMEOUT", trace=((0.1, 3.0),))
    assert record.total_at(1.0) == np.inf == record.first


@pytest.mark.parametrize(
    ("total", "best", "gap"),
    [(1.1, 1.0, 0.1), (1.0, 1.0, 0.0), (np.inf, 1.0, np.inf), (1.0, np.inf, np.inf), (0.0, 0.0, 0.0)],
)
def test_gap(total, best, gap):
    assert planners.gap(total, best) == pytest.approx(gap)


def test_free_edges_are_free_and_of_one_length():
    compiled = kernels.compile_scene(kernels.boxes_scene(np.random.default_rng(0)))
    q = np.random.default_rng(1).uniform(compiled.robot.lower, compiled.robot.upper, (500, 7))
    first, second = kernels.free_edges(compiled.kernels, q, 50, np.random.default_rng(2))
    assert 10 <= len(first) <= 50
    assert compiled.kernels.edges_free(first, second).all()
    np.testing.assert_allclose(np.linalg.norm(second - first, axis=1), kernels.EDGE_LENGTH)


@pytest.mark.parametrize("lanes", [4, 8, 16])
def test_checked_configurations_are_whole_blocks_at_most_a_step_apart(lanes):
    count = kernels.configurations_checked(np.array([kernels.EDGE_LENGTH]), lanes)
    assert count % lanes == 0
    # The kernel spreads them evenly: neighbours are length / (count - 1) apart, hardly more than a step.
    assert (count - lanes) * CHECK_STEP <= kernels.EDGE_LENGTH < count * CHECK_STEP


def test_every_task_is_in_the_suite():
    names = suite.task_names()
    assert {name.split("/")[0] for name in names} == set(gp.scenes())
    assert len(suite.task_names(suite.Options(quick=True))) == len(gp.scenes())


# --- report ----------------------------------------------------------------------------------------------------------


def test_a_section_is_added_in_order_and_then_replaced_alone(tmp_path):
    file, order = tmp_path / "RESULTS.md", ("kernels", "safety", "optima")
    report.write_section(file, "safety", "first", order)
    report.write_section(file, "kernels", "second\n\nmore", order)
    report.write_section(file, "safety", "third \\1", order)
    text = file.read_text()
    assert text.startswith(report.HEADER)
    assert "first" not in text and text.index("second\n\nmore") < text.index("third \\1")
    assert text.count("<!-- begin") == text.count("<!-- end") == 2
    assert report.replace_section(text, "safety", "third \\1", order) == text


def test_tables_keep_failures_and_escape_bars():
    missed = report.Target(what="a|b", wanted="1", measured="2", met=False)
    text = report.targets([missed, report.Target(what="c", wanted="", measured="", met=None)])
    assert "a\\|b | 1 | 2 | **no**" in text and "**not measured**" in text


@pytest.mark.parametrize(
    ("value", "text"), [(np.inf, "none"), (np.nan, "none"), (1234567.0, "1.23e+06"), (0.0123456, "0.0123")]
)
def test_quantities(value, text):
    assert report.quantity(value) == text


def test_details_are_strict_json(record):
    failed = planning.Record(job=planning.Job(task=TASK), status="TIMEOUT")
    text = json.dumps(planners._details([record, failed], {TASK: np.inf}), allow_nan=False)
    assert json.loads(text)["runs"][0]["total"] is None


# --- optimisers -------------------------------------------------------------------------------------------------------


def test_gradients_of_every_term_are_exact():
    found = gradients.examine(TASK, 12)
    assert {finding.term for finding in found} >= {"edges, V + w S", "clearance, surroundings", "clearance, self"}
    for finding in found:
        assert finding.count >= 5
        assert finding.worst < optimisers.GRADIENT_ERROR, finding


def test_the_twin_of_the_clearance_agrees_with_the_kernels():
    kernels = compile_scene(suite.task(TASK).scene).kernels
    twin = ClearanceTwin(kernels.robot, kernels.world)
    q = np.random.default_rng(0).uniform(kernels.robot.lower, kernels.robot.upper, (60, kernels.nq))
    distances = twin.distances(q)
    np.testing.assert_allclose(distances.min(axis=1), kernels.clearance(q), atol=1e-5)
    nearest = distances.argmin(axis=1)
    assert np.any(nearest >= distances.shape[1] - twin.n_self) and np.any(nearest < distances.shape[1] - twin.n_self)
    np.testing.assert_allclose(twin.distance(q, nearest), distances.min(axis=1), atol=1e-12)


def test_wrong_gradients_are_found():
    def square(x):
        return np.square(x).sum(axis=1)

    x = np.random.default_rng(0).normal(size=(20, 3))
    right = gradients.compared("term", "here", square, x, 2.0 * x)
    assert right.count == 20 and right.worst < 1e-8
    assert gradients.compared("term", "here", square, x, 2.001 * x).worst == pytest.approx(1e-3 / 2.001, rel=0.01)
    kinked = gradients.compared("term", "here", lambda x: np.abs(x).sum(axis=1), np.zeros((4, 3)), np.ones((4, 3)))
    assert kinked.kinks == 4 and kinked.worst == np.inf


def test_optimisers_start_from_the_same_path_and_only_solutions_count():
    sizes = dataclasses.replace(optimisers.QUICK, seconds=0.3)
    finding = optimisers.examine(optimisers.Job(task=TASK, sizes=sizes))
    assert set(finding.improved) == {*optimisers.optimisers(), optimisers.MORE_SHORTCUTS}
    assert "stomp" in finding.improved and np.isfinite(finding.before)
    for improvement in finding.improved.values():
        assert 0.0 < improvement.total <= finding.before
