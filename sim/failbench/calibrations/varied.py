"""Drops of objects that bounce differently from the scenes' materials, and that spin at their release.

Only the simulation varies. Planners and models do not know the variation, as for real objects.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import mujoco
import numpy as np

from failbench.rollouts.execution import Execution
from failbench.simulated.world import World
from graceful_plan.exceptions import SettingError
from graceful_plan.path import plain_numbers
from graceful_plan.setting_checks import not_negative

_RESTITUTION = (0.017, 0.193, 0.266, 0.351, 0.460, 0.529, 0.611, 0.694)
"""Restitution of a sphere that falls 0.3 m, for each of `_DAMPING`, by `restitution` of
`tests/support/scenes/materials.py`."""
_DAMPING = (0.8, 0.6, 0.5, 0.4, 0.3, 0.25, 0.2, 0.15)
"""Damping ratios of the contact, with MuJoCo's time constant of 0.02 s."""
_ALONE = 1e3
"""Mixing weight of the carried object's contact parameters, relative to those of the touched geom."""


@dataclass(frozen=True, kw_only=True)
class Variation:
    """Deviation of the dropped object from the scene's.

    Args:
        restitution: Least and greatest coefficient of restitution, drawn for each motion; None for the scene's.
        spin: Standard deviation about each axis of the angular velocity added at the failure of the gripper [rad/s].
            Fingers that still touch the object reduce it. Example: a finger that opens 20 ms after the other
            holds half the weight at half the width (3 cm) of an object with a radius of gyration of 5 cm: 1.2 rad/s.
    """

    restitution: tuple[float, float] | None = None
    spin: float = 0.0

    def __post_init__(self) -> None:
        plain_numbers(self)
        if self.restitution is not None:
            low, high = self.restitution
            if not _RESTITUTION[0] <= low <= high <= _RESTITUTION[-1]:
                raise SettingError(
                    "restitution", self.restitution, f"{_RESTITUTION[0]} to {_RESTITUTION[-1]}, in order"
                )
        not_negative("spin", self.spin, "finite, at least 0 rad/s")


VARIED = Variation(restitution=(0.1, 0.6), spin=1.2)
"""From cartons to hard balls (docs/failbench.md), released by fingers that do not open simultaneously."""


def bounce(world: World, variation: Variation, seed: int) -> None:
    """Set the carried object's restitution in a world, for contacts other than with the fingers."""
    if variation.restitution is None:
        return
    e = np.random.default_rng(seed).uniform(*variation.restitution)
    model = world.model
    carried = np.isin(model.geom_bodyid, world.striker_bodies["carried"])
    model.geom_solref[carried, 1] = np.interp(e, _RESTITUTION, _DAMPING)
    model.geom_solmix[carried] = _ALONE


def spun(execution: Execution, variation: Variation, seed: int) -> Execution:
    """Return an execution in which the carried object spins at every checkpoint."""
    if variation.spin == 0.0:
        return execution
    model, states = execution.world.model, execution.states.copy()
    joint = int(model.body_jntadr[execution.world.carried_body])
    before = mujoco.mjtState.mjSTATE_TIME | mujoco.mjtState.mjSTATE_QPOS
    first = mujoco.mj_stateSize(model, int(before)) + int(model.jnt_dofadr[joint]) + 3  # after the linear velocity
    rng = np.random.default_rng((seed, 1))
    states[:, first : first + 3] += rng.normal(scale=variation.spin, size=(len(states), 3))
    states.flags.writeable = False
    return replace(execution, states=states)
