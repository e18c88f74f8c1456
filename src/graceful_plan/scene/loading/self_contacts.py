"""Detect links that overlap in nearly all configurations, and warn of filters that test these, or no links at all."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import final

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Float, Int
from graceful_plan.exceptions import SceneError, SettingError, UnsupportedError
from graceful_plan.scene.contacts import tested_pairs, unchecked_links
from graceful_plan.scene.elements import AllowedContact
from graceful_plan.scene.model_parts import (
    ancestors,
    body_joints,
    colliding_geoms,
    names,
    planned_joints,
    robot_bodies,
    tool_body,
)
from graceful_plan.scene.screening import MAX_EXTENT
from graceful_plan.scene.specs import compile_spec

_LOG = logging.getLogger(__name__)

_OBJ = mujoco.mjtObj
_SAMPLES, _ALWAYS = 200, 0.95
"""Number of sampled configurations, and the fraction of them in which a pair must touch to count as always touching."""
_DEEP = 0.005
"""Depth from which a warning names pairs that always overlap [m]; hulls of sound meshes do by a few millimetres."""
_MASKS = 31
"""Number of bits in MuJoCo's contype and conaffinity."""
MAX_OVERLAP_FRACTION = 0.25
"""Fraction of configurations with touching links above which meshes are divided. The hulls of a UR5 touch in half of
them and its convex parts in a quarter; those of a Panda, xArm 7, Jaco or Z1 in 6 to 14 %."""
KINDS = ("model", "links")


@final
@dataclass(frozen=True)
class Touching:
    """Links that touch in sampled configurations.

    | field    | meaning                                                                                      |
    |----------|----------------------------------------------------------------------------------------------|
    | contacts | pairs with a joint in between, and pairs that touch in nearly all configurations             |
    | often    | fraction of configurations in which other links touch, allowed contacts excepted             |
    | deep     | pairs that planned joints move relative to each other, without a joint in between, and that  |
    |          | overlap deeply in nearly all configurations: depth [m]                                       |
    """

    contacts: tuple[AllowedContact, ...]
    often: float
    deep: Mapping[tuple[str, str], float]

    def warn(self) -> None:
        """Log a warning of pairs that overlap deeply: a mesh may be misplaced, or far from its convex hull."""
        if self.deep:
            told = ", ".join(f"{a} - {b} ({1e3 * depth:.0f} mm)" for (a, b), depth in self.deep.items())
            _LOG.warning(
                "links without a joint in between overlap in nearly all configurations and may touch from now on: %s; "
                "check their collision geometry",
                told,
            )


def touching(
    spec: mujoco.MjSpec,
    robot: str,
    tool: str,
    allowed: Sequence[AllowedContact] = (),
    joints: Sequence[str] | None = None,
) -> Touching:
    """Sample configurations and find the links that touch.

    Args:
        spec: Model that contains the robot.
        robot: Prefix of its bodies, or its root body.
        tool: Site of the tool.
        allowed: Contacts that are allowed anyway.
        joints: Joints to sample uniformly within limits, while others stay; by default those between world and tool.
    """
    model = compile_spec(spec)
    bodies = robot_bodies(model, robot)
    group = {body: _rigid_root(model, body, bodies) for body in bodies}
    pairs = {
        (group[parent], group[body])
        for body in bodies
        if model.body_jntnum[body] and (parent := int(model.body_parentid[body])) in bodies
    }
    planned = planned_joints(model, tool_body(model, tool, bodies), bodies, joints)
    touched = _touched(model, model.qpos0, group, planned)
    count = Counter(pair for depths in touched for pair in depths)
    reasons = dict.fromkeys((pair for pair, found in count.items() if found >= _ALWAYS * _SAMPLES), "overlap")
    reasons |= dict.fromkeys(pairs, "adjacent")
    called = dict(zip(bodies, names(model, _OBJ.mjOBJ_BODY, bodies), strict=True))
    named = sorted((called[a], called[b], reason) for (a, b), reason in reasons.items())
    body = {name: k for k, name in called.items()}
    may = {(group[body[c.first]], group[body[c.second]]) for c in allowed if c.first in body and c.second in body}
    free = set(reasons) | may | {pair[::-1] for pair in may}
    often = sum(bool(depths.keys() - free) for depths in touched) / _SAMPLES
    shape = {group[k]: called[k] for k in sorted(bodies, reverse=True) if colliding_geoms(model, [k])}
    deep = {}
    for a, b, reason in named:
        pair = body[a], body[b]
        depth = float(np.median([depths.get(pair, 0.0) for depths in touched]))
        apart = _mover(model, pair[0], planned) != _mover(model, pair[1], planned)
        if reason == "overlap" and apart and pair not in may and pair[::-1] not in may and depth > _DEEP:
            deep[shape[pair[0]], shape[pair[1]]] = depth
    return Touching(tuple(AllowedContact(a, b, reason=reason) for a, b, reason in named), often, deep)


