"""A Ray cluster of several nodes on this machine, whose nodes and workers can be killed."""

from __future__ import annotations

import os
import random
import signal
from pathlib import Path
from types import TracebackType
from typing import Any


class RayNodes:
    """A head that does no work, and worker nodes. Use it in a `with` statement.

    Args:
        count: Number of nodes.
        cpus: Workers per node.
    """

    def __init__(self, count: int = 2, cpus: int = 1) -> None:
        self.count, self.cpus = count, cpus

    def __enter__(self) -> RayNodes:
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        from ray.cluster_utils import Cluster

        self._cluster: Any = Cluster(
            initialize_head=True, head_node_args={"num_cpus": 0, "include_dashboard": False}, shutdown_at_exit=False
        )
        self._nodes = [self._cluster.add_node(num_cpus=self.cpus) for _ in range(self.count)]
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._cluster.shutdown()

    @property
    def address(self) -> str:
        """Address for drivers."""
        return self._cluster.address

    def busy(self) -> list[int]:
        """Return the processes that work on chunks now."""
        return [pid for node in self._nodes for pid in _children(_raylet(node)) if b"_attempt" in _command(pid)]

    def seconds(self) -> float:
        """Return the CPU time of the running processes of the cluster, without drivers [s]."""
        servers = [
            info.process.pid
            for node in (self._cluster.head_node, *self._nodes)
            for infos in node.all_processes.values()
            for info in infos
        ]
        return sum(process_seconds(pid) for server in servers for pid in (server, *_children(server)))

    def kill_node(self, chosen: random.Random) -> None:
        """Kill all processes of a node at once, and start another node."""
        node = chosen.choice(self._nodes)
        self._nodes.remove(node)
        workers = _children(_raylet(node))
        self._cluster.remove_node(node, allow_graceful=False)
        for pid in workers:  # a dying machine ends them, too
            if _command(pid).startswith(b"ray::"):
                os.kill(pid, signal.SIGKILL)
        self._nodes.append(self._cluster.add_node(num_cpus=self.cpus))


def _raylet(node: Any) -> int:
    return node.all_processes["raylet"][0].process.pid


def _children(pid: int) -> list[int]:
    """Return the processes that any thread of a process started."""
    try:
        threads = list(Path(f"/proc/{pid}/task").iterdir())
        return [int(child) for thread in threads for child in (thread / "children").read_text().split()]
    except OSError:
        return []


def _command(pid: int) -> bytes:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return b""


def process_seconds(pid: int) -> float:
    """Return the CPU time of a process [s]; 0 if it has ended."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
