"""SRDF: link pairs that may touch, and named configurations of a robot."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import final

from graceful_plan.exceptions import SceneError, names_file
from graceful_plan.scene.elements import AllowedContact
from graceful_plan.scene.urdf.reading import UrdfRobot, parsed_robot


@final
@dataclass(frozen=True, kw_only=True)
class Srdf:
    """The data read from an SRDF.

    | field  | meaning                                                                  |
    |--------|--------------------------------------------------------------------------|
    | pairs  | link pairs with disabled collisions                                      |
    | states | joint positions by state, then joint; later ones win                     |
    """

    pairs: tuple[tuple[str, str], ...]
    states: dict[str, dict[str, float]]

    def contacts(self, robot: UrdfRobot) -> tuple[AllowedContact, ...]:
        """Return the pairs whose links exist in the robot, as allowed contacts."""
        links = {link for joint in robot.joints for link in (joint.parent, joint.child)}
        known = [pair for pair in self.pairs if links.issuperset(pair)]
        return tuple(AllowedContact(f"{robot.name}/{a}", f"{robot.name}/{b}", reason="SRDF") for a, b in known)

    def keyframes(self, joints: Sequence[str]) -> dict[str, list[float]]:
        """Return the states that define all of the given joints."""
        whole = {name: state for name, state in self.states.items() if all(joint in state for joint in joints)}
        return {name: [state[joint] for joint in joints] for name, state in whole.items()}


@names_file
def read_srdf(source: str | Path) -> Srdf:
    """Read an SRDF, from a file or text.

    Raises:
        SceneError: If it is broken or hostile.
    """
    root, _ = parsed_robot(source)
    pairs = [(pair.get("link1", ""), pair.get("link2", "")) for pair in root.iterfind("disable_collisions")]
    states: dict[str, dict[str, float]] = {}
    for state in root.iterfind("group_state"):
        states.setdefault(state.get("name", ""), {}).update(_positions(state))
    return Srdf(pairs=tuple(pairs), states=states)


def _positions(state: ET.Element) -> dict[str, float]:
    try:
        # Joints with several degrees of freedom, such as floating bases, have several values and are skipped.
        values = {joint.get("name", ""): joint.get("value", "").split() for joint in state.iterfind("joint")}
        found = {name: float(value[0]) for name, value in values.items() if len(value) == 1}
    except ValueError as error:
        raise SceneError(f"group state {state.get('name')!r}: {error}") from None
    for name, value in found.items():
        if not math.isfinite(value):
            raise SceneError(f"group state {state.get('name')!r}: the position of {name!r} is not finite")
    return found
