"""Fingers between closed and open: their driving joints, their opening in metres, and closing them on an object.

A gripper may have slides, hinges or linkages, and one jaw may be fixed. Its leading joints are those that neither
follow others nor are passive; all other joints follow them (`couplings`).
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Collection
from typing import NamedTuple

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SettingError, UnsupportedError
from graceful_plan.scene.couplings import follow
from graceful_plan.scene.elements import Opening
from graceful_plan.scene.equalities import actuated, followers, passive_joints
from graceful_plan.scene.model_parts import colliding_geoms, names

_SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
_PROBE = 1e-5
"""Radius of the sphere that measures distances from the tool [m]."""
_FAR = 1.0
"""Distance beyond which fingers are not looked for [m]."""
_CONE = 0.5
"""Least cosine between the direction from the tool to a pad and the closing direction."""
_ON = 0.003
"""Distance up to which the tool counts as on a pad, as with some jaws; depth to which hulls may overlap [m]."""
_HALF = 0.5
"""Share of the stroke at which the pads and their direction are found."""
_HALVINGS = 14
"""Halvings of the stroke that find an opening: 0.1 m to 6 um."""
_INSIDE = 1e-3
"""Share of the way to the last position at which a linkage closes that is left out."""
_BESIDE = 1e-3
"""Largest error of an opening [m], beyond which it counts as out of reach."""


class Stroke(NamedTuple):
    """Leading joints of a gripper, with their positions when it is closed and open [rad or m]."""

    joints: tuple[int, ...]
    closed: Float[Array, " joint"]
    open: Float[Array, " joint"]

    def at(self, share: float) -> dict[int, float]:
        """Return the position of each joint at a share of the stroke, from closed (0) to open (1)."""
        return dict(zip(self.joints, (self.closed + share * (self.open - self.closed)).tolist(), strict=True))


class Hand(NamedTuple):
    """A gripper of a model.

    | field   | meaning                                    |
    |---------|--------------------------------------------|
    | model   | the model                                  |
    | bodies  | bodies of the gripper                      |
    | planned | planned joints                             |
    | tool    | site of the tool                           |
    """

    model: mujoco.MjModel
    bodies: Collection[int]
    planned: Collection[int]
    tool: int

    @property
    def joints(self) -> list[int]:
        """Joints of the gripper."""
        of = self.model.jnt_bodyid.tolist()
        return [j for j in range(self.model.njnt) if of[j] in self.bodies and j not in self.planned]

    def posed(self, qpos: Float[Array, " model_nq"], positions: dict[int, float]) -> mujoco.MjData:
        """Return the kinematics of a state with given positions of gripper joints."""
        data = mujoco.MjData(self.model)
        data.qpos[:] = follow(self.model, qpos, positions, self.planned)
        mujoco.mj_kinematics(self.model, data)
        mujoco.mj_comPos(self.model, data)
        return data


def leading_joints(hand: Hand) -> list[int]:
    """Return the joints that move the fingers: those with drives, or all that neither follow others nor are passive."""
    model = hand.model
    scalar = [j for j in hand.joints if int(model.jnt_type[j]) in _SCALAR]
    free = [j for j in scalar if j not in followers(model) and j not in passive_joints(model, hand.planned)]
    driven = [j for j in free if j in actuated(model)]
    return driven or free


def find_stroke(hand: Hand, qpos: Float[Array, " model_nq"]) -> Stroke:
    """Return the stroke of a gripper: each leading joint opens as fingers part from each other and from the tool.

    Joints without limits have none. Ends at which the chains of a linkage cannot close are left out.
    """
    model, ends = hand.model, []
    joints = [joint for joint in leading_joints(hand) if model.jnt_limited[joint]]
    geoms = list(colliding_geoms(model, moving_bodies(hand)))
    for joint in joints:
        lower, upper = (_farthest(hand, qpos, joint, float(end)) for end in model.jnt_range[joint])
        far = []
        for position in (lower, upper):
            data = hand.posed(qpos, {joint: position})
            places = np.vstack([data.geom_xpos[geoms], data.site_xpos[hand.tool]])
            far.append(float(np.linalg.norm(places[:, None] - places, axis=-1).sum()))
        ends.append((lower, upper) if far[1] >= far[0] else (upper, lower))
    closed, wide = np.array(ends, dtype=float).reshape(-1, 2).T
    return Stroke(tuple(joints), closed, wide)


def _farthest(hand: Hand, qpos: Float[Array, " model_nq"], joint: int, end: float) -> float:
    """Return the position nearest to an end of a joint's range at which the chains of a linkage close."""
    here = float(qpos[hand.model.jnt_qposadr[joint]])

    def closes(share: float) -> bool:
        try:
            hand.posed(qpos, {joint: here + share * (end - here)})
        except SettingError:
            return False
        return True

    return end if closes(1.0) else here + _threshold(closes) * (1.0 - _INSIDE) * (end - here)


