import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from processes import all_end, children_of

import graceful_plan as gp
from failbench import cli
from failbench.sweeps.dataset import MANIFEST, read_dataset
from failbench.sweeps.sweep import JOURNAL

DROP = "tabletop/lift_to_goal/gripper_failure/severe"
GO_ON = "interrupted; to continue: failbench resume data"
QUICK = ("--iterations", "50", "--horizon", "0.04")


@pytest.fixture
def run(capsys):
    """Run a command; return exit code, standard output and standard error."""

    def run(*argv: str) -> tuple[int, str, str]:
        code = cli.main(argv)
        return code, *capsys.readouterr()

    return run


@pytest.fixture(scope="module")
def motion(tmp_path_factory):
    """Write a trajectory to a file."""
    file = tmp_path_factory.mktemp("motion") / "trajectory.json"
    task = gp.load_scene("tabletop").tasks["lift_to_goal"]
    gp.plan(task.start, task.goal, task.scene, w=0.0, iterations=50, speed=0.5).unwrap().to_json(file)
    return file


def test_scenarios_are_listed_by_pattern_and_summed_up_without(run):
    code, out, err = run("scenarios", "drop/weak_grip/*")
    assert (code, err) == (cli.DONE, "")
    assert "tabletop/lift_to_goal/weak_grip/minor" in out.splitlines()
    assert all("/weak_grip/" in line for line in out.splitlines())
    _, out, _ = run("scenarios")
    counts = {line.split()[0]: int(line.split()[1]) for line in out.splitlines()[2:]}
    assert counts["tabletop/lift_to_goal/*"] == 19 * 4
    assert counts["drop/*"] == counts["end_effector/*"]
    code, out, _ = run("scenarios", "tabletop/lift_to_goal/noise/*", "--json")
    (minor, *others) = json.loads(out)
    assert minor["fault"]["fault"] == "noise"
    assert len(others) == 3


def test_run_sums_a_scenario_up(run):
    code, out, err = run("run", DROP, "-n", "6", *QUICK)
    assert (code, err) == (cli.DONE, "")
    assert out.startswith("6 rollouts\n")
    assert {"observed impact", "dropped"} <= {line.split("  ")[0] for line in out.splitlines()}


def test_run_json_has_the_rows_and_is_reproducible(run, motion):
    argv = ("run", DROP, "-n", "3", "--horizon", "0.04", "--trajectory", str(motion), "--seed", "4", "--json")
    (code, first, _), (_, second, _) = run(*argv), run(*argv)
    assert code == cli.DONE
    assert first == second
    document = json.loads(first)
    assert [row["rollout"] for row in document["rollouts"]] == [0, 1, 2]
    assert document["sweep"]["motions"][0]["trajectory"] == json.loads(motion.read_text())


def test_a_path_without_time_is_timed(run, motion, tmp_path):
    q = gp.Trajectory.from_json(motion).q.tolist()
    (tmp_path / "path.json").write_text(json.dumps({"schema": "graceful_plan.path", "version": 1, "q": q}))
    code, out, err = run("run", DROP, "-n", "1", "--horizon", "0.04", "--trajectory", str(tmp_path / "path.json"))
    assert (code, err) == (cli.DONE, "")
    assert out.startswith("1 rollouts")


@pytest.mark.long
def test_validate_prints_observed_and_predicted(run, motion):
    argv = ("validate", "--task", "lift_to_goal", "drop/gripper_failure/severe", "-n", "4", *QUICK)
    code, out, err = run(*argv, "--trajectory", str(motion))
    assert (code, err) == (cli.DONE, "")
    assert "observed impact" in out and "predicted impact" in out
    assert "s at 0.001 failures/h" in out and "observed harm" in out
    code, out, _ = run(*argv, "--json", "--rate", "2")
    assert code == cli.DONE
    document = json.loads(out)
    assert (document["n"], document["rate"]) == (4, 2.0)
    failures = 2.0 * document["duration"] / 3600.0
    assert document["per_task"]["observed"]["mean"] == pytest.approx(document["observed"]["mean"] * failures)


@pytest.fixture(scope="module")
def pouring(tmp_path_factory):
    """Return a trajectory that turns the mug of coffee over."""
    file = tmp_path_factory.mktemp("pouring") / "trajectory.json"
    task = gp.load_scene("desk").tasks["bring_coffee"]
    turn = 1.6 * np.eye(7)[5] * np.sign(task.scene.limits.position[5].mean() - task.start[5])
    path = gp.Path(np.stack([task.start, task.start + turn]))
    gp.retime(path, task.scene.limits, task.scene.joints, speed=0.2).to_json(file)
    return file


