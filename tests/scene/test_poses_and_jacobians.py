"""Poses and Jacobians of frames against MuJoCo and finite differences."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.exceptions import NonFiniteError, ShapeError, UnknownNameError
from graceful_plan.scene.scene import Scene

_TOLERANCE = 1e-9
"""Of poses [m]: both sides compute in doubles."""
_STEP = 1e-6
"""Of central differences [rad or m]."""


@pytest.fixture(params=["desk", "kitchen_counter", gp.mobile_scenes()[0]], scope="module")
def scene(request: pytest.FixtureRequest) -> Scene:
    """Scenes of an arm with an object in the gripper, and one of a robot that drives."""
    found = gp.load_scene(request.param)
    return found if found.base else next(iter(found.tasks.values())).scene


def _random(scene: Scene, n: int) -> np.ndarray:
    lower, upper = np.clip(scene.limits.position.T, -3.0, 3.0)
    return np.random.default_rng(0).uniform(lower, upper, (n, len(scene.joints)))


def test_every_frame_is_where_mujoco_puts_it(scene: Scene) -> None:
    model, q = scene.model, _random(scene, 3)
    frames = [(model.body(b).name, "body") for b in range(1, model.nbody)]
    frames += [(model.site(s).name, "site") for s in range(model.nsite)]
    for k, row in enumerate(q):
        data = scene.data_at(row)
        for name, kind in frames:
            if not name or (kind == "body" and name in {model.site(s).name for s in range(model.nsite)}):
                continue
            at = data.body(name) if kind == "body" else data.site(name)
            X = scene.pose(q, name)[k]
            np.testing.assert_allclose(X[:3, 3], at.xpos, atol=_TOLERANCE, err_msg=name)
            np.testing.assert_allclose(X[:3, :3], at.xmat.reshape(3, 3), atol=_TOLERANCE, err_msg=name)


def test_jacobians_are_the_derivatives_of_poses(scene: Scene) -> None:
    q = _random(scene, 4)
    for frame in (None, *([scene.carried.body] if scene.carried else [])):
        jacobian, R = scene.jacobian(q, frame), scene.pose(q, frame)[:, :3, :3]
        for k in range(q.shape[1]):
            there, back = (scene.pose(q + sign * _STEP * np.eye(q.shape[1])[k], frame) for sign in (1.0, -1.0))
            change = (there - back) / (2.0 * _STEP)
            np.testing.assert_allclose(jacobian[:, :3, k], change[:, :3, 3], atol=1e-7)
            spin = change[:, :3, :3] @ R.transpose(0, 2, 1)  # skew-symmetric
            omega = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1)
            np.testing.assert_allclose(jacobian[:, 3:, k], omega, atol=1e-7)


def test_the_jacobian_of_the_tool_is_mujocos() -> None:
    scene = gp.load_scene("desk")
    site, dofs = scene.model.site(scene.tool).id, [int(scene.model.jnt_dofadr[j]) for j in scene.joint_ids]
    for q in _random(scene, 3):
        moved, turned = np.empty((3, scene.model.nv)), np.empty((3, scene.model.nv))
        mujoco.mj_jacSite(scene.model, scene.data_at(q), moved, turned, site)
        np.testing.assert_allclose(scene.jacobian(q), np.vstack([moved, turned])[:, dofs], atol=_TOLERANCE)


def test_moved_obstacles_have_moved_frames() -> None:
    scene = gp.load_scene("desk")
    box = scene.add_box("crate", [0.1] * 3, [0.0, 2.0, 1.0]).edit(move={"crate": [0.0, 3.0, 1.0]})
    np.testing.assert_allclose(box.pose(np.zeros(len(scene.joints)), "crate")[:3, 3], [0.0, 3.0, 1.0])


def test_batches_have_any_leading_axes() -> None:
    scene = gp.load_scene("desk")
    q = _random(scene, 6).reshape(2, 3, -1)
    assert scene.pose(q).shape == (2, 3, 4, 4) and scene.jacobian(q).shape == (2, 3, 6, q.shape[-1])
    np.testing.assert_array_equal(scene.pose(q)[1, 2], scene.pose(q[1, 2]))
    assert scene.pose(q[:0]).shape == (0, 3, 4, 4)


def test_misuse_is_named() -> None:
    scene = gp.load_scene("desk")
    with pytest.raises(UnknownNameError, match="wrist_99"):
        scene.pose(np.zeros(len(scene.joints)), "wrist_99")
    with pytest.raises(ShapeError):
        scene.jacobian(np.zeros(2))
    with pytest.raises(NonFiniteError):
        scene.pose(np.full(len(scene.joints), np.nan))
