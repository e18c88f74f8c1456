"""Configurations that spheres prove free are free by exact geometry, so verdicts equal those of an exact judge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.mesh_arm import mesh_arm

from graceful_plan import VerificationSettings, plan
from graceful_plan.core.compile import compile_scene
from graceful_plan.exceptions import SettingError
from graceful_plan.judge.exact import Judge, motion_violations
from graceful_plan.judge.motion_samples import PROVED, motion_samples
from graceful_plan.judge.verification import verify
from graceful_plan.path import Path
from graceful_plan.query.arguments import checked_verification
from graceful_plan.result import PlanStatus
from graceful_plan.scene.loading.bundled import load_scene
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.retiming import retime
from graceful_plan.timing.trajectory import Trajectory

_SCENES = ("tabletop", "dining_table", "kitchen_counter", "desk", "mesh_arm")


def _in_hand(name: str) -> Scene:
    """A bundled scene with the object of its first task attached, or an arm whose links are meshes."""
    if name == "mesh_arm":
        return mesh_arm()
    return next(iter(load_scene(name).tasks.values())).scene


def _skipped_wrongly(scene: Scene, count: int, seed: int) -> tuple[int, int]:
    """Count configurations that the spheres prove free, and those of them that exact geometry refuses.

    Half of the configurations are random; half lie on short motions around near contacts, where a hole in a cover
    would show.
    """
    rng = np.random.default_rng(seed)
    clearance = compile_scene(scene).proof.clearance
    lower, upper = scene.limits.position.T
    q = rng.uniform(lower, upper, (count, len(lower)))
    near = q[np.argsort(np.abs(clearance(q)))[: count // 10]]
    close = np.repeat(near, 5, axis=0) + rng.normal(scale=0.03, size=(5 * len(near), len(lower)))
    q = np.concatenate([q[: count // 2], np.clip(close, lower, upper)])
    proved = clearance(q) > PROVED
    return int(proved.sum()), sum(1 for _ in Judge(scene).touches(q[proved]))


@pytest.mark.parametrize("name", [*_SCENES[:-1], pytest.param("mesh_arm", marks=pytest.mark.long)])
def test_nothing_that_touches_is_proved_free(name: str) -> None:
    proved, wrong = _skipped_wrongly(_in_hand(name), 2500, seed=1)
    assert proved > 300 and wrong == 0


@pytest.mark.long
@pytest.mark.parametrize("name", [*_SCENES[:-1], pytest.param("mesh_arm", marks=pytest.mark.long)])
def test_nothing_that_touches_is_proved_free_among_a_million(name: str) -> None:
    scene = _in_hand(name)
    for seed in range(8):
        proved, wrong = _skipped_wrongly(scene, 25_000, seed=100 + seed)
        assert proved > 3000 and wrong == 0


def _motions(scene: Scene, count: int) -> list[Trajectory]:
    rng = np.random.default_rng(2)
    lower, upper = scene.limits.position.T
    q = rng.uniform(lower, upper, (4000, len(lower)))
    q = q[compile_scene(scene).kernels.clearance(q) > 0.01][: 2 * count].reshape(count, 2, -1)
    return [retime(Path(ends), scene.limits, scene.joints) for ends in q]


def test_verdicts_equal_those_of_exact_geometry(task) -> None:
    scene = task.scene
    clearance = compile_scene(scene).proof.clearance
    refused = 0
    for motion in _motions(scene, 5):
        exact, fast = verify(motion, scene), verify(motion, scene, clearance=clearance)
        assert fast.passed == exact.passed
        assert fast.checks["collision"].first == exact.checks["collision"].first
        assert fast.checks["collision"].worst == exact.checks["collision"].worst
        refused += "collision" in exact.failures
    assert 0 < refused < 5


def test_samples_are_the_same_with_a_proof_and_without(task) -> None:
    motion = _motions(task.scene, 1)[0]
    clearance = compile_scene(task.scene).kernels.clearance
    with_, without = (motion_samples(motion, task.scene, 0.005, bound) for bound in (clearance, None))
    np.testing.assert_array_equal(with_.q, without.q)
    assert with_.proved.any() and not without.proved.any()


def test_a_bound_also_proves_the_neighbours_of_a_sample_and_nothing_that_touches(task) -> None:
    clearance, asked, samples_in_all = compile_scene(task.scene).proof.clearance, 0, 0

    def counting(q: np.ndarray) -> np.ndarray:
        nonlocal asked
        asked += len(q)
        return clearance(q)

    touching = 0
    for motion in _motions(task.scene, 10):
        samples = motion_samples(motion, task.scene, 0.005, counting)
        own = clearance(samples.q) > PROVED
        assert np.all(samples.proved[own]), "all that the bound itself proves"
        touching += len({touch.sample for touch in Judge(task.scene).touches(samples.q)})
        assert not list(Judge(task.scene).touches(samples.q[samples.proved]))
        samples_in_all += len(samples.q)
    assert touching > 50 and asked < 0.8 * samples_in_all


def test_a_wrong_proof_is_found_out_and_no_longer_believed(task, caplog: pytest.LogCaptureFixture) -> None:
    """A proof that claims everything is free fails at the samples that are checked anyway."""
    motion = next(m for m in _motions(task.scene, 25) if len(motion_violations(m, task.scene, 0.002)[0]) > 200)
    violations, samples = motion_violations(motion, task.scene, 0.002, lambda q: np.full(len(q), 1.0))
    assert violations == motion_violations(motion, task.scene, 0.002)[0]
    assert not samples.proved.any() and "wrong" in caplog.text


def test_a_limit_exceeded_between_two_samples_is_found(task) -> None:
    scene = task.scene
    q = np.repeat(task.start[None], 2, axis=0)
    upper = scene.limits.position[0, 1]
    q[:, 0] = upper - 1e-4
    qd = np.zeros_like(q)
    qd[:, 0] = 0.1, -0.1
    trajectory = Trajectory(np.array([0.0, 0.4]), q, qd, np.zeros_like(q), scene.joints)
    found = verify(trajectory, scene).checks["position_limits"]
    assert not found.passed
    # The cubic's maximum is in the middle, h v / 4 above its ends.
    assert found.worst == pytest.approx(0.4 * 0.1 / 4.0 - 1e-4, rel=1e-6)
    inside = replace(trajectory, q=np.where(np.arange(q.shape[1]) == 0, upper - 0.0101, q))
    assert verify(inside, scene).checks["position_limits"].passed


def test_plan_verifies_with_the_given_resolution(task) -> None:
    def judged(verification: VerificationSettings | None) -> str:
        result = plan(task.start, task.goal, task.scene, w=0.0, iterations=50, verification=verification)
        assert result.status is PlanStatus.SOLVED and result.verdict is not None
        return result.verdict.checks["collision"].detail

    assert "proved" in judged(None)
    assert "proved" not in judged(VerificationSettings(everywhere=True))
    coarse, fine = (int(judged(VerificationSettings(step=step)).split()[0]) for step in (0.01, 0.001))
    assert fine > 5 * coarse


def test_settings_are_checked(task) -> None:
    with pytest.raises(SettingError, match=r"step"):
        VerificationSettings(step=0.0)
    with pytest.raises(SettingError, match=r"step"):
        verify(Path(task.start[None]), task.scene, step=np.nan)
    with pytest.raises(SettingError, match=r"verification"):
        checked_verification(0.002)
