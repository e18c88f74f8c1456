"""Reference implementations in the benchmarks of FailBench."""

import dataclasses

import numpy as np
import pytest
from benchmarks.subjects import drop_prediction, failbench_speed
from motions import Drop, Shake, execution

import failbench
import graceful_plan as gp
from failbench import RolloutRequest

# --- speed ------------------------------------------------------------------------------------------------------------


def test_the_plain_loop_does_the_same_rollouts():
    done = execution()
    jobs = [RolloutRequest(fault=fault, onset=0.5 * done.duration, seed=3) for fault in (Drop(), Shake(ramp=0.1))]
    rollouts = failbench.run_rollouts(done, jobs, horizon=failbench_speed.HORIZON)
    for anew in (False, True):
        for rollout in rollouts:
            assert failbench_speed.same(rollout, failbench_speed.plain_rollout(done, rollout.job, anew=anew))
    assert not failbench_speed.same(*(dataclasses.replace(rollout, job=jobs[0]) for rollout in rollouts))


def test_time_is_attributed_to_the_right_stage():
    done, timing = execution(), failbench_speed.Timing()
    jobs = [RolloutRequest(fault=Drop(), onset=0.2, seed=0)]
    failbench_speed._time(timing, 1, lambda: failbench.run_rollouts(done, jobs, horizon=0.2))
    assert set(timing.parts) == {"simulation", "recorder"}
    assert 0.0 < timing.parts["recorder"] and 0.0 < timing.parts["simulation"]
    assert sum(timing.parts.values()) < timing.seconds


# --- drop prediction --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "tall"), [("pass_bottle", True), ("serve_cake", False)])
def test_a_lying_bottle_is_not_tall(name: str, tall: bool) -> None:
    task = gp.load_scene("dining_table").tasks[name]
    assert drop_prediction.is_tall(task.scene, task.start) is tall
    lying = task.start.copy()
    lying[-2] -= np.pi / 2  # the wrist tips the object
    assert not drop_prediction.is_tall(task.scene, lying)
