"""Which links of a robot touch each other wherever its joints are, and models whose filters leave all of that out."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import final

import mujoco
import numpy as np

from graceful_plan.exceptions import SceneError, SettingError, UnsupportedError
from graceful_plan.scene.contacts import tested_pairs, unchecked_links
from graceful_plan.scene.elements import AllowedContact
from graceful_plan.scene.model_parts import colliding_geoms, names, planned_joints, robot_bodies, tool_body
from graceful_plan.scene.screening import MAX_EXTENT, compile_spec

Array = np.ndarray

_LOG = logging.getLogger(__name__)

_OBJ = mujoco.mjtObj
_SAMPLES, _ALWAYS = 200, 0.95
"""Configurations drawn, and in which share of them a pair of links has to touch to be one that always does."""
_MASKS = 31
"""Bits that a filter of MuJoCo's may have."""
OFTEN = 0.25
"""Share of configurations in which links may touch before meshes are divided: hulls of a UR5 do in half of them and its
parts in a quarter, those of a Panda, xArm 7, Jaco or Z1 in 6 to 14 %."""
KINDS = ("model", "links")


@final
@dataclass(frozen=True)
class Touching:
    """Which links touch, as far as it was looked at.

    | field    | meaning                                                                                      |
    |----------|----------------------------------------------------------------------------------------------|
    | contacts | pairs that a joint lies between, and those that touch nearly wherever the joints are          |
    | often    | share of configurations in which other links touch, those aside that may                      |
    """

    contacts: tuple[AllowedContact, ...]
    often: float


def touching(spec: mujoco.MjSpec, robot: str, tool: str, allowed: Sequence[AllowedContact] = ()) -> Touching:
    """Find links that touch.

    Args:
        spec: With the robot.
        robot: Prefix of its bodies, or its root.
        tool: Site of the tool: joints between the world and it are drawn evenly within their limits, others stay.
        allowed: What may touch besides.
    """
    model = compile_spec(spec)
    bodies = robot_bodies(model, robot)
    group = {body: _rigid_root(model, body, bodies) for body in bodies}
    pairs = {
        (group[parent], group[body])
        for body in bodies
        if model.body_jntnum[body] and (parent := int(model.body_parentid[body])) in bodies
    }
    touched = _touched(model, group, planned_joints(model, tool_body(model, tool, bodies), bodies))
    count = Counter(pair for found in touched for pair in found)
    reasons = dict.fromkeys((pair for pair, found in count.items() if found >= _ALWAYS * _SAMPLES), "overlap")
    reasons |= dict.fromkeys(pairs, "adjacent")
    called = dict(zip(bodies, names(model, _OBJ.mjOBJ_BODY, bodies), strict=True))
    named = sorted((called[a], called[b], reason) for (a, b), reason in reasons.items())
    body = {name: k for k, name in called.items()}
    may = {(group[body[c.first]], group[body[c.second]]) for c in allowed if c.first in body and c.second in body}
    free = set(reasons) | may | {pair[::-1] for pair in may}
    often = sum(bool(found - free) for found in touched) / _SAMPLES
    return Touching(tuple(AllowedContact(a, b, reason=reason) for a, b, reason in named), often)


def link_contacts(
    spec: mujoco.MjSpec, robot: str, tool: str, kind: str, allowed: Sequence[AllowedContact]
) -> tuple[AllowedContact, ...]:
    """Let the filters of a MJCF model decide which links are tested against each other, or test all that can be.

    Args:
        spec: Of the model; its filters are changed for "links".
        robot: Prefix of the robot's bodies, or its root.
        tool: Site of the tool.
        kind: "model": as the filters say, with a warning if that is none of three or more links. "links": all pairs of
            links but excluded ones; those may touch that a joint lies between, and those that do nearly everywhere.
        allowed: What may touch besides.

    Returns:
        What may touch besides.

    Raises:
        SettingError: If it is of no such kind.
        UnsupportedError: If the model uses all bits of its filters.
    """
    if kind not in KINDS:
        raise SettingError("self_collision", kind, f"one of {', '.join(map(repr, KINDS))}")
    if kind == "model":
        return ()
    model = compile_spec(spec)
    mine = set(colliding_geoms(model, robot_bodies(model, robot)))
    used = int(np.bitwise_or.reduce(np.concatenate([model.geom_contype, model.geom_conaffinity]), initial=0))
    unused = next((1 << k for k in range(_MASKS) if not used >> k & 1), None)
    if unused is None:
        raise UnsupportedError("self_collision='links' needs a bit of contype and conaffinity that no geom uses")
    for geom in spec.geoms:
        if geom.id in mine:
            geom.contype |= unused
            geom.conaffinity |= unused
    return touching(spec, robot, tool, allowed).contacts


def warn_of_untested_links(model: mujoco.MjModel, robot: frozenset[int], name: str) -> None:
    """Say so if filters of a model let all links of a robot pass through each other."""
    pairs = tested_pairs(model, robot)
    count, unchecked = unchecked_links(model, robot, pairs, ())
    passing = len(unchecked.get("filters of the model", ()))
    if count == 0 and passing:
        _LOG.warning(
            "no two links of the robot %r are tested against each other: the filters of the model (contype, "
            "conaffinity, exclude) let %d pairs pass through each other; self_collision='links' tests them",
            name,
            passing,
        )


def _rigid_root(model: mujoco.MjModel, body: int, robot: frozenset[int]) -> int:
    """Return the body nearest to the base that this one hangs on rigidly."""
    while not model.body_jntnum[body] and int(model.body_parentid[body]) in robot:
        body = int(model.body_parentid[body])
    return body


def _touched(
    model: mujoco.MjModel, group: Mapping[int, int], joints: Sequence[int]
) -> list[frozenset[tuple[int, int]]]:
    """Return which links touch in each of some random configurations."""
    data, rng, touched = mujoco.MjData(model), np.random.default_rng(0), list[frozenset[tuple[int, int]]]()
    for _ in range(_SAMPLES):
        for joint in joints:
            data.qpos[model.jnt_qposadr[joint]] = rng.uniform(*_range(model, joint))
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        bodies = model.geom_bodyid[data.contact.geom[data.contact.dist < 0.0]].tolist()
        found = {(group[a], group[b]) for a, b in bodies if a in group and b in group}
        touched.append(frozenset((min(pair), max(pair)) for pair in found))
    return touched


def _range(model: mujoco.MjModel, joint: int) -> tuple[float, float]:
    if not model.jnt_limited[joint]:
        return -np.pi, np.pi
    lower, upper = model.jnt_range[joint]
    if max(abs(lower), abs(upper)) > MAX_EXTENT:
        name = model.joint(joint).name
        raise SceneError(f"the limits of joint {name!r} are {lower:g} and {upper:g}; {MAX_EXTENT:g} is the farthest")
    return lower, upper
