import multiprocessing
import os
import signal
import subprocess
import sys
import threading
from collections import deque
from functools import partial
from types import SimpleNamespace

import fake_work
import pytest
from fake_work import Fake, Stillborn
from places import SUPPORT
from processes import all_end, children_of

from failbench.basics.chunks import attempt
from failbench.basics.errors import WorkerError
from failbench.sweeps import ray_executor
from failbench.sweeps.executors import MAX_KILLS, LocalExecutor
from graceful_plan.exceptions import SettingError

CHUNKS = fake_work.chunks(6)


def run(work, workers=2, chunks=CHUNKS):
    outcomes = list(LocalExecutor(workers=workers).map(work, chunks))
    assert sorted(o.chunk.index for o in outcomes) == [c.index for c in chunks], "each exactly once"
    assert not multiprocessing.active_children()
    return {o.chunk.index: o for o in outcomes}


@pytest.mark.parametrize("workers", [1, 3])
def test_every_chunk_is_done_once_for_any_number_of_workers(workers):
    outcomes = run(Fake(), workers)
    assert {i: o.rows for i, o in outcomes.items()} == {c.index: fake_work.rows(c) for c in CHUNKS}


def test_nothing_to_do():
    assert list(LocalExecutor().map(Fake(), [])) == []


def test_an_exception_is_an_outcome_with_the_name_of_the_chunk():
    outcomes = run(Fake(raising=3))
    assert outcomes[3].rows is None
    assert outcomes[3].error == "motion / fault 3 / 0-2: ArithmeticError: no such luck"
    assert all(o.rows and not o.error for i, o in outcomes.items() if i != 3)


def test_attempt_lets_an_interrupt_through():
    def interrupted(chunk):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        attempt(interrupted, CHUNKS[0])


def test_a_killed_worker_is_replaced_and_its_chunk_done_again(tmp_path):
    outcomes = run(Fake(deadly=2, deadly_times=MAX_KILLS - 1, notes=tmp_path))
    assert all(o.rows == fake_work.rows(o.chunk) for o in outcomes.values())
    assert len(list(tmp_path.iterdir())) == MAX_KILLS - 1


@pytest.mark.long
@pytest.mark.parametrize(("exits", "how"), [(False, "SIGKILL"), (True, "exit code 7")])
def test_only_the_chunk_that_kills_its_workers_fails(tmp_path, exits, how):
    outcomes = run(Fake(deadly=0, deadly_times=99, notes=tmp_path, exits=exits))
    error = outcomes[0].error
    assert error.startswith("motion / fault 0 / 0-2: ") and f" {MAX_KILLS} times" in error and how in error
    assert len(list(tmp_path.iterdir())) == MAX_KILLS
    assert all(o.rows for i, o in outcomes.items() if i != 0)


@pytest.mark.long
def test_workers_that_cannot_begin_are_an_error_not_a_loop(capfd):
    with pytest.raises(WorkerError, match="exit code 9"):
        run(Stillborn())
    assert not multiprocessing.active_children()


def test_idle_and_starting_workers_may_be_killed_too():
    stop = threading.Event()

    def killer():
        while not stop.wait(0.15):
            for child in multiprocessing.active_children()[:1]:
                os.kill(child.pid, signal.SIGKILL)
                return

    thread = threading.Thread(target=killer)
    thread.start()
    try:
        outcomes = run(Fake(seconds=0.05))
    finally:
        stop.set()
        thread.join()
    assert all(o.rows for o in outcomes.values())


def test_closing_the_iterator_stops_the_workers():
    outcomes = LocalExecutor(workers=2).map(Fake(seconds=0.2), CHUNKS)
    next(outcomes)
    assert multiprocessing.active_children()
    outcomes.close()
    assert not multiprocessing.active_children()


@pytest.mark.parametrize("workers", [-1, True])
def test_workers_out_of_range(workers):
    with pytest.raises(SettingError, match="workers"):
        LocalExecutor(workers=workers)


@pytest.mark.parametrize("deadly", [signal.SIGKILL, signal.SIGINT])
def test_workers_end_with_their_driver_and_stay_silent(deadly):
    code = """
import fake_work
from failbench.sweeps.executors import LocalExecutor
if __name__ == "__main__":
    for outcome in LocalExecutor(workers=2).map(fake_work.Fake(seconds=0.1), fake_work.chunks(500)):
        print(outcome.chunk.index, flush=True)
"""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(SUPPORT), *sys.path])}
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment, text=True,
        start_new_session=True,
    ) as driver:  # fmt: skip
        assert driver.stdout is not None
        driver.stdout.readline()
        workers = children_of(driver.pid)
        assert len(workers) >= 2
        # Ctrl-C signals the process group; a kill only the driver.
        (os.killpg if deadly == signal.SIGINT else os.kill)(driver.pid, deadly)
        _, err = driver.communicate(timeout=20)
    assert all_end(workers)
    assert err.count("Traceback") == (deadly == signal.SIGINT), "only the driver says something"


class Promise:
    def __init__(self, do):
        self.do = do


class Lossy:
    """A stub of Ray that loses every task some number of times before finishing it."""

    class exceptions:
        WorkerCrashedError, OutOfMemoryError, NodeDiedError, LocalRayletDiedError, ObjectLostError, RayTaskError = (
            type(name, (Exception,), {})
            for name in (*ray_executor._WORKER_LOST, *ray_executor._NODE_LOST, "RayTaskError")
        )

    def __init__(self, error, times):
        self.error, self.left = getattr(self.exceptions, error), times

    def remote(self, **_):
        return lambda function: SimpleNamespace(remote=lambda *args: Promise(partial(function, *args)))

    def put(self, work):
        return work

    def cluster_resources(self):
        return {"CPU": 1.0}

    def get(self, task):
        self.left -= 1
        if self.left >= 0:
            raise self.error
        return task.do()


@pytest.mark.parametrize(
    ("error", "times", "fine"),
    [
        ("WorkerCrashedError", MAX_KILLS - 1, True),
        ("WorkerCrashedError", MAX_KILLS, False),
        ("NodeDiedError", ray_executor.MAX_NODES - 1, True),
        ("NodeDiedError", ray_executor.MAX_NODES, False),
    ],
)
def test_nodes_that_die_are_no_fault_of_the_chunk(error, times, fine):
    tasks = ray_executor._Tasks(Lossy(error, times), Fake(), deque(CHUNKS[:1]))
    outcomes = []
    while tasks.todo or tasks.running:
        tasks.hand_out()
        outcomes += filter(None, [tasks.hear(next(iter(tasks.running)))])
    (outcome,) = outcomes
    assert outcome.rows == (fake_work.rows(CHUNKS[0]) if fine else None)
    assert fine or (f" {times} times" in outcome.error and error in outcome.error)
