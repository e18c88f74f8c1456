"""Inputs and results of a rollout: small frozen records."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from failbench.fault.fault import Fault
from graceful_plan.array_types import Array
from graceful_plan.exceptions import SettingError
from graceful_plan.path import is_whole, plain_numbers
from graceful_plan.setting_checks import not_negative


@dataclass(frozen=True, kw_only=True)
class RolloutRequest:
    """Specification of one rollout: a fault at a time of a trajectory.

    Args:
        fault: The fault.
        onset: Time after the start of the trajectory [s], clamped to its end.
        seed: Seed of all random numbers in the rollout.
        weight: Importance weight: target density of the onset over its sampling density.
    """

    fault: Fault
    onset: float
    seed: int
    weight: float = 1.0

    def __post_init__(self) -> None:
        plain_numbers(self)
        if not isinstance(self.fault, Fault):
            raise SettingError("fault", self.fault, "a failbench.Fault")
        if not is_whole(self.seed) or self.seed < 0:
            raise SettingError("seed", self.seed, "a whole number, at least 0")
        for name, value in (("onset", self.onset), ("weight", self.weight)):
            not_negative(name, value)


@dataclass(frozen=True, kw_only=True)
class ContactEvent:
    """All contacts of one thing with one entity during a rollout.

    Args:
        striker: The component that touches it ("body", "carried", "contents"), or the entity that is knocked onto it.
        entity: Name of the touched entity.
        time: First touch, after the onset [s].
        position: Position of the touch, in W [m].
        peak_force: Greatest normal force [N]. Depends on the softness of MuJoCo's contacts.
        impulse: Time integral of the contact force's magnitude [N s], including that of resting contact.
        speed: Relative normal speed at the first touch [m/s], >= 0.
        energy: Kinetic energy of the striker at the first touch [J]: half its effective mass at the contact point along
            the normal, times `speed` squared.
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
    """Consequences of one failure.

    Args:
        job: Specification of the rollout.
        onset: Onset of the fault after the start of the trajectory [s]: the checkpoint nearest to the job's onset.
        status: "completed", or "diverged" if the simulation blew up; then there are no consequences, but a `state`.
        events: Contacts that the healthy run does not have, in the order of their first touch.
        landings: Other contacts of the carried object: with obstacles that are not entities (named ""), and with
            entities that it also touches in the healthy run. They harm only the object itself.
        fell: Movable entities that ended more than 5 cm below their initial height.
        tipped: Movable entities that ended more than 30 degrees off their initial axis.
        left_support: Movable entities that ended without contact to their initial support.
        spilled: Lost fraction of the contents that were there at the onset, in [0, 1]; 0 without contents.
        dropped: Whether the carried object left the gripper.
        poses: Final pose of every movable entity and of the carried object, wxyz_xyz in W.
        state: MuJoCo's integration state at the last checkpoint before divergence, for replay; None if completed.
    """

    job: RolloutRequest
    onset: float
    status: str = "completed"
    events: tuple[ContactEvent, ...] = ()
    landings: tuple[ContactEvent, ...] = ()
    fell: tuple[str, ...] = ()
    tipped: tuple[str, ...] = ()
    left_support: tuple[str, ...] = ()
    spilled: float = 0.0
    dropped: bool = False
    poses: Mapping[str, Array] = field(default_factory=dict)
    state: Array | None = None
