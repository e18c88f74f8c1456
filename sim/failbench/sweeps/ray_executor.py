"""Executor on a Ray cluster, or on a local Ray instance. Needs the extra `ray`.

Workers and nodes may die and others may join: lost chunks are computed again, and the journal stores each chunk once.
If the driver or its node dies, `resume` continues the sweep.
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
from graceful_plan.path import plain_numbers

_AHEAD = 2
"""Chunks submitted per worker, so that none waits for the driver."""
_WORKER_LOST = ("WorkerCrashedError", "OutOfMemoryError")
_NODE_LOST = ("NodeDiedError", "LocalRayletDiedError", "ObjectLostError")
"""Ray's errors if a worker or its node died, before or after it sent a result."""
MAX_NODES = 20
"""Number of node deaths after which a chunk counts as failed; nodes mostly die for other reasons than the chunk."""


@dataclass(frozen=True, kw_only=True)
class RayExecutor:
    """Ray tasks. Uses a running Ray or the cluster at `address`; otherwise starts a local Ray and stops it at the end.

    Args:
        workers: Number of processes of a local Ray; 0 means one per core.
        address: Address of a cluster, or "auto".
    """

    workers: int = 0
    address: str | None = None

    def __post_init__(self) -> None:
        plain_numbers(self)
        checked_workers(self.workers)

    def map(self, work: Work, chunks: Iterable[Chunk]) -> Iterator[ChunkOutcome]:
        """Compute every chunk once, and yield outcomes as they arrive.

        Raises:
            MissingExtra: If Ray is not installed.
            WorkerError: If a node has other package versions, or cannot run the work.
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
    """Tasks of one call of `map`, and counts of their workers' deaths."""

    def __init__(self, ray: Any, work: Work, todo: deque[Chunk]) -> None:
        self.ray, self.todo = ray, todo
        self.running: dict[Any, Chunk] = {}
        self.kills: Counter[int] = Counter()
        self.nodes: Counter[int] = Counter()
        self._worker_lost, self._node_lost = (
            tuple(getattr(ray.exceptions, name) for name in names) for names in (_WORKER_LOST, _NODE_LOST)
        )
        # Deaths are counted here, so that a chunk that kills its workers fails by name.
        self._task = ray.remote(num_cpus=1, max_retries=0)(_attempt)
        self._shared = ray.put(work)
        self._versions = versions()

    def hand_out(self) -> None:
        """Submit enough chunks for the current workers."""
        cpus = max(1, int(self.ray.cluster_resources().get("CPU", 1)))
        while self.todo and len(self.running) < _AHEAD * cpus:
            chunk = self.todo.popleft()
            self.running[self._task.remote(self._shared, chunk, self._versions)] = chunk

    def hear(self, done: Any) -> ChunkOutcome | None:
        """Return the result of a task; submit a lost chunk again, unless it was lost too often."""
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
        except self.ray.exceptions.RayTaskError as error:  # not raised by the chunk: its errors are in the outcome
            raise WorkerError(f"one could not begin: {type(error.cause).__name__}: {error.cause}") from None
        if isinstance(outcome, str):
            raise WorkerError(outcome)
        return outcome


def _attempt(work: Work, chunk: Chunk, expected: Mapping[str, str]) -> ChunkOutcome | str:
    """Compute a chunk in a task; return a text if this node's versions differ, since its rows could differ as well."""
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
    """Provide a running Ray; stop it afterwards if it was started here."""
    ours = not ray.is_initialized()
    if ours:
        # Disable Ray's usage reports unless the user has set otherwise.
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        own = {"num_cpus": checked_workers(executor.workers), "include_dashboard": False}
        ray.init(address=executor.address, log_to_driver=False, **({} if executor.address else own))
    try:
        yield
    finally:
        if ours:
            ray.shutdown()
