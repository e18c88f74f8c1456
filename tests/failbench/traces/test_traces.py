"""Traces: contact points with forces, states and energies, tables and LeRobot's form, read by other programs."""

import json

import mujoco
import numpy as np
import pandas
import polars
import pytest
from breaking import Nothing, healthy_run
from motions import execution

import failbench as fb
from failbench.cli import main
from failbench.fault.registry import GripperFailure, to_document
from failbench.sweeps.definition import Sweep, SweepMotion
from failbench.sweeps.executors import LocalExecutor
from failbench.traces.folder import write_traces
from failbench.traces.lerobot import write_lerobot
from failbench.traces.trace import Sampling, trace
from graceful_plan.exceptions import FormatError, SettingError

DROP = GripperFailure(degree="critical")


def traced(job, done, **given):
    rows = {"steps": [], "points": []}
    for part in trace(done, job, **given):
        for name, found in rows.items():
            found += part[name]
    return pandas.DataFrame(rows["steps"]), pandas.DataFrame(rows["points"])


def test_states_equal_those_of_the_rollout():
    job = fb.RolloutRequest(fault=DROP, onset=0.3, seed=1)
    steps, _ = traced(job, healthy_run(), horizon=0.1, sampling=Sampling(every=10))
    assert steps["step"].tolist() == [0, 10, 20, 30, 40]
    states = [data.qpos.copy() for _, data in fb.rollout_steps(healthy_run(), job, horizon=0.1)]
    assert np.array_equal(steps["qpos"][3], states[29])  # state before step 30
    robot = healthy_run().world.robot
    assert np.array_equal(steps["q"][3], states[29][robot.qpos])
    assert np.array_equal(steps["qpos"][0][:7], healthy_run().states[healthy_run().checkpoint(0.3)][1:8])


def test_energies_include_all_masses():
    job = fb.RolloutRequest(fault=DROP, onset=0.3, seed=1)
    steps, _ = traced(job, healthy_run(), horizon=0.1, sampling=Sampling(every=20))
    model, data = healthy_run().world.model, mujoco.MjData(healthy_run().world.model)
    for _, row in steps.iterrows():
        data.qpos[:], data.qvel[:] = row["qpos"], row["qvel"]
        mujoco.mj_forward(model, data)
        M = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, M)
        assert row["kinetic"] == pytest.approx(0.5 * data.qvel @ M @ data.qvel)
        assert row["potential"] == pytest.approx(9.81 * model.body_mass @ data.xipos[:, 2], rel=1e-6)
    assert steps["kinetic"].max() > 0.01


def test_contact_forces_equal_those_of_events():
    job = fb.RolloutRequest(fault=DROP, onset=0.3, seed=1)
    (rollout,) = fb.run_rollouts(healthy_run(), [job], horizon=0.5)
    _, points = traced(job, healthy_run(), horizon=0.5, sampling=Sampling(every=1))
    events = [e for e in rollout.events if e.striker == "carried" and not e.secondary]
    assert events
    for event in events:
        one = points[(points["first"] == "carried") & (points["second"] == event.entity)]
        other = points[(points["second"] == "carried") & (points["first"] == event.entity)]
        both = pandas.concat([one, other.assign(fx=-other["fx"], fy=-other["fy"], fz=-other["fz"])])
        force = both.groupby("step")[["fx", "fy", "fz"]].sum()
        impulse = np.linalg.norm(force, axis=1).sum() * 0.002
        assert impulse == pytest.approx(event.impulse, rel=1e-6)
        assert force.index.min() * 0.002 == pytest.approx(event.time)


def test_the_gripper_carries_what_it_holds():
    done = healthy_run()
    steps, points = traced(
        fb.RolloutRequest(fault=Nothing(), onset=99.0, seed=0), done, horizon=0.6, sampling=Sampling(every=50)
    )
    held = points[(points["first"].eq("carried")) | (points["second"].eq("carried"))]
    held = held[held["step"] == steps["step"].max()]
    up = np.where(held["second"] == "carried", held["fz"], -held["fz"]).sum()
    weight = done.world.model.body_mass[done.world.carried_body] * 9.81
    assert up == pytest.approx(weight, rel=0.05)


def test_sampling_options_are_checked():
    with pytest.raises(SettingError, match="every = 0"):
        Sampling(every=0)
    with pytest.raises(SettingError, match=r"images = 7.*every = 5"):
        Sampling(images=7)


# --- folders --------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    done = execution()
    motion = SweepMotion(name="m", scene="tabletop", task="green_to_blue", trajectory=done.trajectory)
    sweep = Sweep(motions=(motion,), faults=(to_document(DROP),), rollouts=3, horizon=0.1)
    folder = tmp_path_factory.mktemp("data") / "set"
    fb.generate_dataset(sweep, folder, executor=LocalExecutor(workers=1))
    return folder


