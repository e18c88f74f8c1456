"""Errors of FailBench, in addition to those of graceful_plan."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from graceful_plan import GracefulPlanError


class ExecutionRefused(GracefulPlanError, RuntimeError):
    """Raised for a motion that the healthy robot cannot execute: failures along it would tell nothing.

    Args:
        what: The joint that does not follow, or the object that leaves the gripper.
        time: Time on the trajectory's clock [s].
        problem: What happens there, and the remedy.
    """

    def __init__(self, what: str, time: float, problem: str) -> None:
        self.what, self.time, self.problem = what, time, problem
        super().__init__(f"{what} at {time:.3f} s: {problem}")


class SweepBusy(GracefulPlanError, RuntimeError):
    """Raised if another process is working on the sweep."""

    def __init__(self, file: Path) -> None:
        self.file = file
        super().__init__(f"{file}: another process is working on this sweep")


class WorkerError(GracefulPlanError, RuntimeError):
    """Raised if worker processes die before they compute anything."""

    def __init__(self, problem: str) -> None:
        self.problem = problem
        super().__init__(
            f'workers: {problem}; a script that uses workers must keep its own actions below if __name__ == "__main__":'
        )


class NoPicture(GracefulPlanError, RuntimeError):
    """Raised if a picture cannot be made or shown on this machine.

    Args:
        problem: What is missing.
        remedy: How to fix it.
    """

    def __init__(self, problem: str, remedy: str) -> None:
        self.problem, self.remedy = problem, remedy
        super().__init__(f"{problem}; {remedy}")


class SweepFailed(GracefulPlanError, RuntimeError):
    """Raised if chunks of a sweep failed. Finished chunks are kept.

    Args:
        folder: The sweep's folder.
        errors: Error message of each failed chunk.
        chunks: Number of all chunks.
    """

    def __init__(self, folder: Path, errors: Sequence[str], chunks: int) -> None:
        self.folder, self.errors, self.chunks = folder, tuple(errors), chunks
        super().__init__(
            f"{folder}: {len(self.errors)} of {chunks} chunks failed and there is no dataset yet; the first: "
            f"{self.errors[0]}; to retry them: failbench resume {folder}"
        )


class MissingExtra(GracefulPlanError, ImportError):
    """Raised if a package of an extra is not installed."""

    def __init__(self, package: str, extra: str) -> None:
        self.package, self.extra = package, extra
        super().__init__(f"{package} is not installed; pip install '.[{extra}]'")
