import json
import re
import subprocess
import sys
import threading

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan import documents
from graceful_plan.tools import cli, demo, progress


@pytest.fixture(scope="module")
def motion(tmp_path_factory):
    """A verified trajectory in a file."""
    file = tmp_path_factory.mktemp("motion") / "trajectory.json"
    task = next(iter(gp.load_scene("tabletop").tasks.values()))
    gp.plan(task.start, task.goal, task.scene, w=0.0, iterations=50).unwrap().to_json(file)
    return file


def test_plan_prints_the_cost_and_writes_the_trajectory(run, tmp_path):
    code, out, err = run("plan", "--w", "0", "--iterations", "50", "--output", str(tmp_path / "t.json"))
    assert (code, err) == (cli.DONE, "")
    assert out.startswith("SOLVED: ")
    assert "motion + w * impact" in out
    trajectory = gp.Trajectory.from_json(tmp_path / "t.json")
    np.testing.assert_allclose(trajectory.q[0], next(iter(gp.load_scene("tabletop").tasks.values())).start, atol=1e-6)


def test_plan_json_is_one_document_and_reproducible(run):
    argv = ("plan", "--json", "--iterations", "50", "--seed", "3")
    first, second = (run(*argv) for _ in range(2))
    assert first[0] == cli.DONE
    a, b = (json.loads(out) for _, out, _ in (first, second))
    assert a["status"] == "SOLVED"
    assert a["verdict"]["passed"]
    assert a["cost"]["total"] == pytest.approx(a["cost"]["motion"] + a["cost"]["w"] * a["cost"]["impact"])
    assert a["path"] == b["path"]


def test_plan_between_keyframes_and_numbers(run):
    scene = gp.load_scene("tabletop")
    name, q = next(iter(scene.keyframes.items()))
    numbers = [repr(float(x)) for x in q]
    code, out, _ = run("plan", "--start", name, "--goal", *numbers, "--iterations", "5", "--json")
    assert (code, json.loads(out)["status"]) == (cli.DONE, "SOLVED")


@pytest.mark.parametrize("ending", documents.MOTION_FILES)
def test_the_format_is_that_of_the_ending(run, tmp_path, ending):
    file = tmp_path / f"t{ending}"
    assert run("plan", "--w", "0", "--iterations", "50", "--output", str(file))[0] == cli.DONE
    assert isinstance(documents.read_motion(file), gp.Trajectory)
    assert run("evaluate", str(file))[0] == cli.DONE
    file.write_bytes(b"\x00nothing of the kind")
    code, _, err = run("evaluate", str(file))
    assert (code, err.startswith(f"graceful-plan evaluate: {file}: ")) == (cli.MISUSE, True)


def test_failure_has_its_own_exit_code(run):
    scene = gp.load_scene("tabletop")
    outside = [repr(float(x)) for x in scene.limits.position[:, 1] + 1.0]
    code, out, _ = run("plan", "--start", "ready", "--goal", *outside)
    assert code == cli.FAILED
    assert out.startswith("INVALID_GOAL: ")


@pytest.mark.long
@pytest.mark.parametrize(
    ("argv", "message"),
    [
        (("plan", "--scene", "atlantis"), "unknown scene 'atlantis'; valid: apartment, desk"),
        (("plan", "--scene", "nowhere.yaml"), "nowhere.yaml"),
        (("plan", "--task", "juggle"), "unknown task 'juggle'"),
        (("plan", "--planner", "hope"), "unknown planner 'hope'"),
        (("plan", "--w", "-1"), "w = -1.0"),
        (("plan", "--w", "nan"), "w = nan"),
        (("plan", "--time-limit", "nan"), "time_limit = nan"),
        (("plan", "--start", "0", "0"), "shape (2,)"),
        (("plan", "--start", "ready", "now"), "--start = 'ready now'"),
        (("plan", "--start", "nowhere"), "unknown keyframe 'nowhere'"),
        (("plan", "--output", "trajectory.txt"), "ends in .json, .csv, .parquet or .yaml"),
        (("plan", "--iterations", "1", "--output", "no/such/folder/t.json"), "No such file or directory"),
        (("evaluate", "nowhere.json"), "nowhere.json: cannot be read"),
        (("explain", "nowhere.json"), "nowhere.json: cannot be read"),
        (("explain", "nowhere.json", "--output", "picture.gif"), "ends in .png, .pdf or .svg"),
        (("map", "--height", "-1"), "height = -1.0"),
        (("map", "--height", "0.1", "--model", "crystal_ball"), "unknown interaction model 'crystal_ball'"),
        (("map", "--height", "0.1", "--at", "nowhere"), "unknown keyframe 'nowhere'"),
        (("map", "--height", "0.1", "--task", "juggle"), "unknown task 'juggle'"),
    ],
)
def test_misuse_is_one_line_without_a_traceback(run, argv, message):
    code, out, err = run(*argv)
    assert (code, out) == (cli.MISUSE, "")
    assert message in err
    assert err.startswith(f"graceful-plan {argv[0]}: ")
    assert "Traceback" not in err
    assert err.count("\n") == 1