def link_contacts(
    spec: mujoco.MjSpec,
    robot: str,
    tool: str,
    kind: str,
    allowed: Sequence[AllowedContact],
    joints: Sequence[str] | None = None,
) -> tuple[AllowedContact, ...]:
    """Return the contacts to allow so that self-collision is checked as `kind` requests.

    Args:
        spec: The model; for "links" its filters are changed.
        robot: Prefix of the robot's bodies, or its root body.
        tool: Site of the tool.
        kind: "model": the model's filters decide. "links": all link pairs are checked except excluded ones, pairs with
            a joint in between, and pairs that touch in nearly all configurations.
        allowed: Contacts that are allowed anyway.
        joints: Planned joints, if they are not those between world and tool.

    Returns:
        Contacts to allow in addition.

    Raises:
        SettingError: If the kind is unknown.
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
    touches = touching(spec, robot, tool, allowed, joints)
    touches.warn()
    return touches.contacts


def warn_of_untested_links(model: mujoco.MjModel, robot: frozenset[int], name: str) -> None:
    """Log a warning if the filters of a model let all links of a robot pass through each other."""
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


def warn_of_overlapping_links(
    model: mujoco.MjModel,
    qpos: Float[Array, " model_nq"],
    robot: frozenset[int],
    joints: Sequence[int],
    pairs: Int[Array, "pair 2"],
) -> None:
    """Log a warning of links that may not touch, but overlap in nearly all configurations: no start would be free.

    Args:
        model: The model.
        qpos: State of the whole model. If no links overlap in it, no others are sampled.
        robot: Bodies of the robot.
        joints: Planned joints.
        pairs: Pairs of geoms that may not touch.
    """
    group = {body: _rigid_root(model, body, robot) for body in robot}
    ends = [(group[a], group[b]) for a, b in model.geom_bodyid[pairs].tolist() if a in group and b in group]
    apart = {(min(pair), max(pair)) for pair in ends}
    if not apart & _overlaps(model, mujoco.MjData(model), qpos, group).keys():
        return
    count = Counter(pair for depths in _touched(model, qpos, group, joints) for pair in depths)
    always = sorted(pair for pair in apart if count[pair] >= _ALWAYS * _SAMPLES)
    if always:
        told = ", ".join(f"gp.AllowedContact{tuple(names(model, _OBJ.mjOBJ_BODY, pair))}" for pair in always)
        _LOG.warning(
            "links that may not touch overlap in nearly all configurations: move the fingers (fingers=, state=), allow "
            "the contacts (allowed_contacts=[%s]), or pass self_collision='links', which allows such pairs",
            told,
        )


def _mover(model: mujoco.MjModel, body: int, planned: Sequence[int]) -> int:
    """Return the last planned joint that moves a body; -1 if none does."""
    above = (joint for carrier in ancestors(model, body) for joint in reversed(body_joints(model, carrier)))
    return next((joint for joint in above if joint in planned), -1)


def _rigid_root(model: mujoco.MjModel, body: int, robot: frozenset[int]) -> int:
    """Return the root of the rigid group that contains a body."""
    while not model.body_jntnum[body] and int(model.body_parentid[body]) in robot:
        body = int(model.body_parentid[body])
    return body


def _touched(
    model: mujoco.MjModel, qpos: Float[Array, " model_nq"], group: Mapping[int, int], joints: Sequence[int]
) -> list[dict[tuple[int, int], float]]:
    """Return the pairs of links that touch in each of the sampled configurations, with the depth of the overlap [m]."""
    sampled, rng, touched = np.array(qpos), np.random.default_rng(0), list[dict[tuple[int, int], float]]()
    data = mujoco.MjData(model)
    for _ in range(_SAMPLES):
        for joint in joints:
            sampled[model.jnt_qposadr[joint]] = rng.uniform(*_range(model, joint))
        touched.append(_overlaps(model, data, sampled, group))
    return touched


def _overlaps(
    model: mujoco.MjModel, data: mujoco.MjData, qpos: Float[Array, " model_nq"], group: Mapping[int, int]
) -> dict[tuple[int, int], float]:
    """Return the pairs of links that touch in a state of the model, with the depth of the overlap [m]."""
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    mujoco.mj_collision(model, data)
    overlap = data.contact.dist < 0.0
    bodies = model.geom_bodyid[data.contact.geom[overlap]].tolist()
    depths: dict[tuple[int, int], float] = {}
    for (a, b), dist in zip(bodies, data.contact.dist[overlap].tolist(), strict=True):
        if a in group and b in group:
            pair = min(group[a], group[b]), max(group[a], group[b])
            depths[pair] = max(depths.get(pair, 0.0), -dist)
    return depths


def _range(model: mujoco.MjModel, joint: int) -> tuple[float, float]:
    if not model.jnt_limited[joint]:
        return -np.pi, np.pi
    lower, upper = model.jnt_range[joint]
    if max(abs(lower), abs(upper)) > MAX_EXTENT:
        name = model.joint(joint).name
        raise SceneError(f"the limits of joint {name!r} are {lower:g} and {upper:g}; {MAX_EXTENT:g} is the farthest")
    return lower, upper
