"""Executors of chunks: a protocol, and a pool of local processes that survives the death of its workers."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
from collections import Counter, deque
from collections.abc import Generator, Iterable, Iterator
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from typing import Protocol, cast, runtime_checkable

from failbench.basics.chunks import Chunk, ChunkOutcome, Work, attempt
from failbench.basics.errors import WorkerError
from graceful_plan.exceptions import SettingError
from graceful_plan.path import is_whole, plain_numbers

MAX_KILLS = 3
"""Number of worker deaths after which a chunk counts as failed."""
_MAX_STILLBORN = 5
"""Number of consecutive workers that may die before their first chunk; then the pool gives up."""


@runtime_checkable
class Executor(Protocol):
    """Computes chunks somewhere, in any order."""

    def map(self, work: Work, chunks: Iterable[Chunk]) -> Iterator[ChunkOutcome]:
        """Compute every chunk once, and yield outcomes as they arrive; closing the iterator stops all work.

        Exceptions in a chunk, and chunks that repeatedly kill their worker, become outcomes with an error.
        """
        ...


def checked_workers(workers: int) -> int:
    """Return the number of workers; 0 means one per core."""
    if not is_whole(workers) or workers < 0:
        raise SettingError("workers", workers, "a whole number, at least 0 (0: one for each core)")
    return int(workers) or len(os.sched_getaffinity(0))


def died(chunk: Chunk, kills: int, how: str) -> ChunkOutcome:
    """Return the outcome of a chunk that killed too many workers."""
    return ChunkOutcome(chunk=chunk, error=f"{chunk.name}: its worker died {kills} times, the last time with {how}")


@dataclass(frozen=True, kw_only=True)
class LocalExecutor:
    """Processes on this machine. A dead worker is replaced, and its chunk is computed again.

    Args:
        workers: Number of processes; 0 means one per core.
    """

    workers: int = 0

    def __post_init__(self) -> None:
        plain_numbers(self)
        checked_workers(self.workers)

    def map(self, work: Work, chunks: Iterable[Chunk]) -> Iterator[ChunkOutcome]:
        """Compute every chunk once, and yield outcomes as they arrive.

        Raises:
            WorkerError: If several workers in a row die before they compute anything.
        """
        todo = deque(chunks)
        pool = _Pool(work, todo)
        try:
            pool.grow(min(checked_workers(self.workers), len(todo)))
            while todo or pool.busy:
                for worker in pool.those_with_news():
                    outcome = pool.hear(worker)
                    if outcome is not None:
                        yield outcome
        finally:
            pool.kill()


class _Pool:
    """Workers of one call of `map`, and counts of their deaths."""

    def __init__(self, work: Work, todo: deque[Chunk]) -> None:
        self.work, self.todo = work, todo
        self.workers: list[_LocalWorker] = []
        self.kills: Counter[int] = Counter()
        self.stillborn = 0

    @property
    def busy(self) -> bool:
        return any(worker.chunk is not None for worker in self.workers)

    def grow(self, count: int) -> None:
        self.workers += [_LocalWorker(self.work) for _ in range(count)]

    def kill(self) -> None:
        for worker in self.workers:
            worker.kill()
        self.workers.clear()

    def those_with_news(self) -> list[_LocalWorker]:
        """Wait until workers have sent a message or died, and return them."""
        loud = wait([worker.connection for worker in self.workers])
        return [worker for worker in self.workers if worker.connection in loud]

    def hear(self, worker: _LocalWorker) -> ChunkOutcome | None:
        """Receive a worker's outcome and give it the next chunk; replace the worker if it is dead."""
        try:
            outcome = worker.receive()
        except (EOFError, OSError):
            return self._bury(worker)
        self.stillborn = 0
        if self.todo:
            worker.give(self.todo.popleft())
        return outcome

    def _bury(self, worker: _LocalWorker) -> ChunkOutcome | None:
        """Replace a dead worker; its chunk is computed again, unless it has killed too many workers."""
        how = worker.kill()
        self.workers.remove(worker)
        self.stillborn += not worker.ready
        if self.stillborn == _MAX_STILLBORN:
            raise WorkerError(f"{_MAX_STILLBORN} in a row died before they could begin, the last one with {how}")
        self.grow(1)
        chunk = worker.chunk
        if chunk is None:
            return None
        self.kills[chunk.index] += 1
        if self.kills[chunk.index] == MAX_KILLS:
            return died(chunk, MAX_KILLS, how)
        self.todo.appendleft(chunk)
        return None


class _LocalWorker:
    """A process that computes chunks one after another, and the driver's end of its connection."""

    def __init__(self, work: Work) -> None:
        # Spawned, not forked: the driver may have threads, and MuJoCo and BLAS may hold locks in them.
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, work), daemon=True)
        with _interrupts_blocked():
            self.process.start()
        theirs.close()  # so that each side gets an end of file when the other dies
        self.ready = False
        self.chunk: Chunk | None = None

    def give(self, chunk: Chunk) -> None:
        self.chunk = chunk
        with contextlib.suppress(OSError):  # a dead worker's answer is an end of file
            self.connection.send(chunk)

    def receive(self) -> ChunkOutcome | None:
        """Return the worker's outcome; its first message is None when it is ready.

        Raises:
            EOFError, OSError: If the worker died, perhaps in the middle of a message.
        """
        outcome = cast(ChunkOutcome | None, self.connection.recv())
        self.ready, self.chunk = True, None
        return outcome

    def kill(self) -> str:
        """Kill the worker and describe how it ended."""
        self.connection.close()
        # A worker that is already dead keeps its exit code.
        self.process.kill()
        self.process.join()
        code = self.process.exitcode or 0
        self.process.close()
        return signal.Signals(-code).name if code < 0 else f"exit code {code}"


@contextlib.contextmanager
def _interrupts_blocked() -> Generator[None]:
    """Start processes that ignore Ctrl-C, which the terminal sends to the whole group; only the driver reacts to it."""
    resource_tracker.ensure_running()  # the first process starts it, and that unblocks interrupts
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _serve(connection: Connection, work: Work) -> None:
    """Compute received chunks until the driver closes the connection or dies."""
    with contextlib.suppress(EOFError, OSError):
        connection.send(None)
        while True:
            connection.send(attempt(work, connection.recv()))
