"""The control loop of the guide runs against a stub of a robot."""

import re
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from places import ROOT

import graceful_plan as gp

(LOOP,) = re.findall(r"^```py\n(.*?)^```", (ROOT / "docs" / "robot-loops.md").read_text(), flags=re.M | re.S)


@pytest.fixture
def arm(monkeypatch, tmp_path):
    """Return a stub of an arm at 0, and write a motion for it."""
    calls = []
    control = SimpleNamespace(
        initPeriod=lambda: len(calls),
        servoJ=lambda q, v, a, dt, lookahead, gain: calls.append((q, dt)),
        waitPeriod=lambda began: None,
        servoStop=lambda: calls.append("stop"),
        stopScript=lambda: None,
    )
    arm = SimpleNamespace(calls=calls, q=[0.0] * 6)
    interfaces = {
        "rtde_control": {"RTDEControlInterface": lambda ip, frequency: control},
        "rtde_receive": {"RTDEReceiveInterface": lambda ip: SimpleNamespace(getActualQ=lambda: arm.q)},
    }
    for name, members in interfaces.items():
        monkeypatch.setitem(sys.modules, name, SimpleNamespace(**members))
    monkeypatch.chdir(tmp_path)
    q = np.linspace(np.zeros(6), np.full(6, 0.1), 3)
    names = tuple(f"joint{i}" for i in range(6))
    gp.Trajectory(np.array([0.0, 0.1, 0.2]), q, 0 * q, 0 * q, names).to_json("motion.json")
    return arm


def test_every_sample_is_sent_and_the_arm_stops(arm):
    exec(compile(LOOP, "robot-loops.md", "exec"), {})
    *sent, last = arm.calls
    assert (len(sent), last) == (101, "stop")
    np.testing.assert_allclose(sent[-1][0], np.full(6, 0.1))


def test_nothing_is_sent_to_an_arm_elsewhere(arm):
    arm.q = [0.0, 0.02, 0.0, 0.0, 0.0, 0.0]
    with pytest.raises(SystemExit, match="begins"):
        exec(compile(LOOP, "robot-loops.md", "exec"), {})
    assert arm.calls == []
