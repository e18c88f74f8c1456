"""Worker processes that survive what planners do: an exception, the end of the process, or no end at all.

Every worker does one job at a time. One that dies is replaced, and what it was doing becomes an outcome, as does what
takes far longer than its time limit; so a planner in native code can neither end a comparison nor hold it up.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import signal
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from types import TracebackType

from graceful_plan.compare.runs.records import CRASHED, HUNG, Run
from graceful_plan.compare.runs.runner import Job, load, run

TIMES, PATIENCE = 10.0, 60.0
"""A run is given up after so many times its limit plus so many seconds: compiling may take a while."""

_BEGUN = "begun"
"""What a worker says once it is a planner's turn."""


def done(jobs: Sequence[Job], processes: int, patience: float = PATIENCE) -> Iterator[Run]:
    """Do jobs and yield what came of them as they end.

    Args:
        jobs: What to do, in this order.
        processes: Workers; 0 does everything in this very process, with no protection from crashes.
        patience: Seconds that a run may take beyond `TIMES` its limit.
    """
    if not jobs:
        return
    if processes == 0:
        yield from map(run, jobs)
        return
    waiting = deque(jobs)
    with _Workers(min(processes, len(jobs))) as workers:
        while waiting or workers.busy:
            for worker in workers.idle():
                if waiting:
                    worker.give(waiting.popleft(), patience)
            yield from workers.results()


class _Worker:
    """A process and the pipe to it."""

    def __init__(self) -> None:
        # Spawned, not forked: libraries below have threads.
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_work, args=(theirs,), daemon=True)
        self.process.start()
        theirs.close()
        self.job: Job | None = None
        self.allowed, self.deadline = 0.0, math.inf

    def give(self, job: Job, patience: float) -> None:
        self.job = job
        # Starting up and loading the problem are not the planner's doing: until then there is no deadline.
        self.allowed, self.deadline = TIMES * job.seconds + patience, math.inf
        with suppress(OSError):  # It is dead, which `result` will notice.
            self.pipe.send(job)

    def result(self) -> Run | None:
        """Return what came of the job, None if it is not done yet."""
        assert self.job is not None
        job = self.job
        try:
            while self.pipe.poll():
                found = self.pipe.recv()
                if found != _BEGUN:
                    self.job = None
                    return found
                self.deadline = time.monotonic() + self.allowed
        except (EOFError, OSError):
            self.process.join(5.0)
            return job.outcome(CRASHED, f"the process ended with {_ending(self.process.exitcode)}")
        if time.monotonic() > self.deadline:
            limit = f"{job.seconds:g} s"
            return job.outcome(HUNG, f"was still running long after its time limit of {limit}")
        return None

    def stop(self) -> None:
        self.pipe.close()
        if self.process.is_alive():
            self.process.kill()
        self.process.join()
        self.process.close()


class _Workers:
    """As many workers as wanted, always."""

    def __init__(self, count: int) -> None:
        self.all = [_Worker() for _ in range(count)]

    def __enter__(self) -> _Workers:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        for worker in self.all:
            worker.stop()

    @property
    def busy(self) -> bool:
        return any(worker.job is not None for worker in self.all)

    def idle(self) -> list[_Worker]:
        return [worker for worker in self.all if worker.job is None]

    def results(self) -> Iterator[Run]:
        """Wait until something ends, or for a second; yield what ended and replace the dead."""
        busy = [worker for worker in self.all if worker.job is not None]
        wait([worker.pipe for worker in busy], timeout=1.0)
        for worker in busy:
            found = worker.result()
            if found is None:
                continue
            if found.status in (CRASHED, HUNG) and worker.job is not None:
                worker.stop()
                self.all[self.all.index(worker)] = _Worker()
            yield found


def _work(pipe: Connection) -> None:
    """Do jobs until the other end of the pipe is gone."""
    # Ctrl-C reaches the whole group of processes; the parent decides what it means.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Standard output may be one JSON document; what planners print is no part of it.
    os.dup2(2, 1)
    with suppress(EOFError, OSError):
        while True:
            job = pipe.recv()
            load(job.problem)
            pipe.send(_BEGUN)
            pipe.send(run(job))


def _ending(code: int | None) -> str:
    if code is not None and code < 0:
        with suppress(ValueError):
            return signal.Signals(-code).name
    return f"exit code {code}"
