from dataclasses import replace

import pytest
from bench_cases import suite_file
from places import LIBRARY

import graceful_plan as gp
from graceful_plan import compare as bench
from graceful_plan.compare.runs.comparison import settle
from graceful_plan.compare.runs.runner import run
from graceful_plan.exceptions import SceneError, SettingError, UnknownNameError


def written(folder, text):
    file = folder / "suite.yaml"
    file.write_text(text)
    return file


def test_household_is_every_task_of_every_bundled_scene():
    names = {problem.name for problem in bench.load_suite("household").problems}
    assert names == {f"{scene}/{task}" for scene in gp.scenes() for task in gp.load_scene(scene).tasks}


@pytest.mark.parametrize("name", bench.suites())
def test_bundled_suites_can_be_read(name):
    suite = bench.load_suite(name)
    assert suite.name == name
    assert suite.problems
    assert suite.description


def test_the_default_suite_takes_a_minute_or_so():
    suite = bench.load_suite("quick")
    assert len(suite.problems) * len(gp.PLANNERS) * len(suite.seeds) * suite.seconds <= 90.0


def test_a_suite_file_may_set_every_option(tmp_path):
    scene = gp.load_scene("tabletop")
    home = ", ".join(repr(float(x)) for x in scene.keyframes["ready"])
    suite = bench.load_suite(
        written(
            tmp_path,
            f"""
version: 1
description: everything
seconds: 0.25
w: 2
seeds: [3, 5]
problems:
  - scene: tabletop
    tasks: [right_to_left]
  - scene: desk
    tasks: 2
  - scene: tabletop
    start: ready
    goal: [{home}]
  - scene: tabletop
    start: ready
    goal: ready
    name: nowhere
  - analytic: [disc]
best_known: {{nowhere: 0}}
""",
        )
    )
    assert (suite.seconds, suite.w, suite.seeds, suite.best_known) == (0.25, 2.0, (3, 5), {"nowhere": 0.0})
    names = [problem.name for problem in suite.problems]
    assert names[0] == "tabletop/right_to_left"
    assert [name.split("/")[0] for name in names[1:3]] == ["desk", "desk"]
    assert names[3:] == ["tabletop/ready_to_q", "nowhere", "analytic/disc"]
    jobs = settle(suite, planners=["rrt_connect"]).jobs
    assert len(jobs) == 2 * len(names)
    assert run(replace(jobs[4], seconds=30.0)).status == "SOLVED"


def test_a_scene_file_stands_beside_the_suite_and_its_change_is_seen(tmp_path):
    (tmp_path / "mine").mkdir()
    scene = tmp_path / "mine" / "plain.yaml"
    shipped = LIBRARY / "scene" / "scenes"
    for file in (shipped / "tabletop_l1.yaml", *shipped.glob("tabletop_l1*.xml")):
        (scene.parent / file.name.replace("tabletop_l1.yaml", "plain.yaml")).write_bytes(file.read_bytes())
    file = written(tmp_path, "version: 1\nproblems: [{scene: mine/plain.yaml, tasks: 1}]\n")
    (first,) = bench.load_suite(file).problems
    assert first.name.startswith("plain/")
    scene.write_text(scene.read_text() + "\n# changed\n")
    (second,) = bench.load_suite(file).problems
    assert first.digest != second.digest
    assert first.to_document()["source"] == "plain.yaml"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("version: 2\nproblems: []\n", "suite.yaml:1: version 2 of a suite; this version reads 1"),
        ("version: 1\n", "needs the key 'problems'"),
        ("version: 1\nproblems: []\n", "at least one problem"),
        ("version: 1\nproblems: 3\n", "has to be a list"),
        ("version: 1\nproblem: []\nproblems: []\n", "unknown key 'problem'"),
        ("version: 1\nproblems:\n  - {place: desk}\n", "suite.yaml:3: .*needs one of the keys"),
        ("version: 1\nproblems:\n  - {scene: atlantis}\n", "unknown scene 'atlantis'; valid: desk"),
        ("version: 1\nproblems:\n  - {scene: desk, tasks: [juggle]}\n", "suite.yaml:3: unknown task of desk 'juggle'"),
        ("version: 1\nproblems:\n  - {scene: desk, tasks: 0}\n", "expected a whole number in .1, 1000000."),
        ("version: 1\nproblems:\n  - {scene: desk, start: ready}\n", "needs the key 'goal'"),
        ("version: 1\nproblems:\n  - {scene: desk, start: [0, 1], goal: ready}\n", "has 2 numbers, expected 7"),
        ("version: 1\nproblems:\n  - {scene: desk, start: there, goal: ready}\n", "unknown keyframe 'there'"),
        ("version: 1\nproblems:\n  - {scene: desk, tasks: 1, start: ready, goal: ready}\n", "one or the other"),
        ("version: 1\nproblems:\n  - {analytic: [hope]}\n", "unknown analytic problem 'hope'"),
        ("version: 1\nproblems:\n  - {file: nowhere.yaml}\n", "there is no .*nowhere.yaml"),
        ("version: 1\nproblems:\n  - {scene: desk}\n  - {scene: desk, tasks: 1}\n", "a unique name for every problem"),
        ("version: 1\nseeds: []\nproblems: [{analytic: [disc]}]\n", "at least one seed"),
        ("version: 1\nseeds: [1, 1]\nproblems: [{analytic: [disc]}]\n", "none twice"),
        ("version: 1\nseeds: 0\nproblems: [{analytic: [disc]}]\n", "whole number in .1, 1000000."),
        ("version: 1\nseconds: 0\nproblems: [{analytic: [disc]}]\n", "number > 0"),
        ("version: 1\nw: -1\nproblems: [{analytic: [disc]}]\n", "number >= 0"),
        ("version: 1\nproblems: [{analytic: [disc]}]\nbest_known: {desc: 1}\n", "'desc'; valid: analytic/disc"),
        ("version: 1\nproblems: [&a {analytic: [disc]}]\n", "anchors"),
    ],
)
def test_errors_of_broken_suites_name_the_place(tmp_path, text, message):
    with pytest.raises(SceneError, match=message):
        bench.load_suite(written(tmp_path, text))


def test_unknown_suites_list_the_valid_ones():
    with pytest.raises(UnknownNameError, match=r"'kitchens'.*household"):
        bench.load_suite("kitchens")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"seeds": 0}, "seeds = 0"),
        ({"seeds": True}, "seeds = True"),
        ({"seeds": []}, "seeds"),
        ({"seeds": [1, 1]}, "none twice"),
        ({"seeds": [-1]}, ">= 0"),
        ({"seconds": 0.0}, "seconds = 0.0"),
        ({"seconds": float("nan")}, "seconds = nan"),
        ({"w": -1.0}, "w = -1.0"),
        ({"processes": 10_000}, "processes = 10000, expected at most"),
        ({"processes": -1}, "processes = -1"),
    ],
)
def test_settings_out_of_range(tmp_path, given, message):
    with pytest.raises(SettingError, match=message):
        settle(suite_file(tmp_path), planners=["rrt_connect"], **given)


def test_known_optima_count_at_their_own_weight_only(tmp_path):
    file = suite_file(tmp_path, "disc")
    own = bench.compare(file, planners=["rrt_connect"], seeds=1, out=tmp_path / "a", processes=0)
    other = bench.compare(file, planners=["rrt_connect"], seeds=1, w=0.5, out=tmp_path / "b", processes=0)
    assert own.known["analytic/disc"] == pytest.approx(4.511299166334352)
    assert other.known == {}