@pytest.mark.parametrize("argv", [("levitate",), (), ("plan", "--hope"), ("plan", "--w", "much")])
def test_invalid_command_lines_are_misuse(run, argv):
    code, out, err = run(*argv)
    assert (code, out) == (cli.MISUSE, "")
    assert err.startswith("usage: graceful-plan")
    assert err.splitlines()[-1].startswith("graceful-plan: ")


@pytest.mark.parametrize(
    ("argv", "kind", "command"),
    [
        (("plan", "--hope"), "UsageError", "graceful-plan"),
        (("plan", "--w", "-1"), "SettingError", "graceful-plan plan"),
        (("evaluate", "nowhere.json"), "FormatError", "graceful-plan evaluate"),
        (("plan", "--output", "no/such/t.json"), "FileNotFoundError", "graceful-plan plan"),
    ],
)
def test_with_json_errors_are_json(run, argv, kind, command):
    code, out, err = run(*argv, "--json")
    document = json.loads(out)
    assert code == document["exit_code"] == cli.MISUSE
    assert (document["schema"], document["error"], document["command"]) == ("graceful_plan.error", kind, command)
    assert document["message"] in err


@pytest.fixture
def never_planned(monkeypatch):
    def planned(*_, **__):
        raise AssertionError("it was planned before what was asked for had been checked")

    monkeypatch.setattr(gp, "plan", planned)
    monkeypatch.setattr(gp, "pareto", planned)


@pytest.mark.usefixtures("never_planned")
@pytest.mark.parametrize(
    ("command", "output", "message"),
    [
        ("plan", "folder.json", "Is a directory"),
        ("plan", "no/such/t.json", "No such file or directory"),
        ("plan", "file/t.json", "Not a directory"),
        ("tune", "file", "Not a directory"),
        ("tune", "file/below", "Not a directory"),
        ("demo", "file/below", "Not a directory"),
        ("bench", "file", "Not a directory"),
    ],
)
def test_output_is_checked_before_planning(run, tmp_path, command, output, message):
    (tmp_path / "folder.json").mkdir()
    (tmp_path / "file").touch()
    code, _, err = run(command, "--output", str(tmp_path / output))
    assert code == cli.MISUSE
    assert message in err and str(tmp_path) in err


@pytest.mark.usefixtures("never_planned")
@pytest.mark.parametrize("command", ["plan", "tune"])
def test_planners_have_settings_everywhere(run, command, tmp_path):
    code, _, err = run(command, "--planner", "rrt_star:range=-1.0", "--output", str(tmp_path / "t.json"))
    assert (code, "range = -1" in err) == (cli.MISUSE, True)


@pytest.mark.long
def test_a_planner_with_settings_plans(run):
    assert run("plan", "--planner", "rrt_connect:range=0.4", "--iterations", "500")[0] == cli.DONE


def test_validation_needs_a_task(run):
    scene = gp.load_scene("tabletop")
    name = next(iter(scene.keyframes))
    code, _, err = run("plan", "--start", name, "--goal", name, "--validate", "2")
    assert (code, "by --task" in err) == (cli.MISUSE, True)
    assert run("plan", "--validate", "-2")[0] == cli.MISUSE


@pytest.mark.long
def test_validation_puts_failures_beside_the_plan(run):
    argv = ("plan", "--iterations", "50", "--validate", "3")
    code, out, err = run(*argv)
    assert (code, err) == (cli.DONE, "")
    assert "observed impact" in out and "predicted impact" in out
    document = json.loads(run(*argv, "--json")[1])
    assert document["validation"]["schema"] == "failbench.validation"
    assert document["validation"]["n"] == 3


