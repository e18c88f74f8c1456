from __future__ import annotations

import dataclasses
import importlib
import sys

import numpy as np
import pytest
from places import ROOT

import graceful_plan as gp
from graceful_plan.compare import BestMotions, Run
from graceful_plan.core.kernels import CHECK_STEP

sys.path.insert(0, str(ROOT))

from benchmarks.subjects import auto, kernels, planners

from benchmarks import find_best_known, planning, report, suite
from benchmarks import run as runner

TASK = "tabletop_l1/green_to_blue"
FILES = sorted(planning.BEST.folder.glob("*.json"))


@pytest.fixture(scope="module")
def record() -> Run:
    (found,) = planning.runs([planning.job(TASK, "rrt_connect", seconds=2.0)], 1, "test")
    assert found.solved, found
    return found


@pytest.fixture
def folder(tmp_path, monkeypatch) -> BestMotions:
    """Store best motions in a temporary folder."""
    motions = BestMotions(tmp_path / "best_known")
    monkeypatch.setattr(planning, "BEST", motions)
    return motions


@pytest.mark.parametrize("name", runner.SUBJECTS)
def test_every_subject_has_a_title_a_question_and_a_headline(name):
    subject = importlib.import_module(f"benchmarks.subjects.{name}")
    assert subject.TITLE and subject.HEADLINE and callable(subject.run)
    assert subject.QUESTION.endswith("?") and subject.MEASURED.strip()


def test_runs_that_two_subjects_report_are_made_once(monkeypatch):
    made = []

    def runs(jobs, processes, label):
        made.extend(jobs)
        return iter([Run(problem=job.problem.name, planner="auto", seed=job.seed, status="SOLVED") for job in jobs])

    monkeypatch.setattr(planning, "_DONE", {})
    monkeypatch.setattr(planning, "runs", runs)
    jobs = [planning.job(TASK, seed=seed) for seed in range(3)]
    assert [run.seed for run in planning.runs_once(jobs[1:], "one")] == [1, 2]
    assert [run.seed for run in planning.runs_once(jobs, "all")] == [0, 1, 2]
    assert made == [jobs[1], jobs[2], jobs[0]]


# --- best known motions --------------------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_best_known_motions_solve_their_tasks_at_the_stated_cost(file):
    name = planning.BEST.read(file).task
    assert planning.BEST.file_of(name) == file
    found = planning.BEST.load(name, suite.task(name))
    assert found is not None and found.total == pytest.approx(found.motion + planning.W * found.impact)
    assert all(run.total is None or run.total >= found.total * (1.0 - 1e-6) for run in found.runs)


@pytest.mark.long
def test_finished_runs_are_not_repeated(folder, monkeypatch):
    monkeypatch.setattr(suite, "task_names", lambda options: [TASK])
    monkeypatch.setattr(gp, "PLANNERS", {name: gp.PLANNERS[name] for name in ("auto", "rrt_connect")})
    options = suite.Options(seconds=0.5)
    body = find_best_known.run(options)
    first = folder.load(TASK, suite.task(TASK))
    assert first is not None and f"{first.total:.5g}" in body
    wanted = [("rrt_connect", 0), *(("auto", seed) for seed in range(find_best_known.SEEDS))]
    assert sorted((run.planner, run.seed) for run in first.runs) == sorted(wanted)
    monkeypatch.setattr(planning, "runs", lambda jobs, *rest: pytest.fail(f"{jobs} again") if jobs else [])
    assert find_best_known.run(options) == body
    assert folder.load(TASK, suite.task(TASK)) == first


@pytest.mark.long
def test_the_reference_of_gaps_is_the_best_of_file_and_run(folder, record):
    stored = folder.offer(suite.task(TASK), None, record, 5.0)
    assert stored is not None
    total = stored.total
    folder.write(stored)
    best, doubts = planners.references([], [TASK], keep=True)
    assert (best, doubts) == ({TASK: total}, [])
    folder.write(dataclasses.replace(stored, total=2.0 * total))
    best, doubts = planners.references([(5.0, [record])], [TASK], keep=False)
    assert best == {TASK: total} and "stored total" in doubts[0]
    folder.file_of(TASK).unlink()
    best, doubts = planners.references([(5.0, [record])], [TASK], keep=True)
    assert best == {TASK: total} and TASK in doubts[0]
    kept = folder.load(TASK, suite.task(TASK))
    assert kept is not None and (kept.planner, kept.seed, kept.seconds) == ("rrt_connect", 0, 5.0)


# --- records and statistics ------------------------------------------------------------------------------------------


@pytest.mark.long
def test_runs_record_when_each_cost_was_reached(record):
    assert record.solved and record.first <= record.trace[0].time < record.seconds
    assert record.totals_at(record.seconds) == pytest.approx(record.total)
    assert record.totals_at(0.0) == np.inf
    task = suite.task(TASK)
    trajectory = record.trajectory(task.scene.joints)
    assert trajectory is not None
    assert record.total == pytest.approx(planning.BEST.cost_of(trajectory, task).total)


def test_an_exception_becomes_a_record():
    (record,) = planning.runs([planning.job(TASK, "no_such_planner")], 1, "test")
    assert (record.status, record.solved, record.first) == ("RAISED", False, np.inf)
    assert "no_such_planner" in record.detail


def test_parts_of_the_default_planner_have_the_right_names():
    parts = {part.label: part.make() for part in auto.PARTS}
    assert parts["everything"] == gp.Auto() and parts["one search"] == gp.Auto(workers=1)
    assert parts["without roadmaps"] == gp.Auto(search=gp.Anytime(scouts=False))


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
    # The kernel spreads samples evenly: neighbours are length / (count - 1) apart, at most slightly over one step.
    assert (count - lanes) * CHECK_STEP <= kernels.EDGE_LENGTH < count * CHECK_STEP


def test_every_task_is_in_the_suite():
    names = suite.task_names()
    assert {name.split("/")[0] for name in names} == set(gp.scenes())
    assert len(suite.task_names(suite.Options(quick=True))) == len(gp.scenes())


# --- report ----------------------------------------------------------------------------------------------------------


def test_tables_keep_failures_and_escape_bars():
    missed = report.Target(what="a|b", wanted="1", measured="2", met=False)
    text = report.targets([missed, report.Target(what="c", wanted="", measured="", met=None)])
    assert "a\\|b | 1 | 2 | **no**" in text and "**not measured**" in text


@pytest.mark.parametrize(
    ("value", "text"), [(np.inf, "none"), (np.nan, "none"), (1234567.0, "1.23e+06"), (0.0123456, "0.0123")]
)
def test_quantities(value, text):
    assert report.quantity(value) == text
