"""A Jackal on a wide floor, for tests of bases on wheels."""

from __future__ import annotations

import mujoco

import graceful_plan as gp
from graceful_plan.scene.loading.robot_models import robot_file
from graceful_plan.scene.mobile.known_bases import known_base


def jackal(*bodies):
    """Return a Jackal on a wide floor, among cylinders that stand for children."""
    things = "".join(
        f'<body name="child{k}" pos="{x} {y} .5"><geom type="cylinder" size=".2 .5"/></body>'
        for k, (x, y) in enumerate(bodies)
    )
    floor = '<geom name="floor" type="plane" size="50 50 .1"/>'
    spec = mujoco.MjSpec.from_string(f"<mujoco><worldbody>{floor}{things}</worldbody></mujoco>")
    spec.attach(mujoco.MjSpec.from_file(str(robot_file("jackal"))), prefix="jackal/", frame=spec.worldbody.add_frame())
    return gp.Scene.from_mjcf(
        spec,
        robot="jackal/",
        tool="jackal/base",
        base=known_base("jackal"),
        body_class="base_coast",
        entities={f"child{k}": "child" for k in range(len(bodies))},
        allowed_contacts=[gp.AllowedContact("jackal/base", "floor")],
    )