def test_pandas_and_polars_read_the_self_describing_tables(dataset, tmp_path):
    counts = write_traces(dataset, tmp_path, rollouts=[0, 2], sampling=Sampling(every=10))
    steps = pandas.read_parquet(tmp_path / "steps")
    points = polars.read_parquet(tmp_path / "points" / "*.parquet")
    assert (len(steps), len(points), 0) == (counts["steps"], counts["points"], counts["images"]) and len(steps) == 10
    assert steps["rollout"].unique().tolist() == [0, 2]
    assert points.columns == "rollout step time first second x y z fx fy fz depth".split()
    assert points["fz"].is_finite().all() and points.filter(polars.col("first") == "carried").height > 0
    card = (tmp_path / "README.md").read_text()
    assert card.startswith("---\n") and "config_name: points" in card and "images/*.parquet" not in card
    assert f"{counts['points']} rows" in card and "gripper_failure (critical)" in card
    again = tmp_path / "again"
    again.mkdir()
    (again / "README.md").write_text("of somebody else")
    write_traces(dataset, again, rollouts=[0, 2], sampling=Sampling(every=10))
    for table in ("steps", "points"):
        name = f"{table}/part-00000.parquet"
        assert (again / name).read_bytes() == (tmp_path / name).read_bytes()
    assert (again / "README.md").read_text() == "of somebody else"
    card_of_another_run = tmp_path / "README.md"
    card_of_another_run.write_text(card + "more")
    write_traces(dataset, tmp_path, rollouts=[0, 2], sampling=Sampling(every=10))
    assert card_of_another_run.read_text() == card


def test_hugging_face_datasets_reads_them(dataset, tmp_path):
    datasets = pytest.importorskip("datasets")
    write_traces(dataset, tmp_path / "t", rollouts=[1], sampling=Sampling(every=10))
    for name, columns in (("points", {"fx", "first"}), ("steps", {"qpos", "kinetic"})):
        found = datasets.load_dataset(str(tmp_path / "t"), name, split="train", cache_dir=str(tmp_path / "cache"))
        assert columns <= set(found.column_names) and len(found)


def test_lerobots_form_follows_version_3(dataset, tmp_path):
    frames = write_lerobot(dataset, tmp_path / "l", every=10)
    info = json.loads((tmp_path / "l" / "meta" / "info.json").read_text())
    assert (info["codebase_version"], info["fps"], info["total_episodes"], info["total_frames"]) == (
        "v3.0",
        50,
        3,
        frames,
    )
    data = pandas.read_parquet(tmp_path / "l" / info["data_path"].format(chunk_index=0, file_index=0))
    assert set(data.columns) == set(info["features"])
    for name, feature in info["features"].items():
        assert np.stack(data[name].to_numpy()).reshape(len(data), -1).shape[1] == feature["shape"][0]
        assert feature["names"] is None or len(feature["names"]) == feature["shape"][0]
    assert data["index"].tolist() == list(range(frames))
    assert data.groupby("episode_index")["timestamp"].max().tolist() == pytest.approx([0.08] * 3)
    episodes = pandas.read_parquet(tmp_path / "l" / "meta" / "episodes" / "chunk-000" / "file-000.parquet")
    assert episodes["dataset_to_index"].tolist() == [5, 10, 15] and episodes["length"].sum() == frames
    tasks = pandas.read_parquet(tmp_path / "l" / "meta" / "tasks.parquet")
    assert tasks.iloc[0].name == "m, and then: gripper_failure (critical)" and tasks["task_index"].tolist() == [0]
    stats = json.loads((tmp_path / "l" / "meta" / "stats.json").read_text())
    assert stats["action"]["mean"] == pytest.approx(np.stack(data["action"]).mean(axis=0), rel=1e-5)
    with pytest.raises(SettingError, match="exist"):
        write_lerobot(dataset, tmp_path / "l")
    with pytest.raises(SettingError, match="every = 3"):
        write_lerobot(dataset, tmp_path / "k", every=3)


def test_the_command_writes_both(dataset, tmp_path, capsys):
    assert main(["trace", str(dataset), str(tmp_path / "a"), "--rollouts", "1", "--every", "25"]) == 0
    assert "2 steps, " in capsys.readouterr().out
    assert main(["trace", str(dataset), str(tmp_path / "b"), "--rollouts", "1", "--form", "lerobot"]) == 0
    assert "10 frames in" in capsys.readouterr().out
    assert main(["trace", str(dataset), str(tmp_path / "c"), "--rollouts", "9"]) == 2


def test_non_finite_numbers_are_refused(dataset, tmp_path):
    with pytest.raises(SettingError, match=r"rollout = 3.*2"):
        write_traces(dataset, tmp_path / "x", rollouts=[3])
    with pytest.raises(SettingError, match="once"):
        write_traces(dataset, tmp_path / "x", rollouts=[1, 1])
    with pytest.raises(FormatError, match=r"manifest\.json"):
        write_traces(tmp_path, tmp_path / "x")


@pytest.mark.long
def test_pictures_are_of_the_states(dataset, tmp_path):
    counts = write_traces(dataset, tmp_path, rollouts=[0], sampling=Sampling(every=10, images=20, size=(64, 48)))
    assert counts["images"] == 3
    first = pandas.read_parquet(tmp_path / "images")["image"][0]
    assert first["bytes"].startswith(b"\x89PNG")
    assert "dtype: image" in (tmp_path / "README.md").read_text()


def test_invalid_steps_and_folders_are_refused(dataset, tmp_path):
    (tmp_path / "file").write_text("")
    for write in (write_traces, write_lerobot):
        for output in (tmp_path / "file" / "below", "a\0b"):
            with pytest.raises(FormatError, match="cannot be written"):
                write(dataset, output)
        with pytest.raises(SettingError, match="rollouts"):
            write(dataset, tmp_path / "x", rollouts=[-1])
    with pytest.raises(SettingError, match="every = 0"):
        write_lerobot(dataset, tmp_path / "x", every=0)
    for wrong in ({"every": 0}, {"images": -5}, {"size": (0, 0)}, {"size": (10**6, 10**6)}):
        with pytest.raises(SettingError, match=next(iter(wrong))):
            Sampling(**wrong)
    assert not (tmp_path / "x").exists()
