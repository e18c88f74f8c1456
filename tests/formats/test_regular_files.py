"""Pipes, devices and folders are refused immediately and by name where a file is expected."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import failbench
import graceful_plan as gp
from failbench.calibrations.failures import read_failures
from failbench.cli import main as failbench_main
from failbench.policies.mlp import Mlp
from failbench.sweeps.definition import Sweep, SweepMotion
from failbench.sweeps.sweep import generate_dataset, read_sweep
from graceful_plan import disk_cache, documents
from graceful_plan.annotation.annotations import Annotations
from graceful_plan.compare.problems.suite import load_suite
from graceful_plan.compare.runs.best_motions import BestMotions
from graceful_plan.compare.runs.comparison import compare, load_comparison
from graceful_plan.compare.runs.known import read_known
from graceful_plan.costs.models.drop.network import DropNetwork
from graceful_plan.exceptions import FormatError, SceneError
from graceful_plan.mobile.floor.files.moving_ai import read_scenarios
from graceful_plan.regular_file import check_regular, open_regular, read_content
from graceful_plan.scene.urdf.srdf import read_srdf
from graceful_plan.tools.cli import main

pytestmark = [
    pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here"),
    pytest.mark.usefixtures("impatient"),
]

_READERS: dict[str, Callable[[Any], Any]] = {
    "m.json": gp.Trajectory.from_json,
    "m.csv": gp.Trajectory.from_csv,
    "m.parquet": gp.Trajectory.from_parquet,
    "m.yaml": gp.Trajectory.from_ros,
    "motion.json": documents.read_motion,
    "front.json": gp.ParetoFront.load,
    "problems.json": gp.load_problems,
    "problems.yaml": gp.load_problems,
    "scene.yaml": gp.load_scene,
    "scene.xml": lambda file: gp.Scene.from_mjcf(file, robot="arm/", tool="tool"),
    "arm.urdf": lambda file: gp.Scene.from_urdf(file, tool="hand", acceleration=1.0),
    "arm.srdf": read_srdf,
    "severity.yaml": gp.SeverityTable.load,
    "prior.yaml": gp.FaultPrior.load,
    "annotations.yaml": Annotations.load,
    "suite.yaml": load_suite,
    "known.yaml": read_known,
    "drops.npz": DropNetwork.read,
    "policy.npz": Mlp.load,
    "failures.npz": read_failures,
    "floor.scen": read_scenarios,
    "floor.map": gp.OccupancyGrid.from_moving_ai,
    "floor.yaml": gp.OccupancyGrid.from_map_server,
    "sweep.json": Sweep.from_json,
}
_KINDS = ("pipe", "link to a pipe", "device", "folder")
_MADE: dict[str, str] = {"pipe": "a named pipe", "link to a pipe": "a named pipe", "device": "a device"}


def _make(kind: str, file: Path) -> Path:
    if kind == "pipe":
        os.mkfifo(file)
    elif kind == "link to a pipe":
        os.mkfifo(file.with_name("pipe"))
        file.symlink_to("pipe")
    elif kind == "device":
        file.symlink_to("/dev/zero")
    else:
        file.mkdir()
    return file


def _patience(*_: object) -> None:
    raise AssertionError("a reader waits")


@pytest.fixture
def impatient() -> Iterator[None]:
    before = signal.signal(signal.SIGALRM, _patience)
    signal.alarm(20)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("kind", _KINDS)
@pytest.mark.parametrize("name", _READERS)
def test_every_reader_refuses_it_by_name(name: str, kind: str, tmp_path: Path) -> None:
    if kind == "folder" and name in ("problems.json", "problems.yaml", "known.yaml"):
        return  # these readers accept folders
    file = _make(kind, tmp_path / name)
    with pytest.raises((FormatError, SceneError), match=_MADE.get(kind, "Is a directory")) as caught:
        _READERS[name](file)
    assert str(file) in str(caught.value)


@pytest.mark.parametrize("kind", _KINDS[:3])
@pytest.mark.parametrize(
    "tag",
    [
        '<include file="part"/>',
        '<asset><model name="m" file="part"/></asset>',
        '<asset><mesh name="m" file="part"/></asset>',
        '<asset><texture name="t" type="2d" file="part"/></asset>',
        '<asset><texture name="t" type="cube" fileright="part"/></asset>',
        '<asset><hfield name="h" file="part" size="1 1 1 1"/></asset>',
    ],
)
def test_files_named_by_a_scene_are_refused_too(tag: str, kind: str, tmp_path: Path) -> None:
    _make(kind, tmp_path / "part")
    (tmp_path / "scene.xml").write_text(f"<mujoco>{tag}</mujoco>")
    with pytest.raises(SceneError):
        gp.Scene.from_mjcf(tmp_path / "scene.xml", robot="arm/", tool="tool")


@pytest.mark.parametrize("kind", _KINDS)
@pytest.mark.parametrize("name", ["part.stl", "part.obj", "part.dae"])
def test_meshes_of_a_robot_are_as_well(name: str, kind: str, tmp_path: Path) -> None:
    _make(kind, tmp_path / name)
    collision = f'<collision><geometry><mesh filename="{name}"/></geometry></collision>'
    (tmp_path / "arm.urdf").write_text(f'<robot name="arm"><link name="hand">{collision}</link></robot>')
    with pytest.raises(SceneError, match=name):
        gp.Scene.from_urdf(tmp_path / "arm.urdf", tool="hand", acceleration=1.0)


@pytest.mark.parametrize("kind", _KINDS)
@pytest.mark.parametrize("name", ["floor.pgm", "floor.png"])
def test_the_picture_of_a_map_is_as_well(name: str, kind: str, tmp_path: Path) -> None:
    _make(kind, tmp_path / name)
    text = f"image: {name}\nresolution: 1\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: .6\nfree_thresh: .2\n"
    (tmp_path / "floor.yaml").write_text(text)
    with pytest.raises(FormatError, match=name):
        gp.OccupancyGrid.from_map_server(tmp_path / "floor.yaml")


@pytest.mark.parametrize("kind", _KINDS)
def test_files_in_folders_are_refused_too(kind: str, tmp_path: Path) -> None:
    for name in ("manifest.json", "journal.sqlite", "journal.jsonl", "t.json", "scene0001.yaml", "request0001.yaml"):
        folder = tmp_path / name.replace(".", "_")
        folder.mkdir()
        _make(kind, folder / name)
    motion = gp.Trajectory(np.arange(2.0), np.zeros((2, 1)), np.zeros((2, 1)), np.zeros((2, 1)), ("a",))
    some = SweepMotion(name="a", scene="tabletop", task="right_to_left", trajectory=motion)
    sweep = Sweep(motions=(some,), faults=({"fault": "gripper_failure"},), rollouts=2)
    for read in (
        lambda: failbench.read_dataset(tmp_path / "manifest_json"),
        lambda: read_sweep(tmp_path / "journal_sqlite"),
        lambda: generate_dataset(sweep, tmp_path / "journal_sqlite"),
        lambda: load_comparison(tmp_path / "journal_jsonl"),
        lambda: compare("quick", planners=["prm"], out=tmp_path / "journal_jsonl"),
        lambda: BestMotions.in_folder(tmp_path / "t_json"),
        lambda: gp.load_problems(tmp_path / "request0001_yaml"),
    ):
        with pytest.raises(FormatError):
            read()


@pytest.mark.parametrize("kind", _KINDS)
def test_the_cache_does_without(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(disk_cache, "folder", lambda: tmp_path)
    _make(kind, tmp_path / "0.npz")
    assert disk_cache.read("0") is None


@pytest.mark.parametrize("kind", ["pipe", "folder"])
@pytest.mark.parametrize(
    "argv",
    [
        ("evaluate", "FILE.json"),
        ("explain", "FILE.csv"),
        ("view", "FILE.json"),
        ("plan", "--scene", "FILE.yaml"),
        ("bench", "--suite", "FILE.yaml"),
        ("bench", "--known", "FILE.yaml"),
    ],
)
def test_the_command_line_refuses_them(argv: tuple[str, ...], kind: str, tmp_path: Path, capsys, monkeypatch) -> None:
    if kind == "folder" and argv[0] in ("bench", "view"):
        return  # these commands accept folders
    monkeypatch.chdir(tmp_path)
    file = _make(kind, tmp_path / argv[-1])
    assert main(argv) == 2
    said = capsys.readouterr().err
    assert file.name in said and said.count("\n") == 1 and _MADE.get(kind, "Is a directory") in said


@pytest.mark.parametrize("kind", ["pipe", "folder"])
def test_failbench_refuses_them(kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = _make(kind, tmp_path / "x.json")
    for argv in (
        ("run", "tabletop/lift_to_goal/gripper_failure/severe", "--trajectory", str(file)),
        ("validate-front", str(file)),
    ):
        assert failbench_main(argv) == 2
        said = capsys.readouterr().err
        assert str(file) in said and said.count("\n") == 1


def test_a_file_is_read_as_it_is_and_no_further_than_allowed(tmp_path: Path) -> None:
    file = tmp_path / "a"
    check_regular(file)  # a missing file may still be written
    file.write_bytes(bytes(range(256)))
    check_regular(file)
    assert read_content(file) == read_content(str(file), 256) == bytes(range(256))
    with open_regular(file) as stream:
        assert stream.read(3) == b"\0\1\2"
    with pytest.raises(OSError, match=r"256.*255"):
        read_content(file, 255)
