"""Failures simulated in a plain loop that records everything from which signatures of faults are read."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from motions import EVERY_DEGREE, execution

from failbench import Fault, RolloutRequest, SimSettings, rollout_steps

SETTINGS = SimSettings()
WELD = SimSettings(grasp="weld")


@dataclass(frozen=True, kw_only=True)
class Nothing(Fault):
    """A fault without effect."""

    NAME = "nothing"
    CATEGORY = "actuator"
    PARAMETER = "nothing"
    AMOUNTS = EVERY_DEGREE

    def apply(self, plant, level):
        pass


def healthy_run(settings=SETTINGS):
    return execution("tabletop", "green_to_blue", settings)


class Record:
    """Records of one rollout, a row per step: states after it, forces and commands during it."""

    def __init__(self, fault, *, when=0.5, horizon=0.4, seed=0, done=None):
        done = healthy_run() if done is None else done
        robot, self.dt = done.world.robot, done.dt
        carried, tool = done.world.carried_body, done.world.model.site(done.world.scene.tool).id
        self.job = RolloutRequest(fault=fault, onset=when * done.duration, seed=seed)
        self.robot, self.onset_step = robot, 5 * done.checkpoint(self.job.onset)
        rows = {name: [] for name in ("q", "qd", "force", "command", "tool", "object", "gain", "limit", "bias", "all")}
        for model, data in rollout_steps(done, self.job, horizon=horizon):
            self.model, self.data = model, data
            rows["q"].append(data.qpos[robot.qpos])
            rows["qd"].append(data.qvel[robot.dofs])
            rows["force"].append(data.actuator_force.copy())
            rows["command"].append(data.ctrl.copy())
            rows["tool"].append(data.site_xpos[tool].copy())
            rows["object"].append(data.xpos[carried].copy())
            rows["gain"].append(model.actuator_gainprm[:, 0].copy())
            rows["limit"].append(model.actuator_forcerange[:, 1].copy())
            rows["bias"].append(data.qfrc_bias[robot.dofs])
            rows["all"].append(data.qpos.copy())
        for name, values in rows.items():
            setattr(self, name, np.array(values))
        self.t = self.dt * np.arange(1, len(self.q) + 1)
        start = done.states[done.checkpoint(self.job.onset)]
        before = mujoco.MjData(done.world.model)
        mujoco.mj_setState(done.world.model, before, start, mujoco.mjtState.mjSTATE_INTEGRATION)
        self.q0, self.qd0 = before.qpos[robot.qpos], before.qvel[robot.dofs]

    @property
    def struck(self):
        """Joints with the fault."""
        fault = self.job.fault
        return self.robot.struck(fault.targets or fault.TARGETS, np.random.default_rng(self.job.seed))[0]

    @property
    def slip(self):
        """Distance of the object from its first position in the tool's frame."""
        beside = self.object - self.tool
        return np.linalg.norm(beside - beside[0], axis=1)


def joint(number):
    """Return the name of a joint of the arm, counted from 1."""
    return (healthy_run().world.robot.joints[number - 1],)
