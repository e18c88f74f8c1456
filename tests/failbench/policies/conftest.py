from __future__ import annotations

import pytest

from failbench.policies.task import PolicySettings, PolicyTask, policy_task
from failbench.rollouts.execution import Execution, execute

NAME = "tabletop_l1/green_to_blue"


@pytest.fixture(scope="session")
def easy() -> PolicyTask:
    """A task with few objects and short episodes."""
    return policy_task(NAME, PolicySettings(noise=0.0, limit=1.6, horizon=0.3))


@pytest.fixture(scope="session")
def exact() -> PolicyTask:
    """The same task with an action for each time step."""
    return policy_task(NAME, PolicySettings(noise=0.0, period=0.002, limit=0.8, horizon=0.1))


@pytest.fixture(scope="session")
def execution(exact: PolicyTask) -> Execution:
    return execute(exact.straight, exact.world)
