"""A custom fault: a joint runs away, because its drive gives a constant torque and ignores commands.

Pass the object; there is no registration. In a sweep file its name is "examples/custom_fault.py:Runaway".
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import failbench
import graceful_plan as gp
from failbench.testing import check_fault


@dataclass(frozen=True, kw_only=True)
class Runaway(failbench.Fault):
    """A drive gives torque in one direction, independent of commands and sensors.

    Args:
        backwards: Whether the torque acts in the negative direction of the joint.
    """

    backwards: bool = False

    NAME: ClassVar[str] = "runaway"
    CATEGORY: ClassVar[str] = "actuator"
    PARAMETER: ClassVar[str] = "torque, as a share of the joint's greatest torque"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.1, "moderate": 0.3, "severe": 0.6, "critical": 1.0}
    FIELDS: ClassVar[tuple[str, ...]] = ("actuator_gainprm", "actuator_biasprm", "actuator_forcerange")

    def apply(self, plant: failbench.Simulation, level: float) -> None:
        """Replace the servo's torque by a constant one."""
        struck = plant.robot.actuators[plant.joints]
        torque = level * self.amount * plant["actuator_forcerange"][struck, 1]
        plant["actuator_gainprm"][struck] = 0.0
        plant["actuator_biasprm"][struck] = 0.0
        plant["actuator_biasprm"][struck, 0] = -torque if self.backwards else torque


def main(count: int = 20) -> list[failbench.Rollout]:
    """Check the fault, then simulate `count` failures of a motion at evenly spaced onsets; return the rollouts."""
    check_fault(Runaway())
    task = gp.load_scene("tabletop").tasks["lift_to_goal"]
    plan = gp.plan(task.start, task.goal, task.scene, iterations=20)
    healthy = failbench.execute(plan, failbench.build_world(task.scene))
    jobs = [
        failbench.RolloutRequest(
            fault=Runaway(targets=("panda/joint4",), backwards=i % 2 == 1),
            onset=(i + 0.5) / count * healthy.duration,
            seed=i,
        )
        for i in range(count)
    ]
    rollouts = failbench.run_rollouts(healthy, jobs)
    touched = sorted({event.entity for rollout in rollouts for event in rollout.events})
    print(f"{sum(bool(r.events) for r in rollouts)} of {count} failures touched something: {', '.join(touched)}")
    return rollouts


if __name__ == "__main__":
    main()