BROKEN = {
    "nothing": "",
    "no text": "\xff\x00",
    "deep": "[" * 50_000,
    "list": "[1, 2]",
    "object": "{}",
    "null": '{"schema": "graceful_plan.result", "trajectory": null, "path": null}',
    "no trajectory": '{"schema": "graceful_plan.result", "trajectory": {"q": 3}}',
    "ragged": '{"schema": "graceful_plan.path", "version": 1, "q": [[1, 2], [3]]}',
    "words": '{"schema": "graceful_plan.path", "version": 1, "q": [["a"]]}',
    "not finite": '{"schema": "graceful_plan.path", "version": 1, "q": [[1e999, 0, 0, 0, 0, 0, 0]]}',
    "too great": f'{{"schema": "graceful_plan.path", "version": 1, "q": [[1{"0" * 400}]]}}',
    "empty": '{"schema": "graceful_plan.path", "version": 1, "q": []}',
    "other robot": '{"schema": "graceful_plan.path", "version": 1, "q": [[0, 0], [1, 1]]}',
}


@pytest.mark.parametrize("command", ["evaluate", "explain"])
@pytest.mark.parametrize("text", BROKEN.values(), ids=BROKEN)
def test_broken_motions_are_named_with_their_file(run, tmp_path, command, text):
    (tmp_path / "motion.json").write_bytes(text.encode("latin-1"))
    code, out, err = run(command, str(tmp_path / "motion.json"))
    assert (code, out) == (cli.MISUSE, "")
    assert err.startswith(f"graceful-plan {command}: {tmp_path / 'motion.json'}: ")
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("joints", lambda joints: joints[::-1], "its joints are panda/joint7, "),
        ("joints", lambda joints: joints[1:], "q has shape"),
        ("t", lambda t: t[::-1], "time must increase"),
        ("q", lambda q: [[10**400] * 7 for _ in q], "q has shape"),
        ("qd", lambda qd: None, "qd must be a list of numbers"),
        ("qd", lambda qd: [[1e9] * 7 for _ in qd], "positions and velocities of at most 1000"),
        ("q", lambda q: [[i * 1e4] * 7 for i in range(len(q))], "states of the path"),
    ],
)
def test_broken_trajectories_are_named_with_their_file(run, motion, tmp_path, key, value, message):
    document = json.loads(motion.read_text())
    document[key] = value(document[key])
    (tmp_path / "t.json").write_text(json.dumps(document))
    for command in ("evaluate", "explain"):
        code, _, err = run(command, str(tmp_path / "t.json"))
        assert code == cli.MISUSE
        assert f"{tmp_path / 't.json'}: " in err and message in err


def test_evaluate_judges_a_trajectory(run, motion):
    code, out, _ = run("evaluate", str(motion))
    assert code == cli.DONE
    assert "FAILED" not in out
    code, out, _ = run("evaluate", str(motion), "--w", "2", "--json")
    document = json.loads(out)
    assert document["verdict"]["passed"]
    assert document["cost"]["total"] == pytest.approx(document["cost"]["motion"] + 2 * document["cost"]["impact"])


def test_evaluate_warns_of_entities_that_a_base_hits(run, tmp_path):
    task = gp.load_scene("warehouse_aisle").tasks["bring_tools"]
    motion = gp.retime(
        gp.Path(np.array([[0.0, 0.0, 0.0], [7.0, 0.0, 0.0]])), task.scene.limits, joints=task.scene.joints
    )
    file = tmp_path / "drive.json"
    motion.to_json(file)
    _, out, _ = run("evaluate", str(file), "--scene", "warehouse_aisle", "--task", "bring_tools")
    (row,) = (line for line in out.splitlines() if line.startswith("passing_by"))
    assert "warns" in row and "drives into 'truck'" in row


def test_evaluate_finds_the_collision_of_a_path(run, tmp_path):
    scene = next(iter(gp.load_scene("tabletop").tasks.values())).scene
    low, high = scene.limits.position.T
    q = np.random.default_rng(0).uniform(low, high, (200, len(low)))
    colliding = q[~(gp.clearance(q, scene) > 0.0)]
    file = tmp_path / "path.json"
    file.write_text(json.dumps(documents.path_document(gp.Path(colliding[:1]))))
    code, out, _ = run("evaluate", str(file))
    assert code == cli.FAILED
    assert "FAILED" in out


