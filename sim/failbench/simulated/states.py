"""MuJoCo integration states that FailBench stores at checkpoints, to start simulations from."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager

import mujoco
from mujoco.batch import Batch

from graceful_plan.array_types import Array, Float

STATE = mujoco.mjtState.mjSTATE_INTEGRATION
CHECKPOINT = 5
"""Steps between checkpoints."""


def put(batch: Batch, sims: Array, states: Float[Array, "sim state"]) -> None:
    """Set simulations of a batch to states and clear everything else they hold."""
    batch.reset(sims, stage=int(mujoco.mjtStage.mjSTAGE_NONE))
    batch.state[sims] = states


def control_spec(model: mujoco.MjModel) -> int:
    """Return the part of the state that simulations receive at each step: commands, and poses of moving entities."""
    spec = int(mujoco.mjtState.mjSTATE_CTRL)
    walk = int(mujoco.mjtState.mjSTATE_MOCAP_POS) | int(mujoco.mjtState.mjSTATE_MOCAP_QUAT)
    return spec | walk if model.nmocap else spec


@contextmanager
def warnings_counted_only() -> Generator[None, None, None]:
    """Keep MuJoCo from writing its log into the working directory; each simulation counts its own warnings."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)
