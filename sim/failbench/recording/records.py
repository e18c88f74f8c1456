"""What goes into a rollout and what comes out of it: small frozen records."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from failbench.fault.fault import Fault
from graceful_plan.exceptions import SettingError

Array = np.ndarray


@dataclass(frozen=True, kw_only=True)
class Job:
    """One rollout to be done: a fault at a moment of a trajectory.

    Args:
        fault: What breaks.
        onset: When, after the start of the trajectory [s]; beyond its end, the end.
        seed: Of everything random in the rollout.
        weight: Density of the onset that is asked about over the density that it was drawn from.
    """

    fault: Fault
    onset: float
    seed: int
    weight: float = 1.0

    def __post_init__(self) -> None:
        if not isinstance(self.fault, Fault):
            raise SettingError("fault", self.fault, "a failbench.Fault")
        if isinstance(self.seed, bool) or not isinstance(self.seed, int | np.integer) or self.seed < 0:
            raise SettingError("seed", self.seed, "a whole number, at least 0")
        for name, value in (("onset", self.onset), ("weight", self.weight)):
            if not (math.isfinite(value) and value >= 0.0):
                raise SettingError(name, value, "a finite number >= 0")


@dataclass(frozen=True, kw_only=True)
class ContactEvent:
    """Everything that one thing did to one entity by touching it during a rollout.

    Args:
        striker: The component that touched it ("body", "carried", "contents"), or the entity that was knocked onto it.
        entity: What was touched.
        time: First touch, after the onset [s].
        position: Where, in W [m].
        peak_force: Greatest normal force [N]. Depends on the softness of MuJoCo's contacts.
        impulse: Time integral of the contact force's magnitude [N s], with that of what comes to rest there.
        speed: Relative speed of the two at the first touch, along the normal [m/s], >= 0.
        energy: Kinetic energy of the striker at the first touch [J]: half its effective mass at the point of touch,
            along the normal, times `speed` squared.
        secondary: Whether the striker is another entity.
    """

    striker: str
    entity: str
    time: float
    position: tuple[float, float, float]
    peak_force: float
    impulse: float
    speed: float
    energy: float
    secondary: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class Rollout:
    """What one failure did.

    Args:
        job: What was asked.
        onset: When the fault began, after the start of the trajectory [s]: the checkpoint nearest to the job's.
        status: "completed", or "diverged" if the simulation blew up; then there are no consequences, but a `state`.
        events: Contacts that the healthy run does not have, in the order of their first touch.
        landings: What else the carried object touched: obstacles that are no entity ("" in their place), and entities
            that it touches in the healthy run, too. They harm nobody but the object itself.
        fell: Movable entities that ended more than 5 cm lower than they began.
        tipped: Movable entities that ended more than 30 degrees off their initial axis.
        left_support: Movable entities that ended without touching what they stood on.
        spilled: Lost fraction of the contents that were there at the onset, in [0, 1]; 0 if there were none.
        dropped: Whether the carried object left the gripper.
        poses: Final pose of every movable entity and of the carried object, wxyz_xyz in W.
        state: If it diverged: MuJoCo's integration state at the last checkpoint before, for replay. Else None.
    """

    job: Job
    onset: float
    status: str = "completed"
    events: tuple[ContactEvent, ...] = ()
    landings: tuple[ContactEvent, ...] = ()
    fell: tuple[str, ...] = ()
    tipped: tuple[str, ...] = ()
    left_support: tuple[str, ...] = ()
    spilled: float = 0.0
    dropped: bool = False
    poses: Mapping[str, Array] = field(default_factory=lambda: MappingProxyType({}))
    state: Array | None = None
