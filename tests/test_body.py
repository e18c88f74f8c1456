"""The body model: laws, and the core against a slow twin and against MuJoCo."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from body_twin import BodyTwin
from hypothesis import given, settings
from hypothesis import strategies as st

import graceful_plan as gp
from graceful_plan import StateBatch
from graceful_plan.compile import compile_scene
from graceful_plan.costs.interactions import body as body_module
from graceful_plan.costs.interactions.body import BodyModel, chance, mode_margins, mode_names, mode_weights
from graceful_plan.costs.interactions.body_constants import GENERATORS, BodySettings, Margin, Margins
from graceful_plan.costs.interactions.body_tables import BodyTables, body_tables
from graceful_plan.exceptions import NonFiniteError, SceneError, SettingError, ShapeError

_SAME = 1e-9  # metres; the core and the twin differ by rounding, and by Newton's method stopped a step apart
_TORQUE = 1e-8  # N m and rad/s^2, MuJoCo's own rounding
SETTINGS = BodySettings.shipped()
_COARSE = replace(SETTINGS, steps=2)

_ARM = """
<mujoco><compiler angle="radian"/><worldbody>
  <geom name="ground" type="plane" size="0 0 1"/>
  <body name="vase" pos="{vase}"><freejoint/><geom type="cylinder" size="0.06 0.2" mass="0.3"/></body>
  <body name="lamp" pos="{lamp}"><freejoint/><geom type="ellipsoid" size="0.06 0.1 0.08" mass="0.3"/></body>
  <body name="arm" pos="0 0 0.8" euler="0 0 {turn}"><geom type="capsule" size="0.05 0.05" mass="1"/>
    <body name="arm_a"><joint name="a" axis="0.2 0.1 1" range="-2 2" damping="0.3" armature="0.05"/>
    <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.04" mass="2"/>
    <body name="arm_b" pos="0.3 0 0"><joint name="b" type="slide" axis="1 0.3 0.1" range="-0.3 0.3" damping="2"/>
      <geom type="box" size="0.05 0.03 0.04" pos="0.05 0 0" mass="1"/>
      <body name="arm_c" pos="0.1 0 0.1"><joint name="c" axis="0 1 0.2" pos="0 0.05 0" range="-1 1" frictionloss="0.2"/>
        <joint name="d" axis="1 0 0" range="-2 2"/><geom type="sphere" size="0.05" pos="0 0.1 0" mass="0.7"/>
        <site name="tool" pos="0.1 0 -0.05"/>
  </body></body></body></body>
  <body name="thing" pos="3 3 1"><freejoint/>
    <geom type="box" size="0.03 0.04 0.05" mass="0.3"/><geom type="sphere" size="0.02" pos="0 0 0.07" mass="0.1"/></body>
</worldbody></mujoco>"""


def _odd(turn=0.0, entities=("vase", "lamp", "ground"), held=True):
    c, s = np.cos(turn), np.sin(turn)
    place = {"vase": (0.6, 0.15, 0.2), "lamp": (0.5, -0.3, 0.5)}
    turned = {n: f"{c * x - s * y} {s * x + c * y} {z}" for n, (x, y, z) in place.items()}
    text = _ARM.format(turn=turn, **turned)
    notes = {name: gp.EntityNote(category="glass") for name in entities}
    scene = gp.Scene.from_mjcf(text, robot="arm", tool="tool", velocity_limit=np.full(4, 2.0),
                               acceleration_limit=np.full(4, 5.0), entities=notes)  # fmt: skip
    return scene.attach("thing", X_TO=np.eye(4)) if held else scene


def _states(scene, n, seed, fastest=1.0):
    rng = np.random.default_rng(seed)
    q = rng.uniform(*scene.limits.position.T, size=(n, len(scene.joints)))
    return q, scene.limits.velocity * rng.uniform(-fastest, fastest, q.shape)


def _batch(scene, q, qd):
    speed = np.linalg.norm(qd, axis=1)
    return StateBatch(scene, q, qd / np.where(speed > 0.0, speed, 1.0)[:, None], speed)
