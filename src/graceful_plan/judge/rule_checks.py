"""Checks of constraints along a motion, with methods that planners do not use.

Poses come from the judge's own kinematics, velocities and accelerations from finite differences of the timed motion,
and the response of a liquid from a pendulum driven by it.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.judge import _pendulum
from graceful_plan.judge.kinematics import cross_matrix, kinematics
from graceful_plan.judge.preparation import own_placement
from graceful_plan.judge.torque_check import MANY, torque_check
from graceful_plan.path import Path
from graceful_plan.result import Check
from graceful_plan.scene.per_scene import per_layout
from graceful_plan.scene.rules.grip import AdhesiveGrip
from graceful_plan.scene.rules.rules import (
    FRAMES,
    AxisRule,
    BoxRule,
    ContentsRule,
    CustomRule,
    DistanceRule,
    FrameRule,
    GripRule,
    Rule,
    SpeedRule,
    StandsRule,
    TorqueRule,
)
from graceful_plan.scene.rules.vessel import Vessel
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import Trajectory

_DT = (0.002, 0.004)
"""Least and greatest time between two samples of a trajectory [s]. Joint accelerations are linear on a piece, which
half of the shortest piece resolves; the fastest liquid surfaces swing at 5 Hz."""
_SHORT = 1000
"""Number of intervals above which a trajectory counts as long."""
_SPACING = 0.004
"""Distance between two configurations of a path [rad]."""
_STRIDE = 8
"""Stride of the samples at which mesh distances are measured."""
_ANGLE, _LENGTH, _SPEED = 1e-4, 1e-4, 1e-3
"""Tolerances of the constraints: [rad], [m], relative to the limit."""
_LOAD = 1e-3
"""Relative tolerance of the load of a grasp, and of the slope on which an object stands."""
_UPSIDE = 0.5 * np.pi - 1e-6
"""Clamp of the slope angle, beyond any slope on which an object stands [rad]."""
_ROUNDING = 1e-9
"""Rounding error of positions [m]."""
_SETTLES = 0.5
"""Time for which a liquid is simulated after the end [s]."""


@dataclass(frozen=True, eq=False)
class FrameMotion:
    """Poses of tool and carried object along a motion."""

    scene: Scene
    q: Float[Array, "n nq"]
    at: Float[Array, " n"]
    """Time [s] of a trajectory, length [rad] of a path."""
    timed: bool

    @classmethod
    def along(cls, motion: Path | Trajectory, scene: Scene) -> FrameMotion:
        """Sample a motion at equal steps."""
        if isinstance(motion, Trajectory):
            shortest = float(np.diff(motion.t).min(initial=np.inf))
            dt = min(max(0.5 * shortest, motion.duration / _SHORT, _DT[0]), _DT[1])
            t = np.linspace(motion.t[0], motion.t[-1], max(2, int(np.ceil(motion.duration / dt)) + 1))
            return cls.at_times(motion, scene, t)
        done = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(motion.q, axis=0), axis=1))])
        at = np.linspace(0.0, done[-1], max(2, int(np.ceil(done[-1] / _SPACING)) + 1))
        q = np.stack([np.interp(at, done, column) for column in motion.q.T], axis=1)
        return cls(scene, q, at, timed=False)

    @classmethod
    def at_times(cls, motion: Trajectory, scene: Scene, t: Float[Array, " n"]) -> FrameMotion:
        """Sample a motion at equal steps of time [s]; it rests at its ends before and after."""
        q = motion.at_places(np.interp(t, motion.t, np.arange(len(motion))))[1]
        return cls(scene, q, t, timed=True)

    @cached_property
    def poses(self) -> dict[str, Float[Array, "n 4 4"]]:
        """Poses in W of the frames "tool" and, if something is carried, "object" [m]."""
        known = kinematics(self.scene)
        poses = known.poses(self.q, known.held)
        return dict(zip(FRAMES, poses, strict=False))

    @cached_property
    def dt(self) -> float:
        """Time between two samples, which is constant [s]."""
        return float(self.at[-1] - self.at[0]) / (len(self.at) - 1)

    def felt(self, point: Float[Array, " xyz"]) -> Float[Array, "n xyz"]:
        """Return the felt acceleration (acceleration minus gravity) at a point of the carried object, in W [m/s^2]."""
        if self.timed:
            return _felt(_at(self.poses["object"], point), self.dt, self.scene)
        return _felt(np.zeros((len(self.q), 3)), 1.0, self.scene)


def rule_checks(
    motion: Path | Trajectory, scene: Scene, rules: Iterable[Rule], before: Trajectory | None = None
) -> dict[str, Check]:
    """Return a check for each rule, by the name of its constraint: "contents", "upright", "tool_within"...

    Args:
        motion: The motion to check.
        scene: The scene.
        rules: The rules.
        before: Motion up to the start of a trajectory, by which liquids swing there; None: they are calm.
    """
    asked = list(rules)
    frames = FrameMotion.along(motion, scene) if asked else None
    checks: dict[str, Check] = {}
    for rule in asked:
        assert frames is not None
        name = "contents" if isinstance(rule, ContentsRule) else _snake(rule.name)
        key, again = name, 1
        while key in checks:
            again += 1
            key = f"{name}_{again}"
        if isinstance(rule, TorqueRule):
            checks[key] = torque_check(motion, scene, rule.share, MANY)
        elif isinstance(rule, ContentsRule) and before is not None and isinstance(motion, Trajectory):
            checks[key] = _contents_after(rule, before, motion, scene)
        else:
            checks[key] = _check(rule, frames)
    return checks


def _check(rule: FrameRule, frames: FrameMotion) -> Check:
    if isinstance(rule, AxisRule):
        angle = _angle(_along(frames.poses[rule.frame], np.array(rule.axis)), np.array(rule.direction))
        return _limit(angle, frames.at, rule.angle + _ANGLE, "angle [rad]")
    if isinstance(rule, BoxRule):
        at = (frames.poses["tool"][:, :3, 3] - rule.X_WB[:3, 3]) @ rule.X_WB[:3, :3]
        outside = np.maximum(np.array(rule.lower) - at, at - np.array(rule.upper)).max(axis=1)
        return _limit(outside, frames.at, _LENGTH, "distance of the tool from its box [m]")
    if isinstance(rule, DistanceRule):
        few = frames.at[::_STRIDE]
        near = rule.metres - _distances(frames.scene, frames.q[::_STRIDE], rule.entity, rule.metres)
        return _limit(near, few, _LENGTH, f"distance below the minimum to {rule.entity!r} [m]")
    if isinstance(rule, SpeedRule):
        return _speed(rule, frames)
    if isinstance(rule, CustomRule):
        residual = np.asarray(rule.residual(frames.q))
        return _limit(residual, frames.at, _LENGTH, rule.told(float(residual.max())))
    if isinstance(rule, GripRule):
        return _grip(rule, frames)
    if isinstance(rule, StandsRule):
        return _stands(rule, frames)
    return _contents(rule, frames)


def _speed(rule: SpeedRule, frames: FrameMotion) -> Check:
    if not frames.timed:
        return Check(passed=True, worst=0.0, limit=rule.limit, detail="a path has no speed")
    p, t = frames.poses["tool"][:, :3, 3], frames.at
    speed = np.linalg.norm(np.diff(p, axis=0), axis=1) / np.maximum(np.diff(t), 1e-12)
    if rule.near is not None:
        distance = _distances(frames.scene, frames.q[:-1:_STRIDE], rule.near, rule.within)
        speed = np.where(np.repeat(distance < rule.within - _LENGTH, _STRIDE)[: len(speed)], speed, 0.0)
    return _limit(speed, t[:-1], rule.limit * (1.0 + _SPEED), "speed of the tool [m/s]")


def _contents(rule: ContentsRule, frames: FrameMotion, earlier: Float[Array, "m xyz"] | None = None) -> Check:
    """Check that contents stay in.

    Args:
        rule: The rule.
        frames: The motion.
        earlier: Felt acceleration at the same steps before the motion, by which a liquid swings [m/s^2].
    """
    vessel, X_WO, t = rule.vessel, frames.poses["object"], frames.at
    axis = _along(X_WO, vessel.axis)
    felt = frames.felt(vessel.p_BS)
    if frames.timed and len(t) > 2:
        rest = int(_SETTLES / frames.dt)
        felt = np.concatenate([felt, np.tile(felt[-1], (rest, 1))])
        axis = np.concatenate([axis, np.tile(axis[-1], (rest, 1))])
        t = np.concatenate([t, t[-1] + frames.dt * np.arange(1, rest + 1)])
        if earlier is not None:
            felt[0] = felt[1]  # the robot does not start from rest
        if vessel.repose == 0.0 and felt[0].any():
            known = felt[:0] if earlier is None else earlier
            felt = _swung(np.concatenate([known, felt]), vessel, frames.dt)[len(known) :]
    left = np.minimum(vessel.capacity(_angle(axis, felt)) / vessel.volume, 1.0)
    return _limit(1.0 - left, t, 1.0 - rule.part, "share of the contents above the rim")


def _contents_after(rule: ContentsRule, before: Trajectory, motion: Trajectory, scene: Scene) -> Check:
    """Check that contents stay in after another motion, by which a liquid swings."""
    begins, dt = float(motion.t[0]), _DT[1]
    t = begins + dt * np.arange(max(2, int(np.ceil(motion.duration / dt)) + 1))
    earlier = _felt_earlier(scene, before, begins, tuple(rule.vessel.p_BS.tolist()))
    return _contents(rule, FrameMotion.at_times(motion, scene, t), earlier)


@per_layout(most=2)
def _felt_earlier(
    scene: Scene, before: Trajectory, until: float, point: tuple[float, ...]
) -> Float[Array, "m xyz"] | None:
    """Return the felt acceleration at a point of the object along a motion, in steps up to a time, which is left out.

    Many candidates follow the same motion. None if it has no three steps.
    """
    steps = int((until - before.t[0]) / _DT[1])
    if steps < 3:
        return None
    t = until - _DT[1] * np.arange(steps, -1, -1)
    q = before.at_places(np.interp(t, before.t, np.arange(len(before))))[1]
    return _felt(kinematics(scene).held_point(q, np.array(point)), _DT[1], scene)[:-1]


def _felt(p: Float[Array, "n xyz"], dt: float, scene: Scene) -> Float[Array, "n xyz"]:
    """Return the felt acceleration of a point from its positions in W at equal time steps [m/s^2]."""
    felt = np.zeros_like(p)
    if len(p) > 2:
        np.subtract(p[2:], 2.0 * p[1:-1] - p[:-2], out=felt[1:-1])
        felt *= dt**-2
    felt[:, 2] -= float(scene.shapes.opt.gravity[2])
    return felt


def _swung(felt: Float[Array, "n xyz"], vessel: Vessel, dt: float) -> Float[Array, "n xyz"]:
    """Compute the normal of a liquid surface: opposite to a pendulum with the first mode's frequency and damping.

    The bob is pulled against the felt acceleration `felt` [m/s^2], sampled at equal time steps `dt` [s].
    """
    R, gravity = vessel.radius, float(np.linalg.norm(felt[0]))
    depth = vessel.volume / (np.pi * R**2)
    length = R / (1.841 * np.tanh(1.841 * depth / R))
    drag = 2.0 * 4.98 / (2.0 * np.pi) * (1e-6) ** 0.5 * R**-0.75 * gravity**-0.25 * (gravity / length) ** 0.5
    return _pendulum.swung(felt, dt=dt, length=float(length), drag=float(drag))


def _felt_by(frames: FrameMotion, point: Float[Array, " xyz"]) -> Float[Array, "n xyz"]:
    """Return the felt acceleration at a point of the carried object, in its frame [m/s^2]."""
    return np.einsum("nji,nj->ni", frames.poses["object"][:, :3, :3], frames.felt(point))


def _grip(rule: GripRule, frames: FrameMotion) -> Check:
    """Compute the load on a disc, or on each pad: tangential force and torsion relative to friction at its force."""
    grip = rule.grip
    felt = _felt_by(frames, grip.p_BC)
    if isinstance(grip, AdhesiveGrip):
        load = _load_on_disc(grip, felt)
        return _limit(load, frames.at, rule.share * (1.0 + _LOAD), "load, relative to what breaks the grip")
    pushed, first, second = grip.mass * grip.axes @ felt.T
    about = grip.mass * grip.axes @ cross_matrix(grip.p_GC) @ felt.T
    h = float(grip.half[0])
    # Moments about the axes across that pressure cannot bear are borne by friction, opposite on the two pads.
    aside, load = np.zeros((2, len(felt))), np.zeros(len(felt))
    for k in (1, 2):
        if grip.pressed[k - 1]:
            load = np.maximum(load, np.abs(about[k]) / (grip.force * float(grip.half[3 - k])))
        else:
            aside[k - 1] = about[k] / h
    turned = np.square(0.5 * about[0] / grip.torsion) if grip.torsion > 0.0 else 0.0
    for side in (0.5, -0.5):
        slips = np.square(0.5 * first + side * aside[1]) + np.square(0.5 * second - side * aside[0])
        presses = np.maximum(0.5 * grip.force + side * pushed, 1e-9 * grip.force)
        load = np.maximum(load, np.sqrt(slips / grip.friction**2 + turned) / presses)
    return _limit(load, frames.at, rule.share * (1.0 + _LOAD), "load on a pad, relative to its capacity")


def _load_on_disc(grip: AdhesiveGrip, felt: Float[Array, "n xyz"]) -> Float[Array, " n"]:
    """Return the load on a disc relative to what takes the object off, peels it off over the rim, or makes it slip."""
    pulled, first, second = grip.mass * grip.axes @ felt.T
    turning, one, other = grip.mass * grip.axes @ cross_matrix(grip.p_GC) @ felt.T
    peels = np.hypot(one, other) / grip.radius
    slips = np.sqrt((first**2 + second**2) / grip.friction**2 + (turning / grip.torsion) ** 2)
    return np.maximum(pulled + np.maximum(peels, slips), 0.0) / grip.force


def _stands(rule: StandsRule, frames: FrameMotion) -> Check:
    felt = _felt_by(frames, np.array(rule.point))
    slope = np.tan(np.minimum(_angle(felt, np.array(rule.axis)), _UPSIDE))
    slides = rule.friction < rule.support
    detail = f"slope of the felt acceleration; the object {'slides' if slides else 'tips'} first"
    return _limit(slope, frames.at, min(rule.friction, rule.support) * (1.0 + _LOAD), detail)


def _distances(scene: Scene, q: Float[Array, "n nq"], entity: str, most: float) -> Float[Array, " n"]:
    """Compute the exact distance of robot and carried object from an entity, clamped to `most` [m]."""
    model, known = scene.model, kinematics(scene)
    mine = [g for name in ("body", "carried") if name in scene.components for g in scene.components[name].geoms]
    others = list(scene.entities[entity].geoms)
    p = known.poses(q, known.geoms[mine]).transpose(1, 0, 2, 3)[..., None, :3, 3] - known.geoms.X_WF[others, :3, 3]
    # Bounding spheres, less a rounding error: pairs that they keep farther apart than `most` are not measured.
    spheres = model.geom_rbound[mine][:, None] + model.geom_rbound[others]
    apart = np.sqrt(np.square(p).sum(axis=-1)) - spheres - _ROUNDING
    nearest, place, line = np.full(len(q), most), own_placement(scene).place, np.zeros(6)
    for k in np.flatnonzero((apart < most).any(axis=(1, 2))).tolist():
        data = place(q[k])
        for i, j in np.argwhere(apart[k] < most).tolist():
            if apart[k, i, j] < nearest[k]:
                distance = mujoco.mj_geomDistance(model, data, mine[i], others[j], float(most), line)
                nearest[k] = min(nearest[k], distance)
    return nearest


def _limit(values: Float[Array, " n"], at: Float[Array, " n"], limit: float, detail: str) -> Check:
    worst = float(values.max())
    bad = np.flatnonzero(~(values <= limit))  # a NaN violates the limit, too
    first = float(at[bad[0]]) if len(bad) else None
    return Check(passed=not len(bad), worst=worst, limit=limit, first=first, detail=detail)


def _at(X: Float[Array, "n 4 4"], point: Float[Array, " xyz"]) -> Float[Array, "n xyz"]:
    """Return the positions of a point of a moving frame [m]."""
    return (X.reshape(-1, 4) @ np.append(point, 1.0)).reshape(-1, 4)[:, :3]


def _along(X: Float[Array, "n 4 4"], axis: Float[Array, " xyz"]) -> Float[Array, "n xyz"]:
    """Return the directions of an axis of a moving frame."""
    return (X.reshape(-1, 4) @ np.append(axis, 0.0)).reshape(-1, 4)[:, :3]


def _angle(a: Float[Array, "n xyz"], b: Float[Array, "*n xyz"]) -> Float[Array, " n"]:
    (x, y, z), (u, v, w) = a.T, b.T
    sine = np.square(y * w - z * v)
    sine += np.square(z * u - x * w)
    sine += np.square(x * v - y * u)
    return np.arctan2(np.sqrt(sine), x * u + y * v + z * w)


def _snake(name: str) -> str:
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()
