"""What a check reports."""

from __future__ import annotations

from graceful_plan.exceptions import GracefulPlanError


class ContractError(GracefulPlanError, AssertionError):
    """An object breaks the contract of its kind.

    Args:
        subject: The planner or cost.
        findings: What is wrong, one sentence each.
    """

    def __init__(self, subject: object, findings: tuple[str, ...]) -> None:
        self.subject, self.findings = subject, findings
        super().__init__("\n".join([f"{type(subject).__name__} breaks its contract:", *(f"- {f}" for f in findings)]))