def moving_bodies(hand: Hand) -> list[int]:
    """Return the bodies that joints of the gripper move."""
    model, found = hand.model, set[int]()
    jointed = {int(model.jnt_bodyid[j]) for j in hand.joints}
    for body in sorted(hand.bodies):  # parents come first
        if body in jointed or int(model.body_parentid[body]) in found:
            found.add(body)
    return sorted(found)


def positions_at(
    hand: Hand, qpos: Float[Array, " model_nq"], opening: Opening, held: Collection[int]
) -> dict[str, float]:
    """Return the position of each leading joint at an opening, by name.

    Args:
        hand: The gripper.
        qpos: State of the whole model, with the carried object in place.
        opening: The opening.
        held: Geoms of the carried object.

    Raises:
        UnsupportedError: If the gripper has no joint, or the tool is not between two pads.
        SettingError: If the opening is out of reach, nothing is carried on which to close, or the open gripper overlaps
            the object.
    """
    stroke = find_stroke(hand, qpos)
    if not stroke.joints:
        raise UnsupportedError("the gripper has no joint that opens it; leave out fingers=")
    if opening.metres is None:
        if not held:
            raise SettingError("fingers", opening, "Opening(metres): nothing is carried on which the fingers close")
        touches = _touches(hand, held)
        wide = hand.posed(qpos, stroke.at(1.0))
        depth = -gap_between(hand.model, wide, colliding_geoms(hand.model, hand.bodies), held)
        if depth > _ON or touches(wide):
            wanted = f"a grasp (at=, X_TO=) that the open gripper does not overlap, as it does by {1e3 * depth:.1f} mm"
            raise SettingError("fingers", opening, wanted)
        share = _threshold(lambda share: touches(hand.posed(qpos, stroke.at(share))))
    else:
        share = _share_at(hand, qpos, stroke, opening.metres)
    labels = names(hand.model, mujoco.mjtObj.mjOBJ_JOINT, stroke.joints)
    return dict(zip(labels, stroke.at(share).values(), strict=True))


def _share_at(hand: Hand, qpos: Float[Array, " model_nq"], stroke: Stroke, metres: float) -> float:
    pads = find_pads(hand, qpos, stroke)

    def at(share: float) -> float:
        return pads.gap(hand.posed(qpos, stroke.at(share)))

    most, least = at(1.0), at(0.0)
    if not least - _BESIDE <= metres <= most + _BESIDE:
        raise SettingError("opening", metres, f"between {max(least, 0.0):.3g} and {most:.3g} m")
    return _threshold(lambda share: at(share) <= metres)


def find_pads(hand: Hand, qpos: Float[Array, " model_nq"], stroke: Stroke) -> Pads:
    """Return the pads of a gripper; raises UnsupportedError if the tool is not between two."""
    return Pads(hand, hand.posed(qpos, stroke.at(_HALF)))


def _threshold(is_closed: Callable[[float], bool]) -> float:
    """Return the largest share, from 0 to 1, up to which a condition holds, such as that of a gripper's stroke."""
    if is_closed(1.0):
        return 1.0
    low, high = 0.0, 1.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if is_closed(middle) else (low, middle)
    return 0.5 * (low + high)


def clear_share(hand: Hand, qpos: Float[Array, " model_nq"], held: Collection[int]) -> float:
    """Return the share of the stroke from which on no finger touches the carried object; 0 if none ever does."""
    stroke, touches = find_stroke(hand, qpos), _touches(hand, held)
    if not stroke.joints or not touches(hand.posed(qpos, stroke.at(0.0))):
        return 0.0
    return _threshold(lambda share: touches(hand.posed(qpos, stroke.at(share))))


