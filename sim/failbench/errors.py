"""Errors of FailBench, besides those of graceful_plan."""

from __future__ import annotations

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


class JournalBusy(GracefulPlanError, RuntimeError):
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
