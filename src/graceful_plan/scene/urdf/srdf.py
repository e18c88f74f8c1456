"""SRDF: link pairs that may touch, and named configurations of a robot."""

from __future__ import annotations

import logging
import math
import xml.etree.ElementTree as ET
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import final

from graceful_plan.exceptions import SceneError, UnknownNameError, names_file
from graceful_plan.scene.elements import AllowedContact
from graceful_plan.scene.urdf.reading import UrdfJoint, UrdfRobot
from graceful_plan.scene.urdf.robot_xml import parsed_robot

_LOG = logging.getLogger(__name__)

_ROUNDED = 0.02
"""How far a group state may exceed a limit to count as rounded [rad or m]; published ones exceed it by up to 0.017."""


@final
@dataclass(frozen=True, kw_only=True)
class Srdf:
    """The data read from an SRDF.

    | field  | meaning                                                                  |
    |--------|--------------------------------------------------------------------------|
    | pairs  | link pairs with disabled collisions                                      |
    | states | joint positions by state, then joint; later ones win                     |
    | groups | by name: the group's element                                             |
    """

    pairs: tuple[tuple[str, str], ...]
    states: Mapping[str, Mapping[str, float]]
    groups: Mapping[str, ET.Element]

    def within(self, robot: UrdfRobot, limits: Mapping[str, tuple[float, float]]) -> Srdf:
        """Return this with states inside of limits: rounded positions are clamped, others are left out.

        Both log a warning, since the SRDF does not fit the URDF. Joints without limits are turned back by full turns.

        Args:
            robot: The robot.
            limits: Limits that replace those of the robot, by joint with prefix [rad or m].
        """
        known = robot.limits | {name.removeprefix(f"{robot.name}/"): pair for name, pair in limits.items()}
        endless = {joint.name for joint in robot.joints if joint.kind == "continuous"} - known.keys()
        return replace(self, states={name: _within(name, state, known, endless) for name, state in self.states.items()})

    def joints(self, group: str, robot: UrdfRobot) -> list[UrdfJoint]:
        """Return the joints of a group that can be planned, in the order of the model.

        Raises:
            UnknownNameError: If there is no such group.
            SceneError: If it has no joints.
        """
        if group not in self.groups:
            raise UnknownNameError("group of the SRDF", group, self.groups)
        above = {joint.child: joint for joint in robot.joints}
        names, groups, seen = set[str](), [group], set[str]()
        while groups:
            name = groups.pop()
            if name in seen or name not in self.groups:
                continue
            seen.add(name)
            element = self.groups[name]
            groups += [inner.get("name", "") for inner in element.iterfind("group")]
            names |= {joint.get("name", "") for joint in element.iterfind("joint")}
            names |= {
                above[str(link.get("name"))].name for link in element.iterfind("link") if link.get("name") in above
            }
            for chain in element.iterfind("chain"):
                link, base = chain.get("tip_link", ""), chain.get("base_link", "")
                for _ in robot.joints:
                    if link == base or link not in above:
                        break
                    names.add(above[link].name)
                    link = above[link].parent
        found = robot.movable(names)
        if not found:
            raise SceneError(f"the group {group!r} has no joints that can be planned")
        return found

    def contacts(self, robot: UrdfRobot) -> tuple[AllowedContact, ...]:
        """Return the pairs whose links exist in the robot, as allowed contacts."""
        links = {link for joint in robot.joints for link in (joint.parent, joint.child)}
        known = [pair for pair in self.pairs if links.issuperset(pair)]
        return tuple(AllowedContact(f"{robot.name}/{a}", f"{robot.name}/{b}", reason="SRDF") for a, b in known)

    def keyframes(self, joints: Sequence[str]) -> dict[str, list[float]]:
        """Return the states that define all of the given joints."""
        whole = {name: state for name, state in self.states.items() if all(joint in state for joint in joints)}
        return {name: [state[joint] for joint in joints] for name, state in whole.items()}

    def others(self, robot: UrdfRobot, planned: Collection[UrdfJoint]) -> dict[str, dict[str, tuple[float, ...]]]:
        """Return the positions in each state of joints that are neither planned nor mimic others, with the prefix."""
        names = {joint.name for joint in robot.joints if joint.is_movable and joint not in planned}
        return {
            state: {f"{robot.name}/{name}": (value,) for name, value in positions.items() if name in names}
            for state, positions in self.states.items()
        }


def no_srdf() -> Srdf:
    """Return an empty SRDF."""
    return Srdf(pairs=(), states={}, groups={})


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
    groups = {group.get("name", ""): group for group in root.iterfind("group")}
    return Srdf(pairs=tuple(pairs), states=states, groups=groups)


def _within(
    name: str, state: Mapping[str, float], limits: Mapping[str, tuple[float, float]], endless: Collection[str]
) -> dict[str, float]:
    kept = {}
    for joint, value in state.items():
        lower, upper = limits.get(joint, (-math.inf, math.inf))
        inside = min(max(value, lower), upper)
        if abs(inside - value) > _ROUNDED:
            _LOG.warning("group state %r: %s at %g is left out, outside of [%g, %g]", name, joint, value, lower, upper)
            continue
        if joint in endless and abs(value) > 2.0 * math.pi:
            inside = value = math.remainder(value, 2.0 * math.pi)
        if inside != value:
            _LOG.warning("group state %r: %s at %g is clamped to [%g, %g]", name, joint, value, lower, upper)
        kept[joint] = inside
    return kept


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
