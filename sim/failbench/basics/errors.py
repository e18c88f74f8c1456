"""Errors of FailBench, besides those of graceful_plan."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from graceful_plan import GracefulPlanError


class ExecutionRefused(GracefulPlanError, RuntimeError):
    """A motion that the healthy robot cannot carry out, so that nothing can be learnt from breaking it.

    Args:
        what: The joint that does not follow, or the object that does not stay in the gripper.
        time: When, on the trajectory's clock [s].
        problem: What happens there, and what to do about it.
    """

    def __init__(self, what: str, time: float, problem: str) -> None:
        self.what, self.time, self.problem = what, time, problem
        super().__init__(f"{what} at {time:.3f} s: {problem}")


class SweepBusy(GracefulPlanError, RuntimeError):
    """A sweep that another process is working on."""

    def __init__(self, file: Path) -> None:
        self.file = file
        super().__init__(f"{file}: another process is working on this sweep")


class WorkerError(GracefulPlanError, RuntimeError):
    """Processes that die before they can do anything."""

    def __init__(self, problem: str) -> None:
        self.problem = problem
        super().__init__(
            f"workers: {problem}; a script that uses workers has to keep its own actions below "
            'if __name__ == "__main__":'
        )


class NoPicture(GracefulPlanError, RuntimeError):
    """A picture that cannot be made or shown on this machine.

    Args:
        problem: What is missing.
        remedy: What to do about it.
    """

    def __init__(self, problem: str, remedy: str) -> None:
        self.problem, self.remedy = problem, remedy
        super().__init__(f"{problem}; {remedy}")


class SweepFailed(GracefulPlanError, RuntimeError):
    """A sweep of which chunks failed. What is done is kept.

    Args:
        folder: The sweep's folder.
        errors: What went wrong, a text for each chunk.
        chunks: Number of all chunks.
    """

    def __init__(self, folder: Path, errors: Sequence[str], chunks: int) -> None:
        self.folder, self.errors, self.chunks = folder, tuple(errors), chunks
        super().__init__(
            f"{folder}: {len(self.errors)} of {chunks} chunks failed and there is no dataset yet; the first: "
            f"{self.errors[0]}; to try them again: failbench resume {folder}"
        )


class MissingExtra(GracefulPlanError, ImportError):
    """A package that comes with an extra and is not installed."""

    def __init__(self, package: str, extra: str) -> None:
        self.package, self.extra = package, extra
        super().__init__(f"{package} is not installed; pip install 'graceful-plan[{extra}]'")