def _touches(hand: Hand, held: Collection[int]) -> Callable[[mujoco.MjData], bool]:
    pads = colliding_geoms(hand.model, moving_bodies(hand))
    return lambda data: gap_between(hand.model, data, pads, held) <= 0.0


def gap_between(model: mujoco.MjModel, data: mujoco.MjData, some: Collection[int], others: Collection[int]) -> float:
    """Return the least distance between two groups of geoms [m], at most 1 m."""
    gaps = [mujoco.mj_geomDistance(model, data, int(a), int(b), _FAR, None) for a in some for b in others]
    return min(gaps, default=_FAR)


class Pads:
    """The two pads beside the tool.

    The first is on the moving body nearest to the tool when the gripper is half open, the second on the nearest body on
    the other side of the tool. `closing` is the unit vector from the second to the first in the tool frame T, and
    `geoms` are their geoms nearest to the tool.

    Args:
        hand: The gripper.
        half: Its state when it is half open.

    Raises:
        UnsupportedError: If there are none.
    """

    def __init__(self, hand: Hand, half: mujoco.MjData) -> None:
        model, moving = hand.model, set(moving_bodies(hand))
        self._probe = probe = _Probe(hand)
        bodies = {int(model.body_weldid[b]) for b in hand.bodies}
        geoms = {
            root: [
                g for g in colliding_geoms(model, hand.bodies) if int(model.body_weldid[model.geom_bodyid[g]]) == root
            ]
            for root in bodies
        }
        near = {root: probe.nearest(half, mine) for root, mine in geoms.items() if mine}
        first = min((r for r in near if r in moving), key=lambda r: near[r].distance, default=None)
        away = np.zeros(3) if first is None else near[first].offset
        length = float(np.linalg.norm(away))
        closing = away / length if length > 0.0 else away
        across = [
            root
            for root, there in near.items()
            if root != first
            and (there.distance <= _ON or there.offset @ closing <= -_CONE * np.linalg.norm(there.offset))
        ]
        if first is None or length == 0.0 or not across:
            site = model.site(hand.tool).name
            raise UnsupportedError(
                f"the tool {site!r} is not between two fingers, so that an opening cannot be measured"
            )
        second = min(across, key=lambda r: near[r].distance)
        if second not in moving and near[second].distance > _ON:  # the direction of a fixed jaw does not change
            closing = -near[second].offset / np.linalg.norm(near[second].offset)
        self.closing: Float[Array, " xyz"] = closing @ half.site_xmat[hand.tool].reshape(3, 3)
        self.geoms = near[first].geom, near[second].geom
        self._groups = geoms[first], geoms[second]

    def offsets(self, data: mujoco.MjData) -> Float[Array, "2 xyz"]:
        """Return the vectors from the tool to the nearest points of the pads, in T [m]."""
        found = np.stack([self._probe.nearest(data, group).offset for group in self._groups])
        return np.asarray(found @ data.site_xmat[self._probe.tool].reshape(3, 3))

    def gap(self, data: mujoco.MjData) -> float:
        """Return the distance between the pads [m]."""
        first, second = self.offsets(data)
        return float((first - second) @ self.closing)


class _Near(NamedTuple):
    distance: float
    offset: Float[Array, " xyz"]
    """From the tool to the nearest point, in W [m]; if the tool is inside, to the nearest point of the surface."""
    geom: int


class _Probe:
    """Nearest points to the tool: a geom outside of the gripper in a copy of the model serves as a tiny sphere."""

    def __init__(self, hand: Hand) -> None:
        self.model, self.tool = copy.copy(hand.model), hand.tool
        self.geom = next(g for g in range(self.model.ngeom) if int(self.model.geom_bodyid[g]) not in hand.bodies)
        self.model.geom_type[self.geom] = int(mujoco.mjtGeom.mjGEOM_SPHERE)
        self.model.geom_size[self.geom] = _PROBE
        self.model.geom_rbound[self.geom] = _PROBE

    def nearest(self, data: mujoco.MjData, geoms: Collection[int]) -> _Near:
        """Return the nearest of some geoms."""
        place, found = data.site_xpos[self.tool].copy(), []
        data.geom_xpos[self.geom] = place
        for geom in geoms:
            ends = np.zeros(6)
            distance = mujoco.mj_geomDistance(self.model, data, self.geom, geom, _FAR, ends)
            found.append(_Near(float(distance), ends[3:] - place, geom))
        return min(found, key=lambda near: near.distance)
