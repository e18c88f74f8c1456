"""Chunks of a sweep on a Ray cluster, or on a Ray of our own on this machine. Needs the extra `ray`."""

from __future__ import annotations

import importlib
import os
from collections import Counter, deque
from collections.abc import Generator, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from failbench.basics.chunks import Chunk, ChunkOutcome, Work, attempt
from failbench.basics.errors import MissingExtra
from failbench.sweeps.executors import MAX_KILLS, checked_workers, died

_AHEAD = 2
"""Chunks handed out for each worker, so that none waits for the driver."""


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
        """
        ray = _ray()
        with _running(ray, self) as cpus:
            # Who dies is counted here, so that a chunk that kills its workers is given up by name.
            task = ray.remote(num_cpus=1, max_retries=0)(attempt)
            shared = ray.put(work)
            todo, running, kills = deque(chunks), dict[Any, Chunk](), Counter[int]()
            try:
                while todo or running:
                    while todo and len(running) < _AHEAD * cpus:
                        chunk = todo.popleft()
                        running[task.remote(shared, chunk)] = chunk
                    for done in ray.wait(list(running), num_returns=1)[0]:
                        chunk = running.pop(done)
                        try:
                            yield ray.get(done)
                        except ray.exceptions.WorkerCrashedError as error:
                            kills[chunk.index] += 1
                            if kills[chunk.index] == MAX_KILLS:
                                yield died(chunk, MAX_KILLS, type(error).__name__)
                            else:
                                todo.appendleft(chunk)
            finally:
                for left in running:
                    ray.cancel(left)


def _ray() -> Any:
    try:
        return importlib.import_module("ray")
    except ImportError:
        raise MissingExtra("ray", "ray") from None


@contextmanager
def _running(ray: Any, executor: RayExecutor) -> Generator[int]:
    """Give the number of CPUs of a Ray that runs; end it afterwards if it is our own."""
    ours = not ray.is_initialized()
    if ours:
        # Ray reports its use to its makers unless told otherwise.
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        own = {"num_cpus": checked_workers(executor.workers), "include_dashboard": False}
        ray.init(address=executor.address, log_to_driver=False, **({} if executor.address else own))
    try:
        yield max(1, int(ray.cluster_resources().get("CPU", 1)))
    finally:
        if ours:
            ray.shutdown()
