"""Register scenarios with Gymnasium: `gymnasium.make("FailBench/SCENE.TASK.FAULT.DEGREE")`.

Gymnasium allows one slash in a name, so dots replace the others. "FailBench/SCENE.TASK" is the task without a failure.
"""

from __future__ import annotations

import graceful_plan as gp
from failbench.basics.errors import MissingExtra
from failbench.scenario import scenarios
from graceful_plan.exceptions import UnsupportedError

_ENVIRONMENT = "failbench.policies.gym.environment"


def register(pattern: str = "*") -> tuple[str, ...]:
    """Register scenarios and their tasks without a failure; existing registrations stay unchanged.

    Args:
        pattern: Pattern of names or tags, such as "tabletop/*" or "drop/*/severe".

    Returns:
        The names of all matches.

    Raises:
        UnknownNameError: If nothing matches.
        MissingExtra: If Gymnasium is not installed.
        UnsupportedError: If only scenarios of driving robots match.
    """
    try:
        import gymnasium
    except ImportError:
        raise MissingExtra("gymnasium", "policies") from None
    names: list[str] = []
    found = [scenario for scenario in scenarios(pattern) if scenario.scene not in gp.mobile_scenes()]
    if not found:
        raise UnsupportedError(
            f"{pattern}: policies act on fixed arms; pass controllers of driving bases to `failbench.drive_base`"
        )
    for scenario in found:
        task = f"{scenario.scene}/{scenario.task}"
        for name, fault in ((task, None), (scenario.name, scenario.fault)):
            identity = f"FailBench/{name.replace('/', '.')}"
            if identity not in gymnasium.registry:
                gymnasium.register(
                    identity,
                    entry_point=f"{_ENVIRONMENT}:FailBenchEnv",
                    vector_entry_point=f"{_ENVIRONMENT}:FailBenchVectorEnv",
                    kwargs={"task": task, "fault": fault},
                )
            names.append(identity)
    return tuple(dict.fromkeys(names))