@pytest.mark.long
def test_harm_without_failure_is_printed_first(run, pouring, tmp_path):
    given = ("--trajectory", str(pouring), "--horizon", "0.1", "--grasp", "weld")
    code, out, _ = run("validate", "--scene", "desk", "--task", "bring_coffee", "-n", "3", *given)
    assert code == cli.DONE and out.startswith(
        "HARM WITHOUT FAILURE: the healthy robot pours out 100 % of the contents"
    )
    code, out, _ = run("run", "desk/bring_coffee/gripper_failure/severe", "-n", "2", *given)
    assert code == cli.DONE and out.startswith(
        "HARM WITHOUT FAILURE: the healthy robot pours out 100 % of the contents"
    )
    folder = tmp_path / "data"
    sweep = ("generate", str(folder), "desk/bring_coffee/gripper_failure/severe", "-n", "2", *given, "--workers", "1")
    code, out, _ = run(*sweep)
    assert code == cli.DONE and out.startswith("HARM WITHOUT FAILURE: desk/bring_coffee: harm ")
    rows = read_dataset(folder).rollouts.to_pylist()
    assert all(row["healthy_spilled"] > 0.98 and row["healthy_harm"] >= 20.0 for row in rows)
    assert all(row["observed_impact"] <= row["whole_impact"] for row in rows)
    code, out, _ = run("resume", str(folder), "--json")
    assert json.loads(out)["healthy"]["desk/bring_coffee"]["harm"] == rows[0]["healthy_harm"]


def test_generate_resume_and_replay_work_on_a_folder(run, tmp_path):
    folder = tmp_path / "data"
    argv = ("generate", str(folder), "tabletop/lift_to_goal/gripper_failure/*", "-n", "3", *QUICK, "--workers", "1")
    code, out, err = run(*argv)
    assert (code, err) == (cli.DONE, "")
    assert out.startswith("12 rollouts with ")
    assert read_dataset(folder).rollouts.num_rows == 12
    manifest = (folder / MANIFEST).read_bytes()
    code, out, _ = run("resume", str(folder), "--json")
    assert code == cli.DONE
    assert json.loads(out)["rows"]["rollouts"] == 12
    assert (folder / MANIFEST).read_bytes() == manifest
    code, _, err = run(*argv, "--seed", "3")
    assert code == cli.MISUSE
    assert err.startswith("failbench generate: ") and "motions, seed" in err
    code, out, err = run("replay", str(folder), "--rollout", "99", "--output", str(tmp_path / "film"))
    assert (code, out) == (cli.MISUSE, "")
    assert "rollout = 99" in err and "11" in err


@pytest.mark.long
def test_replay_writes_frames(run, tmp_path):
    code, out, err = run("replay", DROP, "-n", "2", "--rollout", "1", *QUICK, "--output", str(tmp_path / "film"))
    if "OpenGL" in err:
        pytest.skip("no OpenGL here")
    assert (code, err, out) == (cli.DONE, "", f"wrote {tmp_path / 'film'}\n")
    assert len(list((tmp_path / "film").glob("*.png"))) > 3


@pytest.mark.long
def test_dry_run_prints_a_valid_sweep(run, tmp_path):
    argv = ("generate", str(tmp_path / "data"), DROP, "-n", "2", *QUICK, "--dry-run")
    code, out, _ = run(*argv)
    assert code == cli.DONE
    assert not (tmp_path / "data").exists()
    document = json.loads(out)
    document["faults"][0]["when"] = {"onset": "at_fraction", "fraction": 0.5}
    (tmp_path / "sweep.json").write_text(json.dumps(document))
    argv = ("generate", str(tmp_path / "data"), "--sweep", str(tmp_path / "sweep.json"), "--workers", "1")
    assert run(*argv)[0] == cli.DONE
    assert len(set(read_dataset(tmp_path / "data").rollouts["onset"].to_pylist())) == 1


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        (("scenarios", "cake/*"), "unknown scenarios 'cake/*'"),
        (("run", "tabletop/*"), "expected one scenario, not"),
        (("run", DROP, "-n", "0"), "rollouts = 0"),
        (("run", DROP, "--trajectory", "nowhere.json"), "nowhere.json: cannot be read"),
        (("validate", "--scene", "moon"), "unknown scene 'moon'; valid: apartment, desk"),
        (("validate", "--task", "dance"), "unknown task of tabletop 'dance'"),
        (("generate", "folder"), "expected patterns of scenarios, or --sweep FILE"),
        (("generate", "folder", DROP, "--sweep", "s.json"), "but not both"),
        (("generate", "folder", "--sweep", "nowhere.json"), "nowhere.json"),
        (("generate", "folder", "drop/*/minor", "--trajectory", "t.json"), "expected patterns of one task, not"),
        (("generate", "folder", DROP, "--workers", "-1"), "workers = -1"),
        (("generate", "folder", DROP, "--address", "auto"), "--address = 'auto', expected nothing without"),
        (("resume", "nowhere"), "nowhere: no sweep was begun here"),
    ],
)
def test_misuse_is_one_line_and_exit_code_2(run, tmp_path, monkeypatch, argv, message):
    monkeypatch.chdir(tmp_path)
    code, out, err = run(*argv)
    assert (code, out) == (cli.MISUSE, "")
    assert err.startswith(f"failbench {argv[0]}: ")
    assert message in err
    assert len(err.splitlines()) == 1
    assert not (tmp_path / "folder" / JOURNAL).exists()