def test_explain_lists_sources_of_impact(run, motion, tmp_path):
    picture = tmp_path / "explanation.png"
    code, out, _ = run("explain", str(motion), "--model", "mixture", "--exposure", "length", "--output", str(picture))
    assert code == cli.DONE
    assert out.startswith("impact ")
    assert " onto " in out
    assert f"wrote {picture}" in out
    assert picture.read_bytes().startswith(b"\x89PNG")
    document = json.loads(run("explain", str(motion), "--json")[1])
    evaluated = json.loads(run("evaluate", str(motion), "--json")[1])
    assert document["cost"]["impact_by_entity"] == evaluated["cost"]["impact_by_entity"]
    assert sum(row["share"] for row in document["contributions"]) == pytest.approx(1.0)


def test_map_names_the_worst_place_for_a_drop(run, tmp_path):
    picture = tmp_path / "map.svg"
    code, out, _ = run("map", "--height", "0.2", "--speed", "0.5", "--resolution", "0.05", "--output", str(picture))
    assert code == cli.DONE
    assert "everything" in out
    assert picture.read_text().startswith("<?xml")
    argv = ("map", "--height", "0.2", "--at", "ready", "--resolution", "0.05", "--json")
    document = json.loads(run(*argv)[1])
    scene = next(iter(gp.load_scene("tabletop").tasks.values())).scene
    found = gp.impact_map(scene, height=0.2, q=scene.keyframes["ready"], resolution=0.05)
    np.testing.assert_array_equal(np.array(document["impact"], dtype=float), found.impact)


@pytest.mark.long
def test_scenes_lists_all_with_their_tasks(run):
    code, out, _ = run("scenes", "--json")
    document = json.loads(out)
    assert code == cli.DONE
    assert tuple(document) == (*gp.scenes(), *gp.mobile_scenes())
    assert all(scene["tasks"] and scene["entities"] for scene in document.values())
    text = run("scenes")[1]
    assert all(name in text for name in document)


def test_planners_lists_all_with_their_settings(run):
    code, out, _ = run("planners", "--json")
    document = json.loads(out)
    assert code == cli.DONE
    assert {"anytime", "rrt_connect"} <= set(document)
    assert all(entry["summary"] for entry in document.values())
    text = run("planners")[1]
    assert all(name in text for name in document)


def test_doctor_finds_this_machine_healthy(run):
    code, out, _ = run("doctor", "--json")
    document = json.loads(out)
    assert {name: finding for name, finding in document.items() if not finding["ok"]} == {}
    assert code == cli.DONE
    assert document["instruction set"]["value"]
    assert document["mujoco"]["value"].startswith("4.")


@pytest.mark.long
def test_demo_writes_picture_and_trajectories_and_lowers_the_impact(run, tmp_path):
    code, out, err = run("demo", "--output", str(tmp_path / "made"), "--iterations", "2000")
    assert (code, err) == (cli.DONE, "")
    assert "motion + w * impact" in out
    made = {file.name for file in (tmp_path / "made").iterdir()}
    wanted = {"demo.png", "trajectory_w0.csv", "trajectory_w0.json", "trajectory_w0.3.csv", "trajectory_w0.3.json"}
    assert wanted <= made <= wanted | {"view.png"}
    assert all(name in out for name in made)


@pytest.mark.long
def test_demo_json_compares_both(run, tmp_path):
    code, out, _ = run("demo", "--output", str(tmp_path), "--iterations", "2000", "--json")
    plain, graceful = json.loads(out)["results"].values()
    assert code == cli.DONE
    assert graceful["cost"]["impact"] <= 0.5 * plain["cost"]["impact"]
    assert graceful["cost"]["motion"] >= plain["cost"]["motion"]


