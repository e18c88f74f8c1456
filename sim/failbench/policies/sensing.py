"""Sensor readings of a robot with a fault."""

from __future__ import annotations

import numpy as np

from failbench.fault.registry import ControlDelay
from failbench.rollouts.injection import Injection
from graceful_plan.array_types import Array, Bool, Float

Reading = tuple[Float[Array, " nq"], Float[Array, " nq"]]
"""Positions [rad or m] and speeds [rad/s or m/s]."""


class Sensing:
    """Reads joint positions and speeds as the servos do, in one simulation with a fault.

    Sensor faults act on the servos' feedback. Known errors are set by `Simulation.misread`; all other faults change
    "actuator_biasprm", and the reading is the value that would give a healthy servo the same feedback. Feedback that no
    longer depends on the joint is a frozen reading.

    Args:
        injection: The fault. Call `look` after each action of the fault.
    """

    def __init__(self, injection: Injection) -> None:
        self._injection = injection
        n = len(injection.plant.robot.joints)
        self._stands: Bool[Array, " nq"] = np.zeros(n, dtype=bool)
        self._stood: Reading = np.zeros(n), np.zeros(n)
        fault = injection.job.fault
        # Delays are modelled by `delay` instead, since delayed feedback does not depend on the current position.
        late = isinstance(fault, ControlDelay)
        self._feedback = fault.CATEGORY == "sensor" and "actuator_biasprm" in fault.FIELDS and not late

    @property
    def delay(self) -> float:
        """Age of the policy's readings [s]; a control delay applies to commands and readings."""
        fault = self._injection.job.fault
        return self._injection.level * fault.amount if isinstance(fault, ControlDelay) else 0.0

    def look(self) -> None:
        """Find which readings are frozen, and at which values, after the fault has acted."""
        if self._feedback:
            plant = self._injection.plant
            bias = plant["actuator_biasprm"][plant.robot.actuators]
            stands = (bias[:, 1] == 0.0) & (bias[:, 2] == 0.0)
            began = stands & ~self._stands
            for stood, now in zip(self._stood, (plant.q, plant.qd), strict=True):
                stood[began] = now[began]
            self._stands = stands

    def read(self, step: int) -> Reading:
        """Return the readings at a step after the onset."""
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
