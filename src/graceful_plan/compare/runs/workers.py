"""Worker processes that survive what is done in them: an exception, the end of the process, or no end at all.

Every worker does one job at a time. One that dies is replaced, and what it was doing becomes an outcome, as does what
takes far longer than it may; so a planner in native code can neither end a comparison nor hold it up.
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
"""A run is given up after so many times its limit plus so many seconds: compiling may take a while."""

_BEGUN, _DONE, _RAISED = "begun", "done", "raised"
"""What a worker says: that it is a job's turn, and how that ended."""

J = TypeVar("J")
R = TypeVar("R")


@final
class WorkerLostError(GracefulPlanError, RuntimeError):
    """A worker that died, or did not end, over a job whose loss is no outcome."""

    def __init__(self, job: object, status: str, detail: str) -> None:
        self.job, self.status, self.detail = job, status, detail
        super().__init__(f"{status}: {detail}, over {job}")


def _refuse(job: object, status: str, detail: str) -> Any:
    raise WorkerLostError(job, status, detail)


def _nothing(job: object) -> None:
    """Prepare nothing."""


@final
@dataclass(frozen=True, kw_only=True)
class Work(Generic[J, R]):
    """What is done with jobs in workers; its functions are found by name in another process.

    Args:
        do: Does a job. What it raises is raised where results are awaited.
        prepare: Is called before, without a deadline.
        allowed: Seconds that `do` may take.
        lost: Makes a result of a job whose worker died (CRASHED) or did not end (HUNG); raises by default.
    """

    do: Callable[[J], R]
    prepare: Callable[[J], None] = _nothing
    allowed: Callable[[J], float] = lambda job: math.inf
    lost: Callable[[J, str, str], R] = _refuse


def done(jobs: Sequence[PlannerJob], processes: int, patience: float = PATIENCE) -> Iterator[Run]:
    """Do runs of planners and yield what came of them as they end.

    Args:
        jobs: What to do, in this order.
        processes: Workers; 0 does everything in this very process, with no protection from crashes.
        patience: Seconds that a run may take beyond `TIMES` its limit.
    """
    work = Work(do=run, prepare=load, allowed=lambda job: TIMES * job.seconds + patience, lost=_lost)
    return spread(work, jobs, processes)


def _lost(job: PlannerJob, status: str, detail: str) -> Run:
    limit = f" of {job.seconds:g} s" if status == HUNG else ""
    return job.outcome(status, detail + limit)


def spread(work: Work[J, R], jobs: Sequence[J], processes: int) -> Iterator[R]:
    """Do jobs and yield results as they come.

    Args:
        work: What to do with them.
        jobs: In this order.
        processes: Workers; 0 does everything in this very process.
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
    """A process and the pipe to it."""

    def __init__(self, work: Work[J, R]) -> None:
        # Spawned, not forked: libraries below have threads.
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
        # Starting up and loading the problem are not the planner's doing: until then there is no deadline.
        self.job, self.deadline = job, math.inf
        with suppress(OSError):  # It is dead, which `results` will notice.
            self.pipe.send(job)

    def results(self) -> list[R]:
        """Return what came of the job, nothing if it is not done yet; raise what it raised."""
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
            if self.job is None:  # The job raised it, not the pipe.
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
    """As many workers as wanted, always."""

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
        """Wait until something ends, or for a second; yield what ended and replace the dead."""
        busy = [worker for worker in self.all if worker.job is not None]
        wait([worker.pipe for worker in busy], timeout=1.0)
        for worker in busy:
            found = worker.results()
            if worker.lost:
                worker.stop()
                self.all[self.all.index(worker)] = _Helper(self.work)
            yield from found


def _serve(pipe: Connection, do: Callable[[Any], Any], prepare: Callable[[Any], None]) -> None:
    """Do jobs until the other end of the pipe is gone."""
    # Ctrl-C reaches the whole group of processes; the parent decides what it means.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Standard output may be one JSON document; what planners print is no part of it.
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
