"""Short motions and simple faults for tests of FailBench."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import graceful_plan as gp
from failbench import Execution, Fault, SimSettings, World, build_world, execute

ARM = """
<mujoco><compiler angle="radian"/><option timestep="0.001"/>
  <worldbody>
    <geom name="floor" type="plane" size="2 2 0.1"/>
    <body name="vase" pos="0.5 0 0.1"><freejoint/><geom name="vase" type="cylinder" size="0.03 0.1"/></body>
    <body name="base" pos="0 0 0.5">
      <body name="link"><joint name="shoulder" axis="0 1 0" range="-2 2"/>
        <geom name="link" type="capsule" size="0.02" fromto="0 0 0 0.3 0 0"/>
        <site name="tool" pos="0.32 0 0"/>
        {fingers}
      </body>
    </body>
    <body name="block" pos="0 0.5 0.02"><freejoint/><geom name="block" type="box" size="0.02 0.02 0.02"/></body>
  </worldbody>
  <actuator>{actuators}</actuator>
</mujoco>
"""
SERVO = '<position joint="shoulder" kp="500" kv="50"/>'
FINGERS = """<body name="finger" pos="0.3 0 0"><joint name="finger" type="slide" axis="0 1 0" range="0 0.04"/>
             <geom name="finger" type="box" size="0.02 0.005 0.01" pos="0 0.02 0"/></body>
             <body name="thumb" pos="0.3 0 0"><joint name="thumb" type="slide" axis="0 -1 0" range="0 0.04"/>
             <geom name="thumb" type="box" size="0.02 0.005 0.01" pos="0 -0.02 0"/></body>"""


def arm(fingers="", actuators=SERVO, **given):
    text = ARM.format(fingers=fingers, actuators=actuators)
    options = {"robot": "base", "tool": "tool", "velocity": [2.0], "acceleration": [5.0]} | given
    return gp.Scene.from_mjcf(text, entities={"vase": "glass"}, **options)


EVERY_DEGREE = {"minor": 0.25, "moderate": 0.5, "severe": 0.75, "critical": 1.0}


SHAKES = {degree: 0.1 * part for degree, part in EVERY_DEGREE.items()}


@dataclass(frozen=True, kw_only=True)
class Drop(Fault):
    """The gripper opens."""

    NAME = "drop"
    CATEGORY = "end_effector"
    PARAMETER = "nothing"
    AMOUNTS = EVERY_DEGREE
    TARGETS = ("gripper",)

    def apply(self, plant, level):
        plant.release()


@dataclass(frozen=True, kw_only=True)
class Weaken(Fault):
    """Actuators lose a part of their force."""

    NAME = "weaken"
    CATEGORY = "actuator"
    PARAMETER = "lost part of gain and damping"
    AMOUNTS = EVERY_DEGREE
    TARGETS = ("all",)
    FIELDS = ("actuator_gainprm", "actuator_biasprm")

    def apply(self, plant, level):
        actuators = plant.robot.actuators[plant.joints]
        for name in self.FIELDS:
            plant[name][actuators] *= 1.0 - level * self.amount


@dataclass(frozen=True, kw_only=True)
class Shake(Fault):
    """Readings jump at random, again and again."""

    NAME = "shake"
    CATEGORY = "sensor"
    PARAMETER = "size of the jumps [rad]"
    AMOUNTS = SHAKES
    PERIOD = 0.02

    def apply(self, plant, level):
        plant.misread(plant.joints, plant.rng.normal(0.0, self.amount * level, len(plant.joints)))


@cache
def world(scene: str, task: str, settings: SimSettings | None = None) -> World:
    return build_world(gp.load_scene(scene).tasks[task].scene, settings)


@cache
def execution(scene: str = "tabletop", task: str = "green_to_blue", settings: SimSettings | None = None) -> Execution:
    given = gp.load_scene(scene).tasks[task]
    result = gp.plan(given.start, given.goal, given.scene, w=0.0, iterations=20, speed=0.5)
    return execute(result, world(scene, task, settings))
