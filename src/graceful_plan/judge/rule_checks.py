"""Whether a motion keeps its constraints, by means that planners do not use.

Where frames are comes from MuJoCo's kinematics, how they move from finite differences of the timed motion, and how a
liquid answers from a pendulum that is swung along it.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.path import Path
from graceful_plan.result import Check
from graceful_plan.scene.placement import Placement
from graceful_plan.scene.rules.rules import (
    AxisRule,
    BoxRule,
    ContentsRule,
    CustomRule,
    DistanceRule,
    GripRule,
    Rule,
    SpeedRule,
    StandsRule,
)
from graceful_plan.scene.rules.vessel import Vessel
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import Trajectory

Array = np.ndarray

_DT = (0.002, 0.004)
"""Between two samples of a trajectory [s], of short ones and of long ones: the fastest surfaces swing with 5 Hz."""
_SHORT = 1000
"""Intervals of a trajectory above which it is long."""
_SPACING = 0.004
"""Between two configurations of a path [rad]."""
_STRIDE = 8
"""Samples from one distance between meshes to the next."""
_ANGLE, _LENGTH, _SPEED = 1e-4, 1e-4, 1e-3
"""What a rule may be missed by: [rad], [m], share of the limit."""
_LOAD = 1e-3
"""Share of what a grasp carries, or of the slope on which something stands, that may be missed."""
_UPSIDE = 0.5 * np.pi - 1e-6
"""Beyond any slope on which something stands [rad]."""
_SETTLES = 0.5
"""How long a liquid is followed after the end [s]."""
_SWING = 0.001
"""Step of the pendulum [s]."""


@dataclass(frozen=True, eq=False)
class FrameMotion:
    """Where tool and carried object are along a motion."""

    scene: Scene
    q: Float[Array, "n nq"]
    at: Float[Array, " n"]
    """Time [s] of a trajectory, length [rad] of a path."""
    timed: bool

    @classmethod
    def along(cls, motion: Path | Trajectory, scene: Scene) -> FrameMotion:
        """Sample a motion evenly."""
        if isinstance(motion, Trajectory):
            dt = float(np.clip(motion.duration / _SHORT, *_DT))
            t = np.linspace(motion.t[0], motion.t[-1], max(2, int(np.ceil(motion.duration / dt)) + 1))
            return cls(scene, motion.at(t).q, t, timed=True)
        done = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(motion.q, axis=0), axis=1))])
        at = np.linspace(0.0, done[-1], max(2, int(np.ceil(done[-1] / _SPACING)) + 1))
        q = np.stack([np.interp(at, done, column) for column in motion.q.T], axis=1)
        return cls(scene, q, at, timed=False)

    @cached_property
    def poses(self) -> dict[str, Float[Array, "n 4 4"]]:
        """Poses in W of the frames "tool" and, where something is carried, "object" [m]."""
        scene, place = self.scene, Placement(self.scene)
        site = scene.model.site(scene.tool).id
        body = None if scene.carried is None else scene.model.body(scene.carried.body).id
        found = {"tool": np.tile(np.eye(4), (len(self.q), 1, 1))}
        if body is not None:
            found["object"] = found["tool"].copy()
        for k, q in enumerate(self.q):
            data = place.place(q)
            found["tool"][k, :3, :3], found["tool"][k, :3, 3] = data.site_xmat[site].reshape(3, 3), data.site_xpos[site]
            if body is not None:
                found["object"][k, :3, :3], found["object"][k, :3, 3] = data.xmat[body].reshape(3, 3), data.xpos[body]
        return found


def rule_checks(motion: Path | Trajectory, scene: Scene, rules: Iterable[Rule]) -> dict[str, Check]:
    """Return a check for each rule, by the name of its constraint: "contents", "upright", "tool_within"..."""
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
        checks[key] = _check(rule, frames)
    return checks


def _check(rule: Rule, frames: FrameMotion) -> Check:
    if isinstance(rule, AxisRule):
        angle = _angle(frames.poses[rule.frame][:, :3, :3] @ np.array(rule.axis), np.array(rule.direction))
        return _limit(angle, frames.at, rule.angle + _ANGLE, "angle [rad]")
    if isinstance(rule, BoxRule):
        at = (frames.poses["tool"][:, :3, 3] - rule.X_WB[:3, 3]) @ rule.X_WB[:3, :3]
        outside = np.maximum(np.array(rule.lower) - at, at - np.array(rule.upper)).max(axis=1)
        return _limit(outside, frames.at, _LENGTH, "distance of the tool from its box [m]")
    if isinstance(rule, DistanceRule):
        few = frames.at[::_STRIDE]
        near = rule.metres - _distances(frames.scene, frames.q[::_STRIDE], rule.entity, rule.metres)
        return _limit(near, few, _LENGTH, f"how much too near {rule.entity!r} [m]")
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


def _contents(rule: ContentsRule, frames: FrameMotion) -> Check:
    vessel, gravity = rule.vessel, -float(frames.scene.model.opt.gravity[2])
    X_WO, t = frames.poses["object"], frames.at
    axis = X_WO[:, :3, :3] @ vessel.axis
    surface = np.tile([0.0, 0.0, 1.0], (len(t), 1))
    if frames.timed and len(t) > 2:
        p = X_WO[:, :3, 3] + X_WO[:, :3, :3] @ vessel.p_BS
        dt = float(t[1] - t[0])
        acceleration = np.zeros_like(p)
        acceleration[1:-1] = np.diff(p, 2, axis=0) / dt**2
        rest = int(_SETTLES / dt)
        acceleration = np.concatenate([acceleration, np.zeros((rest, 3))])
        axis = np.concatenate([axis, np.repeat(axis[-1:], rest, axis=0)])
        t = np.concatenate([t, t[-1] + dt * np.arange(1, rest + 1)])
        felt = acceleration + [0.0, 0.0, gravity]
        surface = _swung(felt, vessel, dt) if vessel.repose == 0.0 else felt
    left = np.minimum(vessel.capacity(_angle(axis, surface)) / vessel.volume, 1.0)
    return _limit(1.0 - left, t, 1.0 - rule.part, "share of the contents that the surface leaves above the rim")


def _felt(frames: FrameMotion, point: Float[Array, " xyz"]) -> Float[Array, "n xyz"]:
    """Return what is felt at a point of the carried object, in its frame [m/s^2]: acceleration less gravity."""
    X_WO, t = frames.poses["object"], frames.at
    felt = np.tile([0.0, 0.0, -float(frames.scene.model.opt.gravity[2])], (len(t), 1))
    if frames.timed and len(t) > 2:
        p = X_WO[:, :3, 3] + X_WO[:, :3, :3] @ point
        felt[1:-1] += np.diff(p, 2, axis=0) / float(t[1] - t[0]) ** 2
    return np.einsum("nji,nj->ni", X_WO[:, :3, :3], felt)


def _grip(rule: GripRule, frames: FrameMotion) -> Check:
    """Follow the load on each pad: tangential force and torsion over what friction carries at its pressing force."""
    grip = rule.grip
    force = grip.mass * _felt(frames, grip.p_BC)
    moment = np.cross(grip.p_GC, force) @ grip.axes.T
    pushed, first, second = (force @ grip.axes.T).T
    by_friction = [not pressed for pressed in grip.pressed]
    h = float(grip.half[0])
    rims = [
        np.abs(moment[:, k]) / (grip.force * float(grip.half[3 - k])) if grip.pressed[k - 1] else np.zeros(len(moment))
        for k in (1, 2)
    ]
    loads = []
    for side in (0.5, -0.5):
        presses = np.maximum(0.5 * grip.force + side * pushed, 1e-9 * grip.force)
        along = 0.5 * first + side * moment[:, 2] / h * by_friction[1]
        across = 0.5 * second - side * moment[:, 1] / h * by_friction[0]
        turned = 0.5 * moment[:, 0] / grip.torsion if grip.torsion > 0.0 else np.zeros(len(moment))
        loads.append(np.hypot(np.hypot(along, across) / grip.friction, turned) / presses)
    load = np.max([*loads, *rims], axis=0)
    return _limit(load, frames.at, rule.share * (1.0 + _LOAD), "load on a pad, as a share of what it carries")


def _stands(rule: StandsRule, frames: FrameMotion) -> Check:
    felt = _felt(frames, np.array(rule.point))
    slope = np.tan(np.minimum(_angle(felt, np.array(rule.axis)), _UPSIDE))
    slides = rule.friction < rule.support
    detail = f"slope of what is felt where it {'slides' if slides else 'tips'} first"
    return _limit(slope, frames.at, min(rule.friction, rule.support) * (1.0 + _LOAD), detail)


def _swung(felt: Float[Array, "n xyz"], vessel: Vessel, dt: float) -> Float[Array, "n xyz"]:
    """Return the normal of a liquid's surface: opposite to a pendulum with the first mode's frequency and damping.

    Its bob is pulled against what is felt, `felt` [m/s^2], at even times `dt` apart [s].
    """
    R = vessel.radius
    depth, gravity = vessel.volume / (np.pi * R**2), float(np.linalg.norm(felt[0])) or 9.81
    length = R / (1.841 * np.tanh(1.841 * depth / R))
    drag = 2.0 * 4.98 / (2.0 * np.pi) * (1e-6) ** 0.5 * R**-0.75 * gravity**-0.25 * (gravity / length) ** 0.5
    steps = max(1, round(dt / _SWING))
    h = dt / steps
    x, y, z = (-felt[0] / np.linalg.norm(felt[0])).tolist()
    u = v = w = 0.0
    normals = []
    for fx, fy, fz in felt.tolist():
        normals.append((-x, -y, -z))
        for _ in range(steps):
            along = x * fx + y * fy + z * fz
            u += h * ((along * x - fx) / length - drag * u)
            v += h * ((along * y - fy) / length - drag * v)
            w += h * ((along * z - fz) / length - drag * w)
            x, y, z = x + h * u, y + h * v, z + h * w
            size = (x * x + y * y + z * z) ** 0.5
            x, y, z = x / size, y / size, z / size
            along = u * x + v * y + w * z
            u, v, w = u - along * x, v - along * y, w - along * z
    return np.array(normals)


def _distances(scene: Scene, q: Float[Array, "n nq"], entity: str, most: float) -> Float[Array, " n"]:
    """Return the exact distance of robot and carried object from an entity, as far as it is below `most` [m]."""
    model, place = scene.model, Placement(scene)
    mine = [g for name in ("body", "carried") if name in scene.components for g in scene.components[name].geoms]
    others, nearest, line = list(scene.entities[entity].geoms), np.full(len(q), most), np.zeros(6)
    for k, configuration in enumerate(q):
        data = place.place(configuration)
        for a in mine:
            for b in others:
                apart = np.linalg.norm(data.geom_xpos[a] - data.geom_xpos[b])
                if apart - model.geom_rbound[a] - model.geom_rbound[b] < nearest[k]:
                    nearest[k] = min(nearest[k], mujoco.mj_geomDistance(model, data, a, b, float(most), line))
    return nearest


def _limit(values: Float[Array, " n"], at: Float[Array, " n"], limit: float, detail: str) -> Check:
    worst = float(values.max())
    bad = np.flatnonzero(values > limit)
    first = float(at[bad[0]]) if len(bad) else None
    return Check(passed=not len(bad), worst=worst, limit=limit, first=first, detail=detail)


def _angle(a: Float[Array, "n xyz"], b: Float[Array, "*n xyz"]) -> Float[Array, " n"]:
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(axis=-1))


def _snake(name: str) -> str:
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()
