import mujoco
import numpy as np
import pytest

import graceful_plan as gp
from failbench.mobile.coasting import BaseFailure, coasted
from failbench.mobile.wheeled import wheeled
from graceful_plan.exceptions import UnknownNameError, UnsupportedError
from graceful_plan.scene.mobile.known_bases import known_base
from hall import hall
from jackals import jackal


def test_the_model_has_the_published_mass_and_size():
    model = jackal().model
    assert float(model.body_subtreemass[model.body("jackal/base").id]) == pytest.approx(16.523 + 4 * 0.477)
    left, right = (model.body(f"jackal/front_{side}").pos for side in ("left", "right"))
    assert left[1] - right[1] == pytest.approx(known_base("jackal").track)
    with pytest.raises(UnknownNameError, match="jackal"):
        known_base("tricycle")


@pytest.mark.parametrize("omega", [1.0, 2.0])
def test_turning_in_place_slips_as_published(omega):
    wheels = wheeled(jackal())
    data = wheels.placed(np.zeros(3), 0.0, 0.0)
    data.ctrl[:] = wheels.wheel_rates(0.0, omega)
    for _ in range(2000):
        mujoco.mj_step(wheels.model, data)
    assert wheels.base.slip * omega / data.qvel[wheels.dof + 5] == pytest.approx(1.5, abs=0.15)
    assert abs(data.qpos[wheels.qpos + 2]) < 2e-3  # wheels do not sink


FRONT = 0.229 - 0.035
"""Distance of a Jackal's front wheels ahead of its pivot [m]."""


def reach(failure, v):
    """Return how far a base gets, to 10 cm, from the farthest child in a row that it still hits."""
    far, at = 0.0, 0.1
    while at < 4.0:
        hits = coasted(wheeled(jackal((at + 0.2 + FRONT, 0.0))), np.zeros(3), np.array([v, 0.0, 0.0]), failure)
        if not hits:
            return far
        far, at = at, at + 0.1
    return far


@pytest.mark.parametrize(
    ("failure", "v", "expected"),
    [
        (BaseFailure("released", 0.8, 0.4, 0.0), 1.0, 1.0 / 0.4 - 0.8 / 0.16 * np.log1p(0.5)),
        pytest.param(BaseFailure("released", 0.8, 0.4, 0.0), 2.0, 5.0 - 5.0 * np.log1p(1.0), marks=pytest.mark.long),
        (BaseFailure("locked", 5.4, 0.0, 0.0), 2.0, 4.0 / 10.8),
        (BaseFailure("driven", 1.5, 0.0, 0.25), 1.0, 0.25 + 1.0 / 3.0),
    ],
)
def test_a_failing_base_covers_the_closed_form_distance(failure, v, expected):
    assert reach(failure, v) == pytest.approx(expected, abs=0.11)


def test_hits_are_reported_once_with_speed_and_time():
    scene = jackal((1.0, 0.0), (5.0, 3.0))
    (hit,) = coasted(wheeled(scene), np.zeros(3), np.array([1.5, 0.0, 0.0]), BaseFailure("driven", 1.0, 0.0, 2.0))
    assert hit.entity == 0
    assert hit.speed == pytest.approx(1.5, abs=0.05) and hit.time == pytest.approx((1.0 - 0.2 - 0.229) / 1.5, abs=0.05)


def test_a_grazing_hit_has_the_speed_along_the_normal():
    scene = jackal((1.0, 0.35))  # the child is 35 cm off the path, near the side of the base
    (hit,) = coasted(wheeled(scene), np.zeros(3), np.array([1.5, 0.0, 0.0]), BaseFailure("driven", 1.0, 0.0, 2.0))
    assert 0.2 < hit.speed < 1.4


def test_an_arm_is_held_and_stairs_are_no_wall():
    scene = gp.load_scene("kitchen")
    wheels, q = wheeled(scene), scene.keyframes["at_stove"]
    data = wheels.placed(q, 0.0, 0.0)
    mujoco.mj_step(wheels.model, data, nstep=500)
    np.testing.assert_allclose(wheels.pose(data), q[:3], atol=5e-3)
    held = [float(data.joint(name).qpos[0]) for name in scene.joints[3:]]
    np.testing.assert_allclose(held, q[3:], atol=0.02)
    model = wheeled(gp.load_scene("apartment")).model
    assert model.geom("keep_out_stairs").contype == model.geom("keep_out_stairs").conaffinity == 0


def test_robots_without_wheels_are_refused():
    with pytest.raises(UnsupportedError, match="wheels"):
        wheeled(hall())
    with pytest.raises(UnsupportedError, match="DiffDrive"):
        wheeled(hall(None))
    with pytest.raises(UnsupportedError, match="carried"):
        wheeled(gp.load_scene("apartment").tasks["serve_tea"].scene)
