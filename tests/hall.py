"""A hall with a pillar and a small skid-steer robot, for tests of bases that drive."""

from __future__ import annotations

import graceful_plan as gp

BASE = gp.DiffDrive(
    joints=("cart/x", "cart/y", "cart/yaw"),
    radius=0.098,
    track=0.3756,
    slip=1.5,
    v_max=2.0,
    omega_max=4.0,
    a_max=2.0,
    alpha_max=6.0,
)
WALLS = """
    <body name="north" pos="0 2 .5"><geom type="box" size="6 .05 .5"/></body>
    <body name="south" pos="0 -2 .5"><geom type="box" size="6 .05 .5"/></body>
    <body name="pillar" pos="0 0 .5"><geom type="cylinder" size=".3 .5"/></body>
"""
ARM = """
      <body name="cart/link" pos="0 0 .4">
        <joint name="cart/lift" type="hinge" axis="0 1 0" range="-1.5 1.5"/>
        <geom name="cart/link" type="capsule" fromto="0 0 0 .5 0 0" size=".03" mass="1"/>
        <site name="cart/tip" pos=".5 0 0"/>
      </body>
"""


def hall(
    base: gp.DiffDrive | None = BASE,
    *,
    walls: str = WALLS,
    arm: bool = False,
    extra: str = "",
    entities: dict[str, str] | None = None,
) -> gp.Scene:
    """Return the hall: 12 m long, 4 m wide, a person beside the middle."""
    wheels = "".join(
        f'<geom type="cylinder" size=".098 .02" pos="{x} {y} .098" euler="1.5708 0 0" mass=".477"/>'
        for x in (0.131, -0.131)
        for y in (0.1878, -0.1878)
    )
    world = f"""
<mujoco model="hall">
  <compiler angle="radian"/>
  <worldbody>
    <geom name="floor" type="plane" size="10 10 .1"/>
    {walls}{extra}
    <body name="person" pos="2 .8 .85"><geom type="cylinder" size=".25 .85"/></body>
    <body name="cart/base">
      <joint name="cart/x" type="slide" axis="1 0 0" range="-8 8"/>
      <joint name="cart/y" type="slide" axis="0 1 0" range="-8 8"/>
      <joint name="cart/yaw" type="hinge" axis="0 0 1"/>
      <geom name="cart/chassis" type="box" size=".21 .155 .092" pos="0 0 .155" mass="16.5"/>
      {wheels}{ARM if arm else ""}
    </body>
  </worldbody>
</mujoco>"""
    rest = [0.0] if arm else []
    return gp.Scene.from_mjcf(
        world,
        robot="cart/",
        tool="cart/tip" if arm else "cart/base",
        base=base,
        velocity=[1.5] if arm else (None if base is not None else [2.0, 2.0, 4.0]),
        acceleration=[3.0] if arm else (None if base is not None else [2.0, 2.0, 6.0]),
        body_class="base_coast",
        entities={"person": "adult"} if entities is None else entities,
        keyframes={"west": [-4.0, 0.0, 0.0, *rest], "east": [4.0, 0.0, 0.0, *rest]},
        allowed_contacts=[gp.AllowedContact("cart/base", "floor")],
    )