@pytest.mark.long
def test_a_sweep_that_failed_in_part_is_exit_code_1(run, tmp_path):
    argv = ("generate", str(tmp_path), DROP, "-n", "1", *QUICK, "--dry-run")
    document = json.loads(run(*argv)[1])
    (tmp_path / "broken.py").write_text(
        "from dataclasses import dataclass\nfrom failbench import Fault\n"
        "@dataclass(frozen=True, kw_only=True)\nclass Broken(Fault):\n"
        "    NAME, CATEGORY, PARAMETER = 'broken', 'sensor', 'nothing'\n"
        "    AMOUNTS = {'severe': 1.0}\n"
        "    def apply(self, plant, level): raise ArithmeticError('no such luck')\n"
    )  # fmt: skip
    document["faults"] = [{"fault": f"{tmp_path / 'broken.py'}:Broken"}]
    (tmp_path / "s.json").write_text(json.dumps(document))
    code, out, err = run("generate", str(tmp_path / "d"), "--sweep", str(tmp_path / "s.json"), "--workers", "1")
    assert (code, out) == (cli.FAILED, "")
    assert "1 of 1" in err and "ArithmeticError: no such luck" in err
    assert f"failbench resume {tmp_path / 'd'}" in err


@pytest.mark.long
def test_progress_is_shown_on_a_terminal_only(run, monkeypatch):
    argv = ("run", DROP, "-n", "2", *QUICK)
    assert run(*argv)[2] == ""
    monkeypatch.setattr(sys.stderr.__class__, "isatty", lambda self: True)
    code, out, err = run(*argv)
    assert code == cli.DONE
    assert "\x1b" not in out
    assert "2/2 rollouts" in err
    assert err.endswith("\r\x1b[K")
    assert run(*argv, "--json")[2] == ""


@pytest.mark.long
def test_ctrl_c_tells_how_to_resume_and_leaves_no_process(tmp_path):
    argv = [sys.executable, "-m", "failbench.cli", "generate", "data", DROP, "-n", "4000", *QUICK, "--workers", "2"]
    driver = subprocess.Popen(
        argv, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    wal = tmp_path / "data" / f"{JOURNAL}-wal"
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline and not (wal.exists() and wal.stat().st_size > 200_000):
        time.sleep(0.02)
    workers = children_of(driver.pid)
    os.killpg(driver.pid, signal.SIGINT)
    out, err = driver.communicate(timeout=20)
    assert (driver.returncode, out, err) == (cli.INTERRUPTED, "", f"failbench generate: {GO_ON}\n")
    assert len(workers) >= 2 and all_end(workers)


@pytest.mark.long
def test_reader_that_goes_away_is_no_error():
    command = f"{sys.executable} -m failbench.cli scenarios --json | true"
    done = subprocess.run(["bash", "-o", "pipefail", "-c", command], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (cli.DONE, "")


@pytest.mark.parametrize(("argv", "kind"), [(("levitate",), "UsageError"), (("run", "nowhere/*"), "UnknownNameError")])
def test_with_json_errors_are_json(run, argv, kind):
    code, out, err = run(*argv, "--json")
    document = json.loads(out)
    assert code == document["exit_code"] == cli.MISUSE
    assert (document["error"], document["message"] in err) == (kind, True)


def test_files_are_named_and_outputs_checked_first(run, tmp_path):
    (tmp_path / "s.json").write_text('{"schema": "failbench.sweep", "version": 0}')
    code, _, err = run("generate", str(tmp_path / "d"), "--sweep", str(tmp_path / "s.json"))
    assert (code, err.startswith(f"failbench generate: {tmp_path / 's.json'}: ")) == (cli.MISUSE, True)
    code, _, err = run("calibrate", str(tmp_path / "no" / "such.yaml"))
    assert (code, "No such file" in err) == (cli.MISUSE, True)
    code, _, err = run("calibrate", str(tmp_path / "constants.json"))
    assert (code, "ends in .yaml or .yml" in err) == (cli.MISUSE, True)
