"""Fixtures for tests of annotations."""

import pytest

import graceful_plan as gp
from support.annotation.model_server import ModelServer, guesses

ROOM = """
<mujoco><worldbody>
  <body name="arm/base"><geom type="box" size=".05 .05 .05" pos="0 0 -1"/>
    <body name="arm/slide"><joint name="arm/x" type="slide" axis="1 0 0" range="-1 1"/>
      <geom type="box" size=".02 .02 .02" pos="0 0 1"/><site name="arm/tool" pos="0 0 .9"/></body></body>
  <body name="floor"><geom type="plane" size="0 0 .1" pos="0 0 -1.05"/></body>
  <body name="vase" pos=".5 .1 0"><geom type="sphere" size=".1"/></body>
  <body name="mug" pos="-.5 .1 0"><freejoint/><geom type="cylinder" size=".1 .2" mass=".3"/></body>
  <body name="inside" pos=".5 .1 0"><geom type="sphere" size=".05"/></body>
</worldbody></mujoco>"""


@pytest.fixture(scope="session")
def room():
    """A small room with a vase, a mug, an infinite floor, and an object hidden inside the vase."""
    entities = {"floor": "floor", "vase": "heirloom", "mug": "glass", "inside": "robust"}
    return gp.Scene.from_mjcf(
        ROOM, robot="arm/", tool="arm/tool", velocity=[1.0], acceleration=[1.0], entities=entities, name="room"
    )


@pytest.fixture
def server():
    """A server that guesses by names; its `replies` may be replaced."""
    with ModelServer(guesses) as running:
        yield running
