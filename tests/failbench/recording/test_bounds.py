import numpy as np
import pytest

import graceful_plan as gp
from failbench import build_world
from failbench.recording.bounds import Bounds

ROOM = """
<mujoco><worldbody>
  <body name="base" pos="-2 0 0"><body name="link"><joint name="yaw" axis="0 0 1" range="-1 1"/>
    <geom size="0.05"/><site name="tool"/></body></body>
  <body name="drawer" pos="0 0 0.5"><joint name="drawer" type="slide" axis="1 0 0" range="0 1"/>
    <geom type="box" size="0.1 0.1 0.02"/></body>
  <body name="tray" pos="0 1 0.5"><freejoint/><geom type="box" size="0.1 0.1 0.01"/>
    <body name="cup" pos="0 0 0.06"><geom type="cylinder" size="0.03 0.05"/></body></body>
  <body name="shelf" pos="0 2 0.5"><geom type="box" size="0.1 0.1 0.02"/></body>
  <body name="ball" pos="0 -1 1"><freejoint/><geom size="0.05"/></body>
</worldbody><actuator><position joint="yaw" kp="10"/></actuator></mujoco>
"""


@pytest.mark.parametrize(
    ("struck", "moved", "far"),
    [("drawer", {"drawer": [0.8]}, True), ("cup", {"tray": [1.0, 1.0, 0.5]}, True), ("shelf", {}, False)],
)
def test_moved_objects_are_searched_at_their_place(struck, moved, far):
    names = ("drawer", "tray", "cup", "shelf", "ball")
    scene = gp.Scene.from_mjcf(
        ROOM,
        robot="base",
        tool="tool",
        velocity=[1.0],
        acceleration=[1.0],
        entities=dict.fromkeys(names, "glass"),
    )
    world = build_world(scene)
    model = world.model
    qpos = model.qpos0.copy()

    def put(name, values):
        adr = model.jnt_qposadr[model.body_jntadr[model.body(name).id]]
        qpos[adr : adr + len(values)] = values

    for name, values in moved.items():
        put(name, values)
    put("ball", {"drawer": [0.8, 0.0, 0.55], "cup": [1.0, 1.0, 0.6], "shelf": [0.0, 2.0, 0.55]}[struck])
    bounds = Bounds(world)
    mover = list(world.movable).index("ball")
    known = np.zeros((1, 5, 5), dtype=bool)
    zero = np.array([0])
    near = bounds.overlap(qpos[None, None], zero, zero, np.array([mover]), known)
    assert names.index(struck) in near[:, 3]
    put("ball", [5.0, 5.0, 5.0])
    away = bounds.overlap(qpos[None, None], zero, zero, np.array([mover]), known)
    assert (names.index(struck) in away[:, 3]) == far  # an object of unknown position is always checked
