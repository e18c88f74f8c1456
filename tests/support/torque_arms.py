"""Arms for tests of joint torques."""

import numpy as np

import graceful_plan as gp

RAIL = """
<mujoco>
  <compiler angle="radian"/>
  <option gravity="0.3 -0.2 -9.81"/>
  <worldbody>
    <body name="arm/sled" pos="0 0 .3">
      <joint name="arm/rail" type="slide" axis="1 .2 0" range="-2 2" armature="3" damping="20"/>
      <geom type="box" size=".1 .1 .05" mass="8"/>
      <body name="arm/upper" pos="0 0 .1" euler=".3 0 0" {gravcomp}>
        <joint name="arm/shoulder" axis="0 1 .1" pos=".02 0 0" range="-3 3" armature=".4" damping="2" stiffness="5"
               {drives}/>
        <geom type="capsule" fromto="0 0 0 .5 0 .1" size=".04" mass="3"/>
        <body name="arm/lower" pos=".5 0 .1" {gravcomp}>
          <joint name="arm/elbow" axis="0 1 0" range="-3 3"/>
          <geom type="box" size=".2 .03 .05" pos=".2 0 0" euler=".2 .4 .1" mass="2"/>
          <body name="arm/slider" pos=".4 0 0">
            <joint name="arm/reach" type="slide" axis="1 0 .3" range="-.5 .5"/>
            <geom type="sphere" size=".05" mass=".7"/>
            <body name="arm/hand" pos=".1 0 0">
              <joint name="arm/wrist" axis="1 1 0" range="-3 3"/>
              <geom type="box" size=".06 .03 .02" pos=".06 .02 0" mass=".5"/>
              <body name="arm/finger" pos=".1 0 0">
                <joint name="arm/grip" type="slide" axis="0 1 0" range="0 .05"/>
                <geom type="box" size=".03 .01 .01" mass=".2"/>
              </body>
              <site name="arm/tip" pos=".15 0 0"/>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>"""


def odd_arm(gravcomp="", drives="", torque=None):
    """Make an arm on a rail, with hinges, slides, a spring and a finger that is not planned."""
    return gp.Scene.from_mjcf(
        RAIL.format(gravcomp=gravcomp, drives=drives), robot="arm/", tool="arm/tip",
        velocity=[1.0] * 5, acceleration=[5.0] * 5, torque=torque,
    )  # fmt: skip


def states(scene, n, seed=0):
    """Return random positions within the limits, velocities and accelerations."""
    rng = np.random.default_rng(seed)
    lower, upper = scene.limits.position.T
    q = rng.uniform(lower, upper, (n, len(lower)))
    return q, rng.normal(size=q.shape), 4.0 * rng.normal(size=q.shape)


LIFTER = """
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <body name="arm/link" pos="0 0 1">
      <joint name="arm/turn" axis="0 -1 0" range="-1.5 1.5"/>
      <geom type="capsule" fromto="0 0 0 1 0 0" size=".02" mass="1"/>
      <site name="arm/tip" pos="1 0 0"/>
    </body>
    <body name="brick" pos="1 0 1"><freejoint/><geom type="box" size=".05 .05 .05" mass="12"/></body>
  </worldbody>
</mujoco>"""
HOLDS = 9.81 * (0.5 * 1.0 + 1.0 * 12.0)
"""Torque that holds link and brick level [N m]; the brick is carried at the tip."""


def lifter(torque, velocity=1.0, acceleration=0.1):
    """Make an arm with one joint that carries the brick."""
    return gp.Scene.from_mjcf(
        LIFTER, robot="arm/", tool="arm/tip", torque=None if torque is None else [torque],
        velocity=[velocity], acceleration=[acceleration],
    ).attach("brick", X_TO=gp.FROM_ABOVE)  # fmt: skip
