"""`graceful-plan tune`: its output, its files, and its use of FailBench."""

import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.exceptions import SettingError
from graceful_plan.scene.harm.severity import SCALE
from graceful_plan.tools import cli, validation
from graceful_plan.tuning.fronts import ChoiceStatus
from graceful_plan.tuning.points import ParetoPoint
from graceful_plan.viz.front import draw_front
from graceful_plan.viz.front_page import write_front_page

QUICK = ("tune", "tabletop_l1", "green_to_blue", "--iterations", "150", "--points", "4", "--speed", "0.5")


@pytest.fixture(scope="module")
def task():
    return gp.load_scene("tabletop_l1").tasks["green_to_blue"]


@pytest.fixture(scope="module")
def front(task):
    return gp.pareto(task.start, task.goal, task.scene, points=4, iterations=150, speed=0.5)


@pytest.mark.long
def test_tune_prints_the_front_and_writes_its_files(run, tmp_path):
    code, out, err = run(*QUICK, "--out", str(tmp_path / "made"))
    assert (code, err) == (cli.DONE, "")
    assert out.startswith("SOLVED: ")
    assert {"motion V", "knee", "w = "} <= set(re.findall(r"motion V|knee|w = ", out))
    files = {file.name for file in (tmp_path / "made").iterdir()}
    assert files == {"front.json", "front.png", "front.html", "chosen.json"}
    assert all(f"wrote {tmp_path / 'made' / name}" in out for name in files)
    front = gp.ParetoFront.load(tmp_path / "made" / "front.json")
    chosen = gp.Trajectory.from_json(tmp_path / "made" / "chosen.json")
    np.testing.assert_array_equal(chosen.q, front.choose().point.trajectory.q)
    assert (tmp_path / "made" / "front.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.long
def test_tune_json_is_one_document(run, tmp_path):
    code, out, _ = run(*QUICK, "--json", "--max-detour", "0.5", "--out", str(tmp_path))
    document = json.loads(out)
    assert (code, document["schema"], document["status"]) == (cli.DONE, "graceful_plan.tune", "SOLVED")
    assert document["choice"]["status"] == "MET"
    assert document["choice"]["motion"] <= 1.5 * document["points"][0]["motion"]
    assert document["validation"] is None


@pytest.mark.long
def test_targets_out_of_reach_fail(run, tmp_path):
    code, out, _ = run(*QUICK, "--target-impact", "1e-9", "--max-detour", "0.01", "--out", str(tmp_path))
    assert code == cli.FAILED
    assert ChoiceStatus.UNREACHABLE.value in out
    assert not (tmp_path / "chosen.json").exists()
    assert (tmp_path / "front.html").exists()


def test_no_front_fails_with_its_reason(run, tmp_path):
    code, out, _ = run(*QUICK[:3], "--seconds", "0", "--out", str(tmp_path))
    assert code == cli.FAILED
    assert out.startswith("TIMEOUT: ")
    assert gp.ParetoFront.load(tmp_path / "front.json").status is gp.PlanStatus.TIMEOUT


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        (("tune", "atlantis"), "unknown scene 'atlantis'"),
        (("tune", "tabletop", "juggle"), "unknown task 'juggle'"),
        (("tune", "--scene", "atlantis"), "unknown scene 'atlantis'"),
        (("tune", "--task", "juggle"), "unknown task 'juggle'"),
        (("tune", "desk", "--task", "juggle"), "--scene, --task"),
        (("tune", "--points", "1"), "points = 1"),
        (("tune", "--seconds", "nan"), "time_limit = nan"),
        (("tune", "--target-impact", "-1"), "target_impact = -1.0"),
        (("tune", "--max-detour", "nan"), "max_detour = nan"),
        (("tune", "--validate", "-3"), "validate = -3"),
        (("tune", "--planner", "hope"), "unknown planner 'hope'"),
        (("tune", "--speed", "7"), "speed = 7.0"),
    ],
)
def test_misuse_is_one_line_without_a_traceback(run, argv, message, tmp_path):
    code, out, err = run(*argv, "--out", str(tmp_path))
    assert (code, out) == (cli.MISUSE, "")
    assert message in err
    assert err.startswith("graceful-plan tune: ")
    assert err.count("\n") == 1
    assert not list(tmp_path.iterdir()), "nothing is written before everything is known to make sense"


def test_validation_needs_failbench(run, monkeypatch, tmp_path):
    monkeypatch.setattr(validation.importlib.util, "find_spec", lambda name: None)
    code, _, err = run(*QUICK, "--validate", "5", "--out", str(tmp_path))
    assert code == cli.MISUSE
    assert "FailBench" in err


def test_validation_reports_the_results_of_failbench(tmp_path):
    (tmp_path / "front.json").write_text("{}")
    with pytest.raises(validation.ValidationError, match=r"validate-front: .*front\.json"):
        validation.validate_front(tmp_path / "front.json", "tabletop_l1", "green_to_blue", 2, grasp="fingers")


