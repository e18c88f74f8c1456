"""A ball on three slides next to a single shape, with known distances and gradients."""

from __future__ import annotations

import graceful_plan as gp

RADIUS = 0.05
_SCENE = """
<mujoco><compiler autolimits="true"/>
<asset>{mesh}</asset>
<custom><numeric name="robot/velocity_limit" data="1 1 1"/><numeric name="robot/acceleration_limit" data="1 1 1"/>
</custom>
<worldbody>
  <body name="obstacle" pos="0.1 -0.05 0.07" quat="0.8 0.2 -0.3 0.45"><geom {geom}/></body>
  <body name="robot/x"><joint name="x" type="slide" axis="1 0 0" range="-1 1"/>
    <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
    <body name="robot/y"><joint name="y" type="slide" axis="0 1 0" range="-1 1"/>
      <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
      <body name="robot/z"><joint name="z" type="slide" axis="0 0 1" range="-1 1"/><geom name="ball" size="0.05"/>
        <site name="tool"/>
  </body></body></body>
</worldbody></mujoco>"""


def scene_of(geom: str, mesh: str = "") -> gp.Scene:
    """Return the ball beside one obstacle, a geom with these attributes."""
    return gp.Scene.from_mjcf(_SCENE.format(geom=geom, mesh=mesh), robot="robot/", tool="tool")