def test_interrupt_ends_with_130(run, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(gp, "plan", interrupted)
    assert run("plan")[::2] == (cli.INTERRUPTED, "graceful-plan plan: interrupted\n")
    code, out, _ = run("plan", "--json")
    assert code == json.loads(out)["exit_code"] == cli.INTERRUPTED


@pytest.mark.long
def test_progress_is_shown_on_a_terminal_only(run, monkeypatch):
    assert run("plan", "--iterations", "50")[2] == ""
    monkeypatch.setattr(sys.stderr.__class__, "isatty", lambda self: True)
    code, out, err = run("plan", "--iterations", "50")
    assert code == cli.DONE
    assert "\x1b" not in out
    assert "motion" in err
    assert err.endswith("\r\x1b[K")
    assert run("plan", "--iterations", "50", "--json")[2] == ""


def test_a_terminal_shows_progress(run, monkeypatch):
    monkeypatch.setattr(progress, "_TICK", 0.01)
    monkeypatch.setattr(sys.stderr.__class__, "isatty", lambda self: True)
    told = threading.Event()
    plan = gp.plan

    def slow(*args, **kwargs):
        assert told.wait(30.0)
        return plan(*args, **kwargs)

    overwrite = progress._overwrite
    monkeypatch.setattr(progress, "_overwrite", lambda text: (overwrite(text), "preparing" in text and told.set()))
    monkeypatch.setattr(gp, "plan", slow)
    code, _, err = run("plan", "--iterations", "50")
    assert code == cli.DONE
    assert "s  preparing the scene" in err and err.endswith("\r\x1b[K")


@pytest.mark.long
def test_reader_that_goes_away_is_no_error():
    command = f"{sys.executable} -m graceful_plan.tools.cli scenes --json | true"
    done = subprocess.run(["bash", "-o", "pipefail", "-c", command], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (cli.DONE, "")


def test_demo_compares_cost_and_impact():
    """All numbers of the sentence come from the results, for increases and decreases."""

    def result(motion, impact, seconds, w):
        trajectory = gp.Trajectory(np.array([0.0, seconds]), *np.zeros((3, 2, 1)), ("joint",))
        cost = gp.CostBreakdown(motion=motion, impact=impact, w=w)
        return gp.PlanResult(status=gp.PlanStatus.SOLVED, trajectory=trajectory, cost=cost)

    found = demo.DemoResults(results={"a": result(2.0, 8.0, 1.5, 0.0), "b": result(3.66, 0.4, 4.0, 1.0)}, files=())
    assert found.comparison() == (
        "Compared with the shortest motion, the one planned with w = 1 has 83 % more joint motion (3.66 rad for 2 rad)"
        " and 95 % less impact (0.4 for 8); it takes 4 s for 1.5 s."
    )
    other = demo.DemoResults(results={"a": result(2.0, 0.0, 1.5, 0.0), "b": result(1.0, 0.4, 4.0, 1.0)}, files=())
    assert re.search(r"50 % .*1 rad .*2 rad.*0\.4 .* 0\)", other.comparison())


def test_demo_labels_show_the_weight():
    assert {f"w = {w:g}" for w in demo.WEIGHTS.values()} == {label.split(" (")[0] for label in demo.WEIGHTS}


@pytest.mark.long
def test_plan_on_a_map_with_people_and_a_picture(run, tmp_path):
    gp.OccupancyGrid(occupancy=np.zeros((60, 100), dtype=bool), resolution=0.05).save(tmp_path / "hall.yaml")
    people = ("--entity", "adult", "2.5", "0.6", "--walker", "adult", "4.5", "2.5", "4.5", "0.5", "1.0")
    words = ("plan", "--map", str(tmp_path / "hall.yaml"), "--start", "0.6,1.5,0", "--goal", "4,1.5", *people)
    code, out, _ = run(*words, "--iterations", "3000", "--json", "--picture", str(tmp_path / "hall.png"))
    told = json.loads(out)
    assert (code, told["status"]) == (cli.DONE, "SOLVED") and told["verdict"]["checks"]["passing_by"]["passed"]
    assert {"adult_1", "adult_walking_1"} <= set(told["cost"]["impact_by_entity"])
    assert (tmp_path / "hall.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--start", "1,1", "--goal", "2,2"), "--start"),
        (("--start", "1", "1", "0", "--goal", "2,x"), "--goal"),
        (("--start", "1,1,0", "--goal", "2,2", "--task", "any"), "--task"),
        (("--start", "1,1,0", "--goal", "2,2", "--robot", "spot"), "spot"),
        (("--start", "1,1,0", "--goal", "2,2", "--entity", "ghost", "1", "2"), "ghost"),
        (("--start", "1,1,0", "--goal", "2,2", "--walker", "adult", "1", "2", "1", "2", "1"), "--walker"),
        (("--start", "1,1,0", "--goal", "2,2", "--picture", "map.txt"), ".png"),
    ],
)
def test_errors_of_maps_name_the_problem(run, tmp_path, words, said):
    gp.OccupancyGrid(occupancy=np.zeros((60, 100), dtype=bool), resolution=0.05).save(tmp_path / "hall.yaml")
    code, _, err = run("plan", "--map", str(tmp_path / "hall.yaml"), *words)
    assert code == cli.MISUSE and said in err