def test_the_grasp_reaches_failbench_and_refused_motions_say_why(run, monkeypatch, tmp_path):
    asked = []

    def failbench(argv):
        asked.append(argv)
        n = len(gp.ParetoFront.load(Path(argv[1])).points)
        return json.dumps({"points": [{"observed": None, "refused": "no finger touches it"}] * n})

    monkeypatch.setattr(validation, "_failbench", failbench)
    _, out, _ = run(*QUICK, "--validate", "4", "--grasp", "weld", "--out", str(tmp_path))
    (argv,) = asked
    assert argv[argv.index("--grasp") + 1] == "weld"
    assert out.count("no finger touches it") == 1
    assert "no finger touches it" in (tmp_path / "front.html").read_text()


@pytest.mark.long
def test_validation_puts_observed_beside_predicted(run, tmp_path):
    code, out, _ = run(*QUICK, "--validate", "4", "--json", "--out", str(tmp_path))
    validation = json.loads(out)["validation"]
    assert code == cli.DONE
    assert validation["schema"] == "failbench.front_validation"
    assert all(0.0 <= p["observed"]["low"] <= p["observed"]["mean"] for p in validation["points"] if p["observed"])
    assert '"observed": [{"predicted"' in (tmp_path / "front.html").read_text()


# --- figure and page --------------------------------------------------------------------------------------------------


def page_data(file) -> dict:
    found = re.search(r"^const data = (.*);$", file.read_text(), flags=re.MULTILINE)
    assert found
    return json.loads(found[1])


@pytest.mark.long
def test_the_page_holds_the_front_and_is_self_contained(task, front, tmp_path):
    file = tmp_path / "front.html"
    write_front_page(front, task.scene, file, front.choose(), title="</script><b>")
    text = file.read_text()
    assert "</script><b>" not in text
    assert not re.search(r"https?://(?!www\.w3\.org/2000/svg)|@import|<link|src=", text)
    data = page_data(file)
    assert data["title"] == "</script><b>"
    assert [p["motion"] for p in data["points"]] == front.costs[:, 0].tolist()
    assert front.points[data["knee"]] is front.knee
    assert {e["name"] for e in data["entities"]} == {*task.scene.entities, "green"}
    tool = np.array(data["points"][0]["tool"])
    assert tool.shape[1] == 3
    here = task.scene.data_at(task.start).body(task.scene.carried.body).xpos
    np.testing.assert_allclose(tool[0], here, atol=1e-3)
    for view in ("top", "side"):
        assert all(len(corners) > 2 for corners in data["points"][0]["objects"][view])


def test_the_page_marks_motions_that_could_not_be_executed(task, front, tmp_path):
    seen = [
        {"refused": "the object slips"},
        *[{"predicted": 1.0, "observed": 2.0, "low": 1.5, "high": np.inf}] * (len(front) - 1),
    ]
    write_front_page(front, task.scene, tmp_path / "front.html", observed=seen)
    assert page_data(tmp_path / "front.html")["observed"][:2] == [seen[0], {**seen[1], "high": None}]
    with pytest.raises(SettingError, match="observed"):
        write_front_page(front, task.scene, tmp_path / "front.html", observed=seen[1:])


def test_the_page_tells_what_severities_mean_and_how_often_people_are_hit(tmp_path):
    task = gp.load_scene("dining_table").tasks["serve_tea"]
    motion = gp.plan(task.start, task.goal, task.scene, w=0.0, iterations=60)
    kept = {name: getattr(motion, name) for name in ("path", "trajectory", "cost", "verdict")}
    point = ParetoPoint(**kept, made_by="descent", made_with=0.0)
    front = gp.ParetoFront(status=gp.PlanStatus.SOLVED, points=(point,))
    write_front_page(front, task.scene, tmp_path / "front.html")
    data = page_data(tmp_path / "front.html")
    assert dict(data["scale"]) == SCALE
    people = {name for name, entity in task.scene.entities.items() if entity.category.startswith("adult")}
    (point,) = data["points"]
    assert set(point["chances"]) == people and people
    for name, chance in point["chances"].items():
        # Its mean severity is at most the greatest one of the person times the probability.
        worst = max(task.scene.entities[name].severity.values())
        assert point["by_entity"][name] / point["duration"] <= worst * chance + 1e-9 and chance <= 1.0


def test_pictures_of_nothing_are_refused(task, tmp_path):
    empty = gp.ParetoFront(status=gp.PlanStatus.TIMEOUT)
    with pytest.raises(SettingError, match="TIMEOUT"):
        draw_front(empty, tmp_path / "front.png")
    with pytest.raises(SettingError, match="TIMEOUT"):
        write_front_page(empty, task.scene, tmp_path / "front.html")


def test_picture_of_a_single_point_without_impact(task, tmp_path):
    front = gp.pareto(task.start, task.start, task.scene, iterations=10)
    draw_front(front, tmp_path / "front.svg", front.choose())
    assert (tmp_path / "front.svg").read_text().startswith("<?xml")
    write_front_page(front, task.scene, tmp_path / "front.html")


def test_tuning_without_pictures_imports_no_matplotlib():
    import subprocess

    code = "import sys, graceful_plan.tools.tune_report; assert 'matplotlib' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
