"""Readers refuse broken files with the library's errors: a short run of `make fuzz`."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest
from places import ROOT

import graceful_plan as gp

FUZZER = ROOT / ".ci" / "fuzz_readers.py"


@pytest.mark.long
@pytest.mark.skipif(importlib.util.find_spec("pyarrow") is None, reason="needs pyarrow")
def test_broken_files_are_refused_or_read() -> None:
    """Run it in a separate process, which would contain a crash."""
    command = [sys.executable, str(FUZZER), "--files", "700"]
    run = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert run.returncode == 0, run.stdout[-3000:] + run.stderr[-2000:]
    assert "700 files, 0 wrong" in run.stdout


@pytest.mark.parametrize("name", ["a\0b", "a\ud800b", "", "absent"])
@pytest.mark.parametrize(
    "read",
    [
        lambda name: gp.Trajectory.from_json(name + ".json"),
        lambda name: gp.Trajectory.from_csv(name + ".csv"),
        lambda name: gp.Trajectory.from_parquet(name + ".parquet"),
        lambda name: gp.Trajectory.from_ros(Path(name + ".yaml")),
        lambda name: gp.ParetoFront.load(name + ".json"),
        lambda name: gp.load_problems(name + ".json"),
        lambda name: gp.load_scene(name + ".yaml"),
        lambda name: gp.Scene.from_mjcf(name + ".xml", robot="arm/", tool="tool"),
        lambda name: gp.Scene.from_urdf(name + ".urdf", tool="hand", acceleration=1.0),
        lambda name: gp.SeverityTable.load(name + ".yaml"),
        lambda name: gp.FaultPrior.load(name + ".yaml"),
    ],
)
def test_files_that_are_not_there_or_cannot_be_are_named(read, name: str, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(gp.GracefulPlanError) as caught:
        read(name)
    assert name in str(caught.value)


def test_a_text_that_no_file_can_hold_is_refused() -> None:
    for text in ("<mujoco model='\ud800'/>", "<robot name='\ud800'/>"):
        with pytest.raises(gp.GracefulPlanError, match="not valid UTF-8"):
            gp.Scene.from_mjcf(text, robot="arm/", tool="tool") if "mujoco" in text else gp.Scene.from_urdf(
                text, tool="hand", acceleration=1.0
            )


@pytest.mark.parametrize("mesh", ["x" * 10_000, "%00.obj", "package://a/%00.obj", "absent.obj"])
def test_a_mesh_that_no_file_can_be_is_refused(mesh: str, tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    collision = f'<collision><geometry><mesh filename="{mesh}"/></geometry></collision>'
    file.write_text(f'<robot name="arm"><link name="hand">{collision}</link></robot>')
    with pytest.raises(gp.GracefulPlanError, match="was not found") as caught:
        gp.Scene.from_urdf(file, tool="hand", acceleration=1.0)
    assert len(str(caught.value)) < 1000
