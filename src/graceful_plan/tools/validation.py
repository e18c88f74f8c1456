"""FailBench, asked in a process of its own: this library does not import it."""

from __future__ import annotations

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


class ValidationError(GracefulPlanError, RuntimeError):
    """A validation that could not be done."""


class Validation(NamedTuple):
    """What FailBench found: its document if that was asked for, else its text."""

    document: Mapping[str, Any]
    text: str


def check_failures(failures: int) -> None:
    """Refuse a number of failures that cannot be, or failures without FailBench.

    Raises:
        SettingError: If it is negative.
        ValidationError: If it is not 0 and FailBench is not installed.
    """
    if failures < 0:
        raise SettingError("validate", failures, "a number of failures, at least 0")
    if failures and importlib.util.find_spec("failbench") is None:
        raise ValidationError("FailBench is not installed: there is nothing to validate with")


def validate_motion(
    trajectory: gp.Trajectory, scene: str, task: str, failures: int, *, seed: int, as_json: bool
) -> Validation:
    """Let the robot fail along a motion of a task.

    Args:
        trajectory: The motion.
        scene: Bundled scene or scene file.
        task: Task of the scene.
        failures: How often.
        seed: Of everything random.
        as_json: Whether its document is asked for, or its text.

    Raises:
        ValidationError: With what it said, if it failed.
    """
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "trajectory.json"
        trajectory.to_json(file)
        argv = ["validate", "--trajectory", str(file), "--scene", scene, "--task", task]
        said = _failbench([*argv, "-n", str(failures), "--seed", str(seed), *(["--json"] if as_json else [])])
    return Validation(json.loads(said), "") if as_json else Validation({}, said.rstrip())


def validate_front(front: Path, scene: str, task: str, failures: int) -> Mapping[str, Any]:
    """Let the robot fail along every motion of a front in a file; return FailBench's document.

    Raises:
        ValidationError: With what it said, if it failed.
    """
    argv = ["validate-front", str(front), "--scene", scene, "--task", task, "-n", str(failures), "--json"]
    return json.loads(_failbench(argv))


def _failbench(argv: list[str]) -> str:
    command = [sys.executable, "-m", "failbench.cli", *argv]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise ValidationError((done.stderr or done.stdout).strip() or f"FailBench ended with {done.returncode}")
    return done.stdout
