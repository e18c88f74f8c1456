"""Chunks of a sweep on a Ray cluster, or on a Ray of our own on this machine. Needs the extra `ray`.

Workers and nodes may die and others may join: what is lost is done again, and the journal takes each chunk once. The
driver, and the node that it runs on, may die, too: then `resume` goes on.
"""

from __future__ import annotations

import importlib
import os
from collections import Counter, deque
from collections.abc import Generator, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from failbench.basics.chunks import Chunk, ChunkOutcome, Work, attempt
from failbench.basics.errors import MissingExtra, WorkerError
from failbench.basics.versions import versions
from failbench.sweeps.executors import MAX_KILLS, checked_workers, died

_AHEAD = 2
"""Chunks handed out for each worker, so that none waits for the driver."""
_WORKER_LOST = ("WorkerCrashedError", "OutOfMemoryError")
_NODE_LOST = ("NodeDiedError", "LocalRayletDiedError", "ObjectLostError")
"""What Ray says if a worker or its node died, before a result was sent or after."""
MAX_NODES = 20
"""How many nodes may die under a chunk before it counts as failed: they die for other reasons than what it does."""


@dataclass(frozen=True, kw_only=True)
class RayExecutor:
    """Ray tasks. If Ray runs already, or an address is given, it is used as it is; else one is started and ended.

    Args:
        workers: How many processes a Ray of our own has; 0 is one for each core.
        address: Of a cluster to connect to, or "auto".
    """

    workers: int = 0
    address: str | None = None

    def __post_init__(self) -> None:
        checked_workers(self.workers)

    def map(self, work: Work, chunks: Iterable[Chunk]) -> Iterator[ChunkOutcome]:
        """Do every chunk once and yield how each ended, as they come.

        Raises:
            MissingExtra: If Ray is not installed.
            WorkerError: If a node has other versions than this one, or not what it takes.
        """
        ray = _ray()
        with _running(ray, self):
            tasks = _Tasks(ray, work, deque(chunks))
            try:
                while tasks.todo or tasks.running:
                    tasks.hand_out()
                    for done in ray.wait(list(tasks.running), num_returns=1)[0]:
                        outcome = tasks.hear(done)
                        if outcome is not None:
                            yield outcome
            finally:
                for left in tasks.running:
                    ray.cancel(left)


class _Tasks:
    """The tasks of one call of `map`, and what is known about deaths among their workers."""

    def __init__(self, ray: Any, work: Work, todo: deque[Chunk]) -> None:
        self.ray, self.todo = ray, todo
        self.running: dict[Any, Chunk] = {}
        self.kills: Counter[int] = Counter()
        self.nodes: Counter[int] = Counter()
        self._worker_lost, self._node_lost = (
            tuple(getattr(ray.exceptions, name) for name in names) for names in (_WORKER_LOST, _NODE_LOST)
        )
        # Who dies is counted here, so that a chunk that kills its workers is given up by name.
        self._task = ray.remote(num_cpus=1, max_retries=0)(_attempt)
        self._shared = ray.put(work)
        self._versions = versions()

    def hand_out(self) -> None:
        """Give the workers that there are now enough to do."""
        cpus = max(1, int(self.ray.cluster_resources().get("CPU", 1)))
        while self.todo and len(self.running) < _AHEAD * cpus:
            chunk = self.todo.popleft()
            self.running[self._task.remote(self._shared, chunk, self._versions)] = chunk

    def hear(self, done: Any) -> ChunkOutcome | None:
        """Take the result of a task; if it is lost, its chunk is done again, unless it is known for that."""
        chunk = self.running.pop(done)
        try:
            outcome = self.ray.get(done)
        except (*self._worker_lost, *self._node_lost) as error:
            of_node = isinstance(error, self._node_lost)
            deaths, most = (self.nodes, MAX_NODES) if of_node else (self.kills, MAX_KILLS)
            deaths[chunk.index] += 1
            if deaths[chunk.index] == most:
                return died(chunk, most, type(error).__name__)
            self.todo.appendleft(chunk)
            return None
        except self.ray.exceptions.RayTaskError as error:  # not of the chunk: the outcome has those
            raise WorkerError(f"one could not begin: {type(error.cause).__name__}: {error.cause}") from None
        if isinstance(outcome, str):
            raise WorkerError(outcome)
        return outcome


def _attempt(work: Work, chunk: Chunk, expected: Mapping[str, str]) -> ChunkOutcome | str:
    """Do a chunk in a task; or say how this node differs from the driver, whose rows would not be the same."""
    found = versions()
    differing = [f"{name} {found[name]}, not {expected[name]}" for name in found if found[name] != expected[name]]
    if differing:
        return f"a node has {'; '.join(differing)}"
    return attempt(work, chunk)


def _ray() -> Any:
    try:
        return importlib.import_module("ray")
    except ImportError:
        raise MissingExtra("ray", "ray") from None


@contextmanager
def _running(ray: Any, executor: RayExecutor) -> Generator[None]:
    """Have Ray run; end it afterwards if it is our own."""
    ours = not ray.is_initialized()
    if ours:
        # Ray reports its use to its makers unless told otherwise.
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        own = {"num_cpus": checked_workers(executor.workers), "include_dashboard": False}
        ray.init(address=executor.address, log_to_driver=False, **({} if executor.address else own))
    try:
        yield
    finally:
        if ours:
            ray.shutdown()
