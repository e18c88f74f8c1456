"""A turning boom with a gripper that points down: a linkage, a jaw against a fixed one, slides, or a vacuum cup."""

from __future__ import annotations

from typing import Any

import numpy as np

import graceful_plan as gp

_SIDE = """
<body name="g/{name}_driver" pos="0 {driver} .055" quat="{turned}">
  <joint name="g/{name}_driver" axis="1 0 0" range="0 .8" armature=".005" damping=".1"/>
  <geom type="capsule" fromto="0 0 0 0 .03 -.004" size=".006" mass=".02" contype="0" conaffinity="0"/>
  <body name="g/{name}_coupler" pos="0 .0315 -.004">
    <joint name="g/{name}_coupler" axis="1 0 0" range="-1.5 0" armature=".001"/>
    <geom type="capsule" fromto="0 0 0 0 .006 .047" size=".006" mass=".02" contype="0" conaffinity="0"/>
  </body>
</body>
<body name="g/{name}_rocker" pos="0 {rocker} .0614" quat="{turned}">
  <joint name="g/{name}_rocker" axis="1 0 0" range="-.3 .9" stiffness=".05" springref="2.5" damping=".001"/>
  <geom type="capsule" fromto="0 0 0 0 .037 .044" size=".005" mass=".02" contype="0" conaffinity="0"/>
  <body name="g/{name}_finger" pos="0 .037 .044">
    <joint name="g/{name}_finger" axis="1 0 0" range="-.9 .9" damping=".001"/>
    <geom name="g/{name}_pad" type="box" pos="0 -.009 .038" size=".011 .004 .019" mass=".03" condim="4"/>
  </body>
</body>"""
LINKAGE = (
    '<site name="g/tool" pos="0 0 .145"/>'
    + _SIDE.format(name="left", driver="-.0306", rocker="-.0127", turned="0 0 0 1")
    + _SIDE.format(name="right", driver=".0306", rocker=".0127", turned="1 0 0 0")
)
LINKAGE_TIES = """<tendon><fixed name="split">
  <joint joint="g/left_driver" coef=".5"/><joint joint="g/right_driver" coef=".5"/></fixed></tendon>
<equality>
  <connect name="left" body1="g/left_finger" body2="g/left_coupler" anchor="0 .0184 -.0074" solref=".005 1"/>
  <connect name="right" body1="g/right_finger" body2="g/right_coupler" anchor="0 .0184 -.0074" solref=".005 1"/>
  <joint joint1="g/left_driver" joint2="g/right_driver" solref=".005 1"/>
</equality>"""
LINKAGE_DRIVE = '<position name="g/grip" tendon="split" kp="100" kv="10" forcerange="-5 5"/>'

JAW = """<site name="g/tool" pos="0 0 .1"/>
<geom name="g/fixed" type="box" pos="0 -.03 .08" size=".01 .005 .03" mass=".05" condim="4"/>
<body name="g/jaw" pos="0 .04 0"><joint name="g/jaw" axis="1 0 0" range="-.9 .4" armature=".001"/>
  <geom name="g/moving" type="box" pos="0 0 .08" size=".01 .005 .03" mass=".05" condim="4"/></body>"""
JAW_DRIVE = '<position name="g/grip" joint="g/jaw" kp="40" kv="1" forcerange="-4 4"/>'

SLIDES = """<site name="g/tool" pos="0 0 .1"/>
<body name="g/left" pos="0 .005 .08"><joint name="g/left" type="slide" axis="0 1 0" range="0 .04" damping="5"/>
  <geom type="box" size=".01 .005 .03" mass=".05" condim="4"/></body>
<body name="g/right" pos="0 -.005 .08"><joint name="g/right" type="slide" axis="0 1 0" range="-.04 0" damping="5"/>
  <geom type="box" size=".01 .005 .03" mass=".05" condim="4"/></body>"""

CUP = """<site name="g/tool" pos="0 0 .04"/>
<geom name="g/disc" type="cylinder" size=".025 .005" pos="0 0 .035" mass=".05"/>"""

_ARM = """<mujoco><compiler angle="radian"/><worldbody>
  <body name="vase" pos=".4 0 .1"><geom type="cylinder" size=".04 .1"/></body>
  <body name="block" pos="-1 0 .5"><freejoint/>
    <geom type="box" size=".02 .02 .06" mass=".3" friction="1 .005 .0001"/></body>
  <body name="a/turn" pos="0 0 .7"><joint name="a/turn" axis="0 0 1" range="-3 3"/>
    <geom type="capsule" fromto=".05 0 0 .33 0 0" size=".03" mass="2"/>
    <body name="g/palm" pos=".4 0 0" quat="0 1 0 0">
      <geom type="cylinder" size=".03 .01" pos="0 0 .02" mass=".3"/>{gripper}</body></body>
</worldbody>{ties}<actuator>
  <position joint="a/turn" kp="3000" kv="100" forcerange="-200 200"/>{drive}
</actuator></mujoco>"""

START, GOAL = [-0.8], [0.8]


def armed(gripper: str, ties: str = "", drive: str = "", **changes: Any) -> gp.Scene:
    """Return the arm with a gripper and its drive."""
    given = {"robot": "a/", "tool": "g/tool", "velocity": [2.0], "acceleration": [6.0], "entities": {"vase": "glass"}}
    return gp.Scene.from_mjcf(_ARM.format(gripper=gripper, ties=ties, drive=drive), **(given | changes))


def linkage(**changes: Any) -> gp.Scene:
    """Return the arm with a linkage: drivers, couplers that springs hold at their stops, rockers, fingers."""
    return armed(LINKAGE, LINKAGE_TIES, LINKAGE_DRIVE, **changes)


def below(metres: float) -> np.ndarray:
    """Return a grasp with the object's origin below the tool."""
    X_TO = gp.FROM_ABOVE.copy()
    X_TO[2, 3] = metres
    return X_TO
