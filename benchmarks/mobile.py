"""What benchmarks of robots that drive share: a bundled robot among bodies on a wide floor."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco

import graceful_plan as gp
from graceful_plan.scene.loading.robot_models import robot_file
from graceful_plan.scene.mobile.known_bases import known_base


def standing(
    bodies: str,
    robot: str = "jackal",
    *,
    entities: Mapping[str, str] | None = None,
    base: gp.DiffDrive | None = None,
    spec: mujoco.MjSpec | None = None,
) -> gp.Scene:
    """Return a scene in which a robot stands on a floor of 80 x 80 m.

    Args:
        bodies: What else is there, MJCF; angles in radians.
        robot: Name of its model.
        entities: Class of each body that may be harmed; nobody by default.
        base: How it drives, if not as its model says.
        spec: Its model, if it is not the bundled one.
    """
    world = mujoco.MjSpec.from_string(
        '<mujoco><compiler angle="radian"/><worldbody><geom name="floor" type="plane" size="40 40 .1"/>'
        f"{bodies}</worldbody></mujoco>"
    )
    own = mujoco.MjSpec.from_file(str(robot_file(robot))) if spec is None else spec
    world.attach(own, prefix=f"{robot}/", frame=world.worldbody.add_frame())
    return gp.Scene.from_mjcf(
        world,
        robot=f"{robot}/",
        tool=f"{robot}/{'tool' if robot == 'fetch' else 'base'}",
        base=known_base(robot) if base is None else base,
        body_class="base_coast",
        entities=dict(entities or {}),
        allowed_contacts=[gp.AllowedContact(f"{robot}/base", "floor")],
    )
