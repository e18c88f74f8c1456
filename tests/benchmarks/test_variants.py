from __future__ import annotations

import numpy as np
import pytest

import failbench as fb
import graceful_plan as gp
from benchmarks import landing, variants
from failbench.fault.end_effector import StuckGripper
from graceful_plan.exceptions import UnknownNameError
from graceful_plan.judge.reference_cost import reference_probability
from sizes import first_quick

NAMES = list(variants.VARIANTS)
_SETTLES = 0.003
"""Standing objects sink into soft contacts and tilt by less than this [m]."""


def test_every_bundled_scene_has_a_variant() -> None:
    assert {variant.base for variant in variants.VARIANTS.values()} == set(gp.scenes())
    assert len(NAMES) >= 6


def test_unknown_variants_are_refused() -> None:
    with pytest.raises(UnknownNameError, match="tabletop_turned"):
        variants.load("no_such_variant")


@pytest.mark.parametrize("name", first_quick(NAMES))
def test_nothing_is_in_anything_else(name: str) -> None:
    assert variants.problems(variants.load(name)) == []


@pytest.mark.parametrize("name", first_quick(NAMES))
def test_a_variant_differs_from_its_scene(name: str) -> None:
    variant, scene = variants.VARIANTS[name], variants.load(name)
    base = gp.load_scene(variant.base)
    assert not set(variant.remove) & set(scene.entities)
    assert set(variant.add) <= set(scene.entities)
    moved = [
        body
        for body in set(scene.entities) & set(base.entities)
        if not np.allclose(scene.model.body(body).pos, base.model.body(body).pos, atol=1e-3)
    ]
    assert len(moved) >= 3
    ends = [end for task in base.tasks.values() for end in (task.start, *task.goal)]
    for task in scene.tasks.values():
        for end in (task.start, *task.goal):
            assert min(np.abs(end - other).max() for other in ends) > 0.02


@pytest.mark.parametrize("name", first_quick(NAMES))
def test_objects_stay_at_rest(name: str) -> None:
    task = next(iter(variants.load(name).tasks.values()))
    scene, world = task.scene, fb.build_world(task.scene)
    execution = fb.execute(gp.Path(np.stack([task.start, task.start + 1e-3])), world)
    jobs = [fb.RolloutRequest(fault=StuckGripper(closed=True), onset=0.0, seed=0)]  # a stuck gripper disturbs nothing
    (rollout,) = fb.run_rollouts(execution, jobs)
    for entity, body in world.movable.items():
        home = scene.home_qpos[scene.model.jnt_qposadr[scene.model.body_jntadr[body]] :][:3]
        assert np.abs(rollout.poses[entity][4:] - home).max() < _SETTLES, entity


@pytest.mark.parametrize("name", first_quick(NAMES))
def test_tasks_can_be_done(name: str) -> None:
    for task in variants.load(name).tasks.values():
        result = gp.plan(
            task.start, task.goal, task.scene, constraints=(), w=0.0, planner="rrt_connect", iterations=2000, speed=0.5
        )
        assert result.status is gp.PlanStatus.SOLVED, f"{task.name}: {result.status}"


# --- Algorithm 1, aimed ----------------------------------------------------------------------------------------------


def _states(n: int = 12) -> tuple[gp.Scene, np.ndarray, np.ndarray]:
    task = gp.load_scene("dining_table").tasks["pass_bottle"]
    u = np.linspace(0.0, 1.0, n)[:, None]
    return task.scene, task.start + u * (task.goal[0] - task.start), np.tile(task.goal[0] - task.start, (n, 1))


def test_at_rest_the_aimed_model_is_algorithm_1() -> None:
    scene, q, qd = _states()
    aimed = landing.landed_probability(scene, q, 0.0 * qd)
    assert np.allclose(aimed, reference_probability(scene, q, ["carried"])[:, 0], atol=1e-9)


def test_the_aimed_model_is_algorithm_1_at_the_landing_place() -> None:
    """For a lone box below the object, shifting the box by the object's flight has the same effect."""
    rest = gp.load_scene("tabletop_l1").tasks["green_to_blue"]
    bare, still = rest.scene, rest.start
    body = bare.model.body("green").id
    data = bare.data_at(still)
    speed = np.zeros(len(still))
    speed[0] = 0.4  # the first axis is vertical, so the flight is at right angles to the lever
    lever = data.xipos[body] - data.xanchor[bare.model.joint(bare.joints[0]).id]
    velocity = np.cross([0.0, 0.0, 0.4], lever)
    low = data.xipos[body][2] - 0.03 * np.abs(data.xmat[body].reshape(3, 3)[2]).sum()
    top = 0.2
    time = np.sqrt(2.0 * (low - top) / landing.GRAVITY)
    centre = data.xipos[body][:2] + velocity[:2] * time

    def with_box(xy: np.ndarray) -> gp.Scene:
        return bare.add_box("below", [0.05, 0.05, 0.05], [*xy, top - 0.05], entity="glass")

    offset = np.array([0.03, -0.04])
    aimed = landing.landed_probability(with_box(centre + offset), still[None], speed[None])[0, -1]
    plain = reference_probability(with_box(data.xipos[body][:2] + offset), still[None], ["carried"])[0, 0, -1]
    assert 0.0 < plain < 1.0
    assert aimed == pytest.approx(plain, abs=1e-6)
