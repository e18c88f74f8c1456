from __future__ import annotations

import dataclasses
import importlib
import json
import sys
from functools import partial

import numpy as np
import pytest
from places import ROOT

import graceful_plan as gp
from graceful_plan.compare import BestMotions, Run
from graceful_plan.compare.runs import runner as planner_runs
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import CHECK_STEP

sys.path.insert(0, str(ROOT))

from benchmarks.clearance_twin import ClearanceTwin
from benchmarks.subjects import auto, best_known, discretisation, kernels, optimisers, planners

from benchmarks import gradients, planning, report, suite
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
    """Keep best motions elsewhere."""
    motions = BestMotions(tmp_path / "best_known")
    monkeypatch.setattr(planning, "BEST", motions)
    return motions


@pytest.mark.parametrize("name", runner.SUBJECTS)
def test_every_subject_has_a_title_and_runs(name):
    subject = importlib.import_module(f"benchmarks.subjects.{name}")
    assert subject.TITLE and callable(subject.run)
    assert subject.MEASURED.strip()


# --- best known motions --------------------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_best_known_motions_solve_their_tasks_at_the_cost_they_claim(file):
    name = planning.BEST.read(file).task
    assert planning.BEST.file_of(name) == file
    found = planning.BEST.load(name, suite.task(name))
    assert found is not None and found.total == pytest.approx(found.motion + planning.W * found.impact)
    assert all(run.total is None or run.total >= found.total * (1.0 - 1e-6) for run in found.runs)


@pytest.mark.long
def test_runs_that_were_done_are_not_repeated(folder, monkeypatch):
    monkeypatch.setattr(suite, "task_names", lambda options: [TASK])
    monkeypatch.setattr(gp, "PLANNERS", {name: gp.PLANNERS[name] for name in ("auto", "rrt_connect")})
    options = suite.Options(seconds=0.5)
    body = best_known.run(options)
    first = folder.load(TASK, suite.task(TASK))
    assert first is not None and f"{first.total:.5g}" in body
    wanted = [("rrt_connect", 0), *(("auto", seed) for seed in range(best_known.SEEDS))]
    assert sorted((run.planner, run.seed) for run in first.runs) == sorted(wanted)
    monkeypatch.setattr(planning, "runs", lambda jobs, *rest: pytest.fail(f"{jobs} again") if jobs else [])
    assert best_known.run(options) == body
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
def test_runs_say_when_which_cost_was_reached(record):
    assert record.solved and record.first <= record.trace[0].time < record.seconds
    assert record.total_at(record.seconds) == pytest.approx(record.total)
    assert record.total_at(0.0) == np.inf
    task = suite.task(TASK)
    trajectory = record.trajectory(task.scene.joints)
    assert trajectory is not None
    assert record.total == pytest.approx(planning.BEST.cost_of(trajectory, task).total)


def test_what_a_call_raises_is_a_record():
    (record,) = planning.runs([planning.job(TASK, "no_such_planner")], 1, "test")
    assert (record.status, record.solved, record.first) == ("RAISED", False, np.inf)
    assert "no_such_planner" in record.detail


def test_parts_of_the_default_planner_are_what_they_are_called():
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
    failed = dataclasses.replace(record, planner="prm", status="TIMEOUT", total=np.inf)
    text = json.dumps(planners._details([record, failed], {TASK: np.inf}, 1.0), allow_nan=False)
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
    finding = optimisers.examine((TASK, 0, 0.5, 0.3))
    assert set(finding.improved) == {*optimisers.optimisers(), optimisers.MORE_SHORTCUTS}
    assert "stomp" in finding.improved and np.isfinite(finding.before)
    for improvement in finding.improved.values():
        assert 0.0 < improvement.total <= finding.before


def test_discretisation_is_that_of_the_cost_that_is_planned_with(monkeypatch):
    monkeypatch.setattr(planner_runs, "plan", partial(gp.plan, iterations=300))  # they end it, the time never
    found = discretisation.examine(planning.job(TASK, seconds=60.0))
    assert found.codes < 0.01  # the two integrate at different places
    assert 0.0 < found.error < 0.05
