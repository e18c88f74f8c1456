"""Whom a robot drives into, with every geom measured at every moment: slow, and without any bound."""

from __future__ import annotations

import mujoco
import numpy as np

from graceful_plan.judge import passing_by
from graceful_plan.scene.placement import Placement


def dense_passing(motion, scene):
    """Return the least clearance [m], no more than 1, to whom, and the first time of an overlap [s]."""
    t = passing_by._times(motion, scene)
    state = motion.at(t)
    model = passing_by._with_walkers(scene)
    placement, robot = Placement(scene, model), passing_by._robot_geoms(scene)
    worst, whom, first = 1.0, "", np.inf
    for name, entity in scene.moving.items():
        geom, mocap = int(model.body_geomadr[model.body(name).id]), int(model.body_mocapid[model.body(name).id])
        there = entity.at(t)
        for k in np.flatnonzero(passing_by.is_moving(state.qd)):
            half = 0.5 * float(there.yaw[k])
            placement.data.mocap_pos[mocap] = there.position[k]
            placement.data.mocap_quat[mocap] = [np.cos(half), 0.0, 0.0, np.sin(half)]
            data = placement.place(state.q[k])
            distance = min(mujoco.mj_geomDistance(model, data, own, geom, 1.0, None) for own in robot)
            if distance < 0.0:
                first = min(first, float(t[k]))
            if distance < worst:
                worst, whom = distance, name
    return worst, whom, first
