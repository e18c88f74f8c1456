"""Checks of rules against slow twins: distances of every pair of geoms, loads by cross products, NaN."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.judge.rule_checks import (  # pyright: ignore[reportPrivateUsage]
    FrameMotion,
    _distances,
    _grip,
    rule_checks,
)
from graceful_plan.path import Path
from graceful_plan.scene.placement import Placement
from graceful_plan.scene.rules.grip import Grip
from graceful_plan.scene.rules.rules import CustomRule, GripRule, StandsRule
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.retiming import retime

Array = np.ndarray


def _motion(task: gp.Task, seed: int = 0) -> gp.Trajectory:
    """Return a motion from the start to a nearby configuration, and back."""
    away = np.asarray(task.start) + np.random.default_rng(seed).uniform(-0.4, 0.4, len(task.scene.joints))
    path = Path(np.stack([task.start, away, task.start]))
    return retime(path, task.scene.limits, joints=task.scene.joints)


def test_distances_are_the_least_of_all_pairs(task: gp.Task) -> None:
    scene = task.scene
    rng = np.random.default_rng(2)
    q = np.asarray(task.start) + rng.uniform(-0.8, 0.8, (12, len(scene.joints)))
    placement, mine = Placement(scene), [g for n in ("body", "carried") for g in scene.components[n].geoms]
    near = 0
    for name, entity in scene.entities.items():
        found = _distances(scene, q, name, 0.25)
        for k, configuration in enumerate(q):
            data = placement.place(configuration)
            pairs = [(a, b) for a in mine for b in entity.geoms]
            wanted = min(mujoco.mj_geomDistance(scene.model, data, a, b, 0.25, None) for a, b in pairs)
            assert found[k] == pytest.approx(wanted, abs=1e-9)
            near += wanted < 0.25
    assert 10 < near < 12 * len(scene.entities)


def test_samples_are_two_a_piece_within_bounds(task: gp.Task) -> None:
    motion = _motion(task)
    for asked, wanted in ((0.003, 0.002), (0.006, 0.003), (0.02, 0.004)):
        pieces = motion.sample(motion.duration / round(motion.duration / asked))
        frames = FrameMotion.along(pieces, task.scene)
        assert np.ptp(np.diff(frames.at)) < 1e-12
        assert frames.dt == pytest.approx(wanted, rel=0.02)
        np.testing.assert_allclose(frames.q, pieces.at(frames.at).q, atol=1e-12)
    still = gp.Trajectory(motion.t[:1], motion.q[:1], motion.qd[:1], motion.qdd[:1], motion.joints)
    assert (FrameMotion.along(still, task.scene).q == motion.q[0]).all()


def _felt(motion: gp.Trajectory, scene: Scene, frames: FrameMotion, point: Array) -> Array:
    """Return the specific force at a point of the carried object, in its frame, by differences of placements."""
    assert scene.carried is not None
    placement, body, p, R = Placement(scene), scene.model.body(scene.carried.body).id, [], []
    for q in motion.at(frames.at).q:
        data = placement.place(q)
        R.append(data.xmat[body].reshape(3, 3).copy())
        p.append(data.xpos[body] + R[-1] @ point)
    felt = np.zeros((len(p), 3))
    felt[1:-1] = np.diff(p, 2, axis=0) / np.diff(frames.at)[0] ** 2
    return np.stack([r.T @ (a + [0.0, 0.0, 9.81]) for r, a in zip(R, felt, strict=True)])


@pytest.mark.parametrize("half", [[0.03, 0.01, 0.02], [0.03, 0.05, 0.001], [0.03, 1e-4, 1e-4]])
def test_loads_on_pads_equal_those_of_a_slow_twin(half: list[float]) -> None:
    task = gp.load_scene("desk").tasks["bring_coffee"]
    motion = _motion(task)
    turn = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
    grip = Grip(
        mass=0.4,
        p_GC=np.array([0.01, -0.02, 0.03]),
        p_BC=np.array([0.0, 0.01, 0.05]),
        axes=turn * np.linalg.det(turn),
        half=np.array(half),
        friction=0.8,
        torsion=0.004,
        force=60.0,
        approach=2.0,
    )
    frames = FrameMotion.along(motion, task.scene)
    loads = []
    for felt in _felt(motion, task.scene, frames, grip.p_BC):
        force, moment = grip.axes @ (0.4 * felt), grip.axes @ np.cross(grip.p_GC, 0.4 * felt)
        rims = [abs(moment[k]) / (60.0 * half[3 - k]) for k in (1, 2) if grip.pressed[k - 1]]
        for side in (1.0, -1.0):
            pull = 0.5 * force[1:]
            if not grip.pressed[1]:
                pull = pull + side * np.array([moment[2], 0.0]) / (2.0 * half[0])
            if not grip.pressed[0]:
                pull = pull - side * np.array([0.0, moment[1]]) / (2.0 * half[0])
            presses = 0.5 * (60.0 + side * force[0])
            loads.append(max([np.hypot(np.hypot(*pull) / 0.8, 0.5 * moment[0] / 0.004) / presses, *rims]))
    check = _grip(GripRule(name="GraspHolds", grip=grip, share=0.8), frames)
    assert check.worst == pytest.approx(max(loads), rel=1e-5)


def test_specific_forces_on_a_tray_equal_those_of_a_slow_twin() -> None:
    task = gp.load_scene("desk").tasks["bring_coffee"]
    motion, point = _motion(task, 1), (0.02, -0.01, 0.06)
    frames = FrameMotion.along(motion, task.scene)
    felt = _felt(motion, task.scene, frames, np.array(point))
    rule = StandsRule(name="Stands", point=point, axis=(0.0, 0.0, 1.0), friction=0.1, support=0.5)
    (check,) = rule_checks(motion, task.scene, [rule]).values()
    assert check.worst == pytest.approx((np.hypot(felt[:, 0], felt[:, 1]) / felt[:, 2]).max(), rel=1e-5)


def test_nan_is_a_violation(task: gp.Task) -> None:
    def residual(q: Array) -> Array:
        return np.where(np.arange(len(q)) == 3, np.nan, -1.0)

    rule = CustomRule(name="Odd", residual=residual, told=lambda worst: f"{worst}")
    check = rule_checks(_motion(task), task.scene, [rule])["odd"]
    assert not check.passed and check.first is not None and check.first > 0.0


@pytest.mark.parametrize("share", [0.3, 0.5, 0.7])
def test_the_rest_of_a_motion_spills_as_the_whole_one_does(share: float) -> None:
    task = gp.load_scene("desk").tasks["bring_coffee"]
    line = gp.Path(np.stack([task.start, np.atleast_2d(task.goal)[0]]))
    motion = gp.retime(line, task.scene.limits, task.scene.joints, speed=0.5)
    rest = motion.since(share * motion.duration)
    whole = gp.verify(motion, task.scene).checks["contents"]
    assert whole.first > share * motion.duration  # it spills while the arm brakes
    begun = motion.at(rest.t[0])
    part = gp.verify(rest, task.scene, start=begun, before=motion).checks["contents"]
    assert part.worst == pytest.approx(whole.worst, abs=1e-3)
    assert part.first == pytest.approx(whole.first, abs=0.01)
    calm = gp.verify(rest, task.scene, start=begun).checks["contents"]
    assert calm.worst < 0.5 * whole.worst
