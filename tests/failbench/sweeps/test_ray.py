"""Sweeps on Ray: a local instance, and a cluster of two nodes whose workers and nodes die."""

import contextlib
import os
import random
import signal
import sys
import threading
import time

import fake_work
import pytest
from places import SUPPORT

from failbench.basics.errors import WorkerError
from failbench.sweeps import ray_executor
from failbench.sweeps.ray_executor import RayExecutor

pytest.importorskip("ray")

from support.sweeps.ray_nodes import RayNodes

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def nodes():
    """A cluster of two nodes with one worker each."""
    with pytest.MonkeyPatch.context() as patch:
        # Ray's workers are separate processes; this lets them import the test modules.
        patch.setenv("PYTHONPATH", ":".join([str(SUPPORT), *sys.path]))
        with RayNodes(2) as running:
            yield running


def test_workers_and_nodes_may_die_while_they_work(nodes):
    chunks, stop, killed = fake_work.chunks(16), threading.Event(), []

    def killer():
        chosen = random.Random(0)
        for what in ("worker", "node", "worker"):
            while not (busy := nodes.busy()):
                if stop.wait(0.05):
                    return
            if what == "node":
                nodes.kill_node(chosen)
            else:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(busy[0], signal.SIGKILL)
            killed.append(what)
            if stop.wait(0.3):
                return

    thread = threading.Thread(target=killer)
    thread.start()
    try:
        outcomes = list(RayExecutor(address=nodes.address).map(fake_work.Fake(seconds=0.3), chunks))
    finally:
        stop.set()
        thread.join()
    assert killed == ["worker", "node", "worker"]
    assert sorted(outcome.chunk.index for outcome in outcomes) == list(range(16)), "each exactly once"
    assert all(outcome.rows == fake_work.rows(outcome.chunk) for outcome in outcomes)


def test_a_node_with_other_versions_is_an_error(nodes, monkeypatch):
    real = ray_executor.versions()
    monkeypatch.setattr(ray_executor, "versions", lambda: real | {"mujoco": "5.0"})
    with pytest.raises(WorkerError, match=rf"mujoco {real['mujoco']}.*5\.0"):
        list(RayExecutor(address=nodes.address).map(fake_work.Fake(), fake_work.chunks(2)))


def test_work_that_no_node_can_receive_is_an_error(nodes):
    with pytest.raises(WorkerError, match="one could not begin"):
        list(RayExecutor(address=nodes.address).map(Unreadable(), fake_work.chunks(1)))


def test_closing_the_iterator_stops_the_work(nodes):
    outcomes = RayExecutor(address=nodes.address).map(fake_work.Fake(seconds=0.2), fake_work.chunks(50))
    next(outcomes)
    outcomes.close()
    until = time.monotonic() + 30.0
    while nodes.busy() and time.monotonic() < until:
        time.sleep(0.05)
    assert nodes.busy() == []


class Unreadable:
    """Work whose unpickling fails."""

    def __reduce__(self):
        return int, ("no number",)

    def __call__(self, chunk):
        raise AssertionError
