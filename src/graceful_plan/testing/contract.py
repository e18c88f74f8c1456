"""The error that a check raises."""

from __future__ import annotations

from graceful_plan.exceptions import GracefulPlanError


class ContractError(GracefulPlanError, AssertionError):
    """Raised if an object breaks the contract of its kind.

    Args:
        subject: The planner or cost.
        findings: The violations, one sentence each.
    """

    def __init__(self, subject: object, findings: tuple[str, ...]) -> None:
        self.subject, self.findings = subject, findings
        super().__init__("\n".join([f"{type(subject).__name__} breaks its contract:", *(f"- {f}" for f in findings)]))
