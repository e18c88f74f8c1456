"""Validation by FailBench: of files in a subprocess, of jobs in this process, because their scenes are in no file.

This library does not depend on FailBench, which is imported only if it is asked for.
"""

from __future__ import annotations

import importlib
import importlib.util
import json
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import graceful_plan as gp
from graceful_plan.exceptions import GracefulPlanError, SettingError
from graceful_plan.job.job_result import JobResult


class ValidationError(GracefulPlanError, RuntimeError):
    """A failed validation."""


class Validation(NamedTuple):
    """Result of FailBench: its document or its text, as requested."""

    document: Mapping[str, Any]
    text: str


def check_failures(failures: int) -> None:
    """Check the number of failures to simulate.

    Raises:
        SettingError: If it is negative.
        ValidationError: If it is not 0 and FailBench is not installed.
    """
    if failures < 0:
        raise SettingError("validate", failures, "a number of failures, at least 0")
    if failures and importlib.util.find_spec("failbench") is None:
        raise ValidationError("FailBench is not installed: there is nothing to validate with")


def validate_motion(
    trajectory: gp.Trajectory, scene: str, task: str, failures: int, *, grasp: str, seed: int, as_json: bool
) -> Validation:
    """Simulate failures along a motion of a task.

    Args:
        trajectory: The motion.
        scene: Bundled scene or scene file.
        task: Task of the scene.
        failures: Number of failures.
        grasp: "fingers" or "weld", as in `failbench.SimSettings`.
        seed: Seed of all random numbers.
        as_json: Whether to return the document instead of the text.

    Raises:
        ValidationError: If FailBench fails; with its output.
    """
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "trajectory.json"
        trajectory.to_json(file)
        argv = ["validate", "--trajectory", str(file), "--scene", scene, "--task", task, "--grasp", grasp]
        said = _failbench([*argv, "-n", str(failures), "--seed", str(seed), *(["--json"] if as_json else [])])
    return Validation(json.loads(said), "") if as_json else Validation({}, said.rstrip())


def validate_front(front: Path, scene: str, task: str, failures: int, *, grasp: str) -> Mapping[str, Any]:
    """Simulate failures along every motion of a front in a file and return FailBench's document.

    Raises:
        ValidationError: If FailBench fails; with its output.
    """
    argv = ["validate-front", str(front), "--scene", scene, "--task", task, "--grasp", grasp]
    return json.loads(_failbench([*argv, "-n", str(failures), "--json"]))


def validate_job(result: JobResult, failures: int, *, seed: int) -> Validation:
    """Simulate failures of the gripper at any moment of a job, and return the harm per executed job.

    Raises:
        GracefulPlanError: If the healthy robot cannot execute a motion.
    """
    report = importlib.import_module("failbench").validate_job(result, n=failures, seed=seed)
    return Validation(report.to_document(), str(report))


def _failbench(argv: list[str]) -> str:
    command = [sys.executable, "-m", "failbench.cli", *argv]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise ValidationError((done.stderr or done.stdout).strip() or f"FailBench ended with {done.returncode}")
    return done.stdout
