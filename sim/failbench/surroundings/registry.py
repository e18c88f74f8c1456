"""Registry of the faults of the surroundings. They are not in `failbench.faults()`, which holds faults of the robot."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from failbench.fault.fault import Fault
from failbench.surroundings.comers import DoorOpens, PersonWalksIn
from failbench.surroundings.disturbance import Disturbance, scene_with_intruder
from failbench.surroundings.things import AddedObject, BumpedTable, HeavierObject, PushedObject, WetFloor

__all__ = [
    "AddedObject",
    "BumpedTable",
    "Disturbance",
    "DoorOpens",
    "HeavierObject",
    "PersonWalksIn",
    "PushedObject",
    "WetFloor",
    "disturbances",
    "scene_with_intruder",
]

_DISTURBANCES: Mapping[str, type[Fault]] = MappingProxyType(
    {
        fault.NAME: fault
        for fault in (PushedObject, AddedObject, BumpedTable, WetFloor, HeavierObject, PersonWalksIn, DoorOpens)
    }
)


def disturbances() -> Mapping[str, type[Fault]]:
    """Return the class of each fault of the surroundings by its name."""
    return _DISTURBANCES
