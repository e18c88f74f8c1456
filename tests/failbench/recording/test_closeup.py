import mujoco
import numpy as np
from motions import ARM, SERVO

import graceful_plan as gp
from failbench import build_world
from failbench.recording.contact_query import ContactQuery


def test_a_slight_contact_has_the_approach_speed():
    """MuJoCo's normal between cylinder and box may flip at overlaps of some nanometres."""
    scene = gp.Scene.from_mjcf(
        ARM.format(fingers="", actuators=SERVO),
        robot="base",
        tool="tool",
        velocity=[2.0],
        acceleration=[5.0],
        entities={"vase": "glass", "block": "robust"},
    )
    world = build_world(scene)
    closeup = ContactQuery(world)
    model, data = closeup.model, closeup.data
    vase, block = (world.movable[name] for name in ("vase", "block"))
    adr, dof = (int(a[model.body_jntadr[vase]]) for a in (model.jnt_qposadr, model.jnt_dofadr))
    geoms = model.geom("block").id, model.geom("vase").id
    qvel = np.zeros(model.nv)
    qvel[dof + 2] = -2.0
    rng = np.random.default_rng(0)
    flipped = 0
    for _ in range(100):
        qpos, ends = model.qpos0.copy(), np.zeros(6)
        quat = rng.normal(size=4)
        qpos[adr : adr + 7] = [*data.xpos[block][:2], 1.0, *(quat / np.linalg.norm(quat))]
        closeup.place(qpos)
        mujoco.mj_geomDistance(model, data, *geoms, 2.0, ends)
        qpos[adr : adr + 2] += model.body_pos[block][:2] - ends[3:5]  # lowest point above the block's centre
        closeup.place(qpos)
        qpos[adr + 2] -= mujoco.mj_geomDistance(model, data, *geoms, 2.0, ends) + 1e-8
        closeup.place(qpos, qvel)
        touch = closeup.touch(0, 1)
        if touch is None:  # within the error of the distance
            continue
        flipped += closeup.normal(0, 1)[2] > 0.0
        assert abs(touch.speed - 2.0) < 1e-6
    assert flipped  # otherwise the case was not tested
