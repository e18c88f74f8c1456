"""The command `job`: output, files and exit codes."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from order_jobs import JOBS

import graceful_plan as gp
from graceful_plan.tools import cli

GOALS = "version: 1\nscene: order.yaml\ngoals:\n  crate: {at: %s}\n"
QUICK = ("--iterations", "4", "--grasps", "1")


def written(folder: Path, at: str) -> Path:
    for name in ("order.xml", "order.yaml"):
        shutil.copy(JOBS / name, folder / name)
    file = folder / "task.yaml"
    file.write_text(GOALS % at)
    return file


@pytest.mark.long
def test_a_job_is_planned_validated_and_exported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, folder = written(tmp_path, "[0.5, 0.3, 0.4]"), tmp_path / "out"
    words = ["job", str(file), *QUICK, "--validate", "8", "--export", str(folder), "--json"]
    words += ["--output", str(tmp_path / "job.html")]
    assert cli.main(words) == cli.DONE
    document = json.loads(capsys.readouterr().out)
    assert document["status"] == "SOLVED" and [step["kind"] for step in document["steps"]] == ["pick", "place"]
    assert len(document["validation"]["by_step"]) == 2 and document["validation"]["observed"]["mean"] >= 0.0
    assert json.loads((folder / "job.json").read_text()) == document
    page = (tmp_path / "job.html").read_text()
    assert all(f"{step['kind']} {step['object']}" in page for step in document["steps"]) and "observed" in page
    motions = [motion for step in document["steps"] for motion in step["motions"]]
    read = [gp.Trajectory.from_json(folder / motion["file"]) for motion in motions]
    assert [one.duration for one in read] == pytest.approx([motion["duration"] for motion in motions])


def test_an_impossible_job_fails_and_says_why(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = tmp_path / "job.html"
    words = ["job", str(written(tmp_path, "[1.5, 0.3, 0.4]")), *QUICK, "--output", str(page)]
    assert cli.main(words) == cli.FAILED
    said = capsys.readouterr().out
    assert "'crate'" in said and str(page) in said and "crate" in page.read_text()


def test_a_page_of_another_format_is_misuse(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = written(tmp_path, "[0.5, 0.3, 0.4]")
    assert cli.main(["job", str(file), "--output", str(tmp_path / "job.pdf")]) == cli.MISUSE
    assert ".html" in capsys.readouterr().err


def test_a_broken_file_is_misuse(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["job", str(written(tmp_path, "[0.3]"))]) == cli.MISUSE
    assert "task.yaml:4" in capsys.readouterr().err
