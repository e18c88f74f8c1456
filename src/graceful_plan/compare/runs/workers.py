"""Worker processes that tolerate exceptions, crashes and jobs that do not end.

Every worker executes one job at a time. A crashed worker is replaced and its job gets an outcome, and so does a job far
beyond its time limit. A planner in native code can therefore neither end a comparison nor block it.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import signal
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from types import TracebackType
from typing import Any, Generic, TypeVar, final

from graceful_plan.compare.runs.records import CRASHED, HUNG, Run
from graceful_plan.compare.runs.runner import PlannerJob, load, run
from graceful_plan.exceptions import GracefulPlanError

TIMES, PATIENCE = 10.0, 60.0
"""Factor of the time limit, and additional seconds, after which a run is abandoned; compiling may take long."""

_BEGUN, _DONE, _RAISED = "begun", "done", "raised"
"""Messages of a worker: the job has started, and its outcome."""

J = TypeVar("J")
R = TypeVar("R")


@final
class WorkerLostError(GracefulPlanError, RuntimeError):
    """A worker crashed or did not end, and the job has no outcome for that."""

    def __init__(self, job: object, status: str, detail: str) -> None:
        self.job, self.status, self.detail = job, status, detail
        super().__init__(f"{status}: {detail}, over {job}")


def _refuse(job: object, status: str, detail: str) -> Any:
    raise WorkerLostError(job, status, detail)


def _nothing(job: object) -> None:
    """Do nothing."""


@final
@dataclass(frozen=True, kw_only=True)
class Work(Generic[J, R]):
    """Functions for jobs in workers; other processes import them by name.

    Args:
        do: Executes a job. Its exceptions are raised in the process that awaits the results.
        prepare: Called before `do`, without a deadline.
        allowed: Time limit of `do` [s].
        lost: Returns the result of a job whose worker crashed (CRASHED) or did not end (HUNG); raises by default.
    """

    do: Callable[[J], R]
    prepare: Callable[[J], None] = _nothing
    allowed: Callable[[J], float] = lambda job: math.inf
    lost: Callable[[J, str, str], R] = _refuse


def done(jobs: Sequence[PlannerJob], processes: int, patience: float = PATIENCE) -> Iterator[Run]:
    """Execute runs of planners and yield their records as they end.

    Args:
        jobs: Runs, in this order.
        processes: Number of workers; 0 uses this process, without protection from crashes.
        patience: Time that a run may take beyond `TIMES` its limit [s].
    """
    work = Work(do=run, prepare=load, allowed=lambda job: TIMES * job.seconds + patience, lost=_lost)
    return spread(work, jobs, processes)


def _lost(job: PlannerJob, status: str, detail: str) -> Run:
    limit = f" of {job.seconds:g} s" if status == HUNG else ""
    return job.outcome(status, detail + limit)


def spread(work: Work[J, R], jobs: Sequence[J], processes: int) -> Iterator[R]:
    """Execute jobs and yield results as they arrive.

    Args:
        work: Functions for the jobs.
        jobs: Jobs, in this order.
        processes: Number of workers; 0 uses this process.
    """
    if not jobs:
        return
    if processes == 0:
        yield from map(work.do, jobs)
        return
    waiting = deque(jobs)
    with _Helpers(work, min(processes, len(jobs))) as workers:
        while waiting or workers.busy:
            for worker in workers.idle():
                if waiting:
                    worker.give(waiting.popleft())
            yield from workers.results()


class _Helper(Generic[J, R]):
    """A worker process and its pipe."""

    def __init__(self, work: Work[J, R]) -> None:
        # Spawn instead of fork, because native libraries have threads.
        context = multiprocessing.get_context("spawn")
        self.work = work
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, work.do, work.prepare), daemon=True)
        self.process.start()
        theirs.close()
        self.job: J | None = None
        self.lost = False
        self.deadline = math.inf

    def give(self, job: J) -> None:
        # The deadline starts only after start-up and loading, which are not the planner's time.
        self.job, self.deadline = job, math.inf
        with suppress(OSError):  # The process is dead; `results` reports it.
            self.pipe.send(job)

    def results(self) -> list[R]:
        """Return the result of the job, empty if it is not finished; raise its exception."""
        assert self.job is not None
        job = self.job
        try:
            while self.pipe.poll():
                what, answer = self.pipe.recv()
                if what == _BEGUN:
                    self.deadline = time.monotonic() + self.work.allowed(job)
                    continue
                self.job = None
                if what == _RAISED:
                    raise answer
                return [answer]
        except (EOFError, OSError):
            if self.job is None:  # Raised by the job, not by the pipe.
                raise
            self.lost = True
            self.process.join(5.0)
            ending = _ending(self.process.exitcode)
            return [self.work.lost(job, CRASHED, f"the process ended with {ending}")]
        if time.monotonic() > self.deadline:
            self.lost = True
            return [self.work.lost(job, HUNG, "was still running long after its time limit")]
        return []

    def stop(self) -> None:
        self.pipe.close()
        if self.process.is_alive():
            self.process.kill()
        self.process.join()
        self.process.close()


class _Helpers(Generic[J, R]):
    """A constant number of workers."""

    def __init__(self, work: Work[J, R], count: int) -> None:
        self.work = work
        self.all = [_Helper(work) for _ in range(count)]

    def __enter__(self) -> _Helpers[J, R]:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        for worker in self.all:
            worker.stop()

    @property
    def busy(self) -> bool:
        return any(worker.job is not None for worker in self.all)

    def idle(self) -> list[_Helper[J, R]]:
        return [worker for worker in self.all if worker.job is None]

    def results(self) -> Iterator[R]:
        """Wait up to a second for results; yield them and replace dead workers."""
        busy = [worker for worker in self.all if worker.job is not None]
        wait([worker.pipe for worker in busy], timeout=1.0)
        for worker in busy:
            found = worker.results()
            if worker.lost:
                worker.stop()
                self.all[self.all.index(worker)] = _Helper(self.work)
            yield from found


def _serve(pipe: Connection, do: Callable[[Any], Any], prepare: Callable[[Any], None]) -> None:
    """Execute jobs until the other end of the pipe closes."""
    # Ctrl-C reaches all processes of the group; only the parent handles it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Standard output may be one JSON document; keep planners' output out of it.
    os.dup2(2, 1)
    with suppress(EOFError, OSError):
        while True:
            job = pipe.recv()
            try:
                prepare(job)
                pipe.send((_BEGUN, None))
                answer = (_DONE, do(job))
            except Exception as error:
                answer = (_RAISED, error)
            pipe.send(answer)


def _ending(code: int | None) -> str:
    if code is not None and code < 0:
        with suppress(ValueError):
            return signal.Signals(-code).name
    return f"exit code {code}"
