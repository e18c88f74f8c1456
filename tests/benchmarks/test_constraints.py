"""The benchmark `constraints` and its scenes with open vessels."""

import json
import math
from dataclasses import asdict, replace
from functools import partial

import mujoco
import numpy as np
import pytest
from benchmarks.constrained import contents, held, projected, upright
from benchmarks.constrained.contents import DEFAULT, NOTHING, ContentsJob, Kept
from benchmarks.constrained.upright import OMPL, PROJECTION, REJECTION, UprightFigures, UprightJob
from benchmarks.subjects import constraints

import failbench
import graceful_plan as gp
from benchmarks import suite, variants
from graceful_plan.costs.cost import StateBatch
from graceful_plan.scene.rules.vessel import find_vessel

SCENES = suite.vessel_scenes()
TASKS = suite.vessel_task_names()
FILLS = {
    "buffet/serve_soup": 0.9,
    "buffet/serve_wine": 0.45,
    "buffet/serve_cups": 0.8,
    "stove/fill_plate": 0.8,
    "stove/carry_bucket": 0.8,
    "stove/move_frying_pan": 0.5,
}
JOB = ContentsJob(task="stove/fill_plate", w=0.3, seed=0, constraints=DEFAULT)
KEPT = Kept(job=JOB, status="SOLVED", detail="", duration=2.0, total=3.0, seconds=1.0, lost=0.0, swung=0.0)
FIGURES = UprightFigures(
    name="box/0",
    statuses=("SOLVED", "TIMEOUT"),
    details=("no path",),
    first={PROJECTION: (0.001, 0.002), REJECTION: (0.003, math.inf), OMPL: (math.inf, math.inf)},
    soon=(1.1, math.inf),
    long=(1.0,),
)


@pytest.mark.parametrize("name", SCENES)
def test_vessels_stand_still_and_in_nothing_else(name):
    scene = suite.scene(name)
    assert variants.problems(scene) == []
    world = failbench.build_world(scene)
    data = mujoco.MjData(world.model)
    data.qpos[:] = scene.home_qpos
    mujoco.mj_forward(world.model, data)
    before = data.xpos.copy()
    for _ in range(round(1.0 / world.model.opt.timestep)):
        mujoco.mj_step(world.model, data)
    for thing, body in world.movable.items():
        assert np.linalg.norm(data.xpos[body] - before[body]) < 0.003, thing


@pytest.mark.parametrize("name", TASKS)
def test_ends_are_free_and_keep_all_of_the_contents(name):
    task = suite.task(name)
    assert contents.fill_of(name) == pytest.approx(FILLS[name], abs=0.01)
    for q in (task.start, *task.goal):
        assert float(gp.clearance(q, task.scene)) >= 0.02
    assert gp.KeepContents().rule(task.scene).vessel.axis[2] == pytest.approx(1.0)


def test_a_path_that_keeps_the_contents_exists(monkeypatch):
    assert set(TASKS) == set(FILLS)
    monkeypatch.setattr(gp, "plan", partial(gp.plan, iterations=200))  # the machine may be busy
    kept = contents.examine(JOB)
    assert kept.status == "SOLVED" and kept.lost <= constraints.LOST and kept.swung <= constraints.LOST


def test_vessels_have_the_requested_fill():
    scene = contents.filled_scene(suite.task("stove/carry_bucket"), 0.5)
    vessel = find_vessel(scene)
    assert vessel is not None
    assert vessel.volume == pytest.approx(0.5 * np.pi * vessel.radius**2 * vessel.height)


def test_records_survive_writing_and_reading(tmp_path):
    unknown = replace(KEPT, job=replace(JOB, fill=0.9), duration=math.inf, lost=math.inf)
    file = tmp_path / "kept.jsonl"
    file.write_text("".join(json.dumps(asdict(x)) + "\n" for x in (KEPT, unknown)) + "cut off")
    assert list(constraints.read_kept(file)) == [KEPT, unknown]
    file.write_text(json.dumps(asdict(FIGURES)) + "\n")
    assert list(constraints.read_upright(file)) == [FIGURES]


def test_durations_are_compared_with_those_of_the_same_seed():
    twin = replace(KEPT, job=replace(JOB, constraints=NOTHING), duration=1.6)
    other = replace(KEPT, job=replace(JOB, seed=1))
    found = constraints.ratios([KEPT, twin, other])
    assert found[JOB] == pytest.approx(1.25) and math.isnan(found[other.job])


def test_gaps_are_to_the_best_of_all_runs():
    assert FIGURES.best == 1.0
    better = replace(FIGURES, soon=(0.5, 1.0))
    assert better.best == 0.5


@pytest.mark.long
def test_trees_without_projection_find_a_path_too():
    name = "table_pick/0"
    figures = upright.examine(UprightJob(name=name, seeds=1, long=0.3, long_seeds=1))
    assert not figures.objection
    for method in (PROJECTION, REJECTION):
        assert all(math.isfinite(seconds) for seconds in figures.first[method])
    assert set(figures.first) == {PROJECTION, REJECTION, OMPL}


def test_ompl_gets_the_same_problem():
    task = suite.task("stove/fill_plate")
    outside = projected.Outside(upright.UPRIGHT.rule(task.scene), task.scene)
    q = task.start + np.random.default_rng(0).normal(0.0, 0.5, (20, len(task.start)))
    expected = upright.UPRIGHT.residual(StateBatch(task.scene, q))
    np.testing.assert_allclose(outside.residual(q), expected, atol=1e-9)


def test_spilling_motions_are_reported():
    asked = upright.question("table_pick/0")
    lying = asked.start + np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0])
    reason = upright.objection(replace(asked, start=lying))
    assert reason.startswith("start: Upright")


def test_only_missing_jobs_are_done_and_reported(tmp_path, monkeypatch):
    monkeypatch.setattr(constraints, "STORE", tmp_path / "runs")
    monkeypatch.setattr(contents, "jobs", lambda options: [JOB, replace(JOB, constraints=NOTHING)])
    monkeypatch.setattr(held, "jobs", lambda options: [held.HeldJob(task="desk/bring_coffee", seed=0)])
    monkeypatch.setattr(upright, "names", lambda options: {"box": ["box/0"]})
    done = []
    monkeypatch.setattr(contents, "examine", lambda job: done.append(job) or replace(KEPT, job=job))
    monkeypatch.setattr(held, "examine", lambda job: done.append(job) or held.Held(job=job, status="TIMEOUT"))
    monkeypatch.setattr(upright, "examine", lambda job: done.append(job) or FIGURES)
    body = constraints.run(suite.Options())
    assert len(done) == 4 and "not finished" not in body.lower()
    assert constraints.run(suite.Options()) == body and len(done) == 4
    assert "| box | 1 | 1 | 1/2 |" in body and "no path" in body
