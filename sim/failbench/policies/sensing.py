"""What the sensors of a robot say in which something may be broken."""

from __future__ import annotations

import numpy as np

from failbench.fault.registry import ControlDelay
from failbench.rollouts.injection import Injection
from graceful_plan.array_types import Bool, Float

Array = np.ndarray
Reading = tuple[Float[Array, " nq"], Float[Array, " nq"]]
"""Positions [rad or m] and speeds [rad/s or m/s]."""


class Sensing:
    """Reads positions and speeds as the servos do, in one simulation with a fault.

    Faults of sensors act on the servos' feedback: a known error is told by `Plant.misread`, anything else is a change
    of "actuator_biasprm". What the feedback is worth to a healthy servo is what the sensor says. A feedback that does
    not depend on the joint any more is a reading that stands.

    Args:
        injection: The fault. Call `look` whenever it has acted.
    """

    def __init__(self, injection: Injection) -> None:
        self._injection = injection
        n = len(injection.plant.robot.joints)
        self._stands: Bool[Array, " nq"] = np.zeros(n, dtype=bool)
        self._stood: Reading = np.zeros(n), np.zeros(n)
        fault = injection.job.fault
        # What is late is told by `delay`: feedback that comes late does not depend on the joint as it is.
        late = isinstance(fault, ControlDelay)
        self._feedback = fault.CATEGORY == "sensor" and "actuator_biasprm" in fault.FIELDS and not late

    @property
    def delay(self) -> float:
        """How old what the policy gets is [s]: a line that delays commands delays answers, too."""
        fault = self._injection.job.fault
        return self._injection.level * fault.amount if isinstance(fault, ControlDelay) else 0.0

    def look(self) -> None:
        """Find out which readings stand, and where, after the fault has acted."""
        if self._feedback:
            plant = self._injection.plant
            bias = plant["actuator_biasprm"][plant.robot.actuators]
            stands = (bias[:, 1] == 0.0) & (bias[:, 2] == 0.0)
            began = stands & ~self._stands
            for stood, now in zip(self._stood, (plant.q, plant.qd), strict=True):
                stood[began] = now[began]
            self._stands = stands

    def read(self, step: int) -> Reading:
        """Return what the sensors say at a step after the onset."""
        plant, robot = self._injection.plant, self._injection.plant.robot
        q, qd = plant.q.copy(), plant.qd.copy()
        if plant.misreading is not None:
            began, joints, error = plant.misreading
            q[joints] += error[min(step - began, len(error) - 1)]
        if self._feedback:
            b0, b1, b2 = plant["actuator_biasprm"][robot.actuators, :3].T
            damped = robot.kd > 0.0
            q = np.where(self._stands, self._stood[0], -(b0 + b1 * q) / robot.kp)
            read = np.where(damped, -b2 * qd / np.where(damped, robot.kd, 1.0), qd)
            qd = np.where(self._stands, self._stood[1], read)
        return q, qd
