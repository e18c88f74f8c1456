"""Motions that are too long to check cost bounded memory and time, each in a separate process."""

from __future__ import annotations

import resource
import subprocess
import sys

import pytest

_BOUNDS = "import resource; resource.setrlimit(resource.RLIMIT_CPU, ({seconds}, {seconds}))\n"
_QUESTION = """
import numpy as np
import graceful_plan as gp

task = gp.load_scene("tabletop").tasks["right_to_left"]
scene, start = task.scene, np.asarray(task.start)
t = np.linspace(0.0, {duration}, {rows})
wave = np.sin(t[:, None] * np.ones(len(start)))
turn = np.cos(t[:, None] * np.ones(len(start)))
motion = gp.Trajectory(t, start + {far} * wave, {far} * turn, -{far} * wave, scene.joints)
verdict = gp.verify(motion, scene)
assert not verdict.passed and "not checked" in verdict.checks["collision"].detail, verdict
for ask in (gp.evaluate, gp.explain):
    for given in (motion, gp.Path(motion.q)):
        try:
            ask(given, scene)
        except gp.GracefulPlanError as error:
            assert "states of the path" in str(error), error
        else:
            raise AssertionError(ask)
print("bounded")
"""
GIGABYTE = 2**30


@pytest.mark.long
@pytest.mark.parametrize(
    ("rows", "far"), [(1_000_000, 0.2), (1_000_000, 1e7), (3, 1e7), (3, 1e300)], ids=["rows", "both", "far", "farthest"]
)
def test_a_million_rows_and_ten_million_turns(rows: int, far: float) -> None:
    code = _BOUNDS.format(seconds=60) + _QUESTION.format(rows=rows, far=far, duration=1000.0)
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=600, check=False)
    assert run.returncode == 0 and run.stdout == "bounded\n", run.stderr[-2000:]
    most = 1024 * resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss  # of the largest child so far
    assert most < 3 * GIGABYTE
