"""Objects whose restitution and inertia differ from their scenes."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import graceful_plan as gp
from failbench.calibrations import failure_jobs
from failbench.calibrations.failure_jobs import FailureJob, MotionKind, make_motion
from failbench.calibrations.failures import DROP, simulate_failures
from failbench.calibrations.varied import VARIED, Variation, bounce, spun
from failbench.rollouts.execution import execute
from failbench.simulated.world import SimSettings, build_world
from graceful_plan.exceptions import SettingError

_RADIUS, _HEIGHT = 0.035, 0.3


@pytest.fixture(scope="module")
def task() -> gp.Task:
    return gp.load_scene("desk").tasks["bring_coffee"]


def rebound(task: gp.Task, restitution: float) -> float:
    """Drop a sphere with a varied object's contact parameters on wood; return sqrt(rebound height / height)."""
    world = build_world(task.scene, SimSettings(grasp="weld"))
    bounce(world, Variation(restitution=(restitution, restitution)), seed=0)
    carried = int(np.flatnonzero(np.isin(world.model.geom_bodyid, world.striker_bodies["carried"]))[0])
    wood = world.model.geom("desk_top").id
    spec = mujoco.MjSpec()
    spec.option.timestep, spec.option.integrator = 0.002, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    plane = spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.0, 0.0, 1.0])
    body = spec.worldbody.add_body()
    body.add_freejoint()
    ball = body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[_RADIUS, 0.0, 0.0], density=1000.0)
    for geom, like in ((plane, wood), (ball, carried)):
        geom.solref, geom.solmix = world.model.geom_solref[like], world.model.geom_solmix[like]
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[2] = _RADIUS + _HEIGHT
    heights: list[float] = []
    for _ in range(400):
        mujoco.mj_step(model, data)
        heights.append(float(data.qpos[2]))
    lowest = int(np.argmin(heights[:160]))
    return float(np.sqrt((max(heights[lowest:]) - _RADIUS) / _HEIGHT))


@pytest.mark.parametrize("restitution", [0.1, 0.3, 0.6])
def test_the_carried_object_bounces_with_the_given_restitution(task: gp.Task, restitution: float) -> None:
    assert rebound(task, restitution) == pytest.approx(restitution, abs=0.04)


def test_nothing_else_bounces_otherwise(task: gp.Task) -> None:
    world, before = (build_world(task.scene, SimSettings(grasp="weld")) for _ in range(2))
    bounce(world, VARIED, seed=0)
    others = ~np.isin(world.model.geom_bodyid, world.striker_bodies["carried"])
    assert np.array_equal(world.model.geom_solref[others], before.model.geom_solref[others])
    assert np.array_equal(world.model.geom_solmix[others], before.model.geom_solmix[others])


@pytest.mark.long
def test_spin_changes_only_the_angular_velocity_of_the_carried_object(task: gp.Task) -> None:
    motion = make_motion(task, MotionKind(way="rrt_connect", speed=0.5), 1)
    assert motion is not None
    execution = execute(motion, build_world(task.scene, SimSettings(grasp="weld")))
    model, data = execution.world.model, mujoco.MjData(execution.world.model)
    added = spun(execution, Variation(spin=1.2), seed=3).states - execution.states
    velocities = []
    for state, change in zip(execution.states, added, strict=True):
        mujoco.mj_setState(model, data, state, int(mujoco.mjtState.mjSTATE_INTEGRATION))
        before = data.qvel.copy()
        mujoco.mj_setState(model, data, state + change, int(mujoco.mjtState.mjSTATE_INTEGRATION))
        velocities.append(data.qvel - before)
    dof = int(model.jnt_dofadr[model.body_jntadr[execution.world.carried_body]])
    angular = np.array(velocities)[:, dof + 3 : dof + 6]
    assert np.count_nonzero(added) == np.count_nonzero(velocities) == angular.size
    assert angular.std() == pytest.approx(1.2, rel=0.2)


@pytest.mark.long
def test_varied_objects_end_elsewhere_but_repeatably(task: gp.Task) -> None:
    motion = make_motion(task, MotionKind(way="rrt_connect", speed=0.5), 1)
    assert motion is not None
    plain, first, second = (
        simulate_failures(motion, task.scene, n=16, seed=2, variation=x) for x in (None, VARIED, VARIED)
    )
    assert np.array_equal(plain.q, first.q)
    assert not np.array_equal(plain.hit, first.hit)
    assert np.array_equal(first.hit, second.hit)


def test_every_second_motion_of_a_calibration_varies(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Variation | None] = []

    def not_done(job: FailureJob) -> str:
        asked.append(job.variation)
        return "not done"

    monkeypatch.setattr(failure_jobs, "run_job", not_done)
    for variation in (None, VARIED):
        asked.clear()
        _, about = failure_jobs.fetch(["desk"], lambda: DROP, failure_jobs.FailureSettings(n=2, variation=variation))
        assert set(asked[::2]) == {None} and set(asked[1::2]) == {variation}
        assert ("every_second_motion_varied" in about) is (variation is not None)


@pytest.mark.parametrize("wrong", [{"restitution": (0.6, 0.1)}, {"restitution": (0.1, 0.9)}, {"spin": -1.0}])
def test_impossible_settings_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(SettingError):
        Variation(**wrong)  # pyright: ignore[reportArgumentType]
