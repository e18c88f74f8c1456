"""Arms of three to seven joints, and an arm on a rail, for tests of goals; their links collide with nothing."""

import graceful_plan as gp

# Per joint: type, axis, offset from the parent [m], range [rad or m].
_HALF = (-3.1, 3.1)
ARMS = {
    "planar": [
        ("hinge", "0 0 1", "0 0 .3", _HALF),
        ("hinge", "0 0 1", ".4 0 0", _HALF),
        ("hinge", "0 0 1", ".3 0 0", _HALF),
    ],
    "scara": [
        ("hinge", "0 0 1", "0 0 .4", (-2.6, 2.6)),
        ("hinge", "0 0 1", ".35 0 0", (-2.6, 2.6)),
        ("slide", "0 0 -1", ".3 0 0", (0.0, 0.3)),
        ("hinge", "0 0 1", "0 0 -.05", _HALF),
    ],
    "five": [
        ("hinge", "0 0 1", "0 0 .06", (-1.9, 1.9)),
        ("hinge", "0 1 0", "0 0 .05", (-1.75, 1.75)),
        ("hinge", "0 1 0", ".03 0 .11", (-1.7, 1.7)),
        ("hinge", "0 1 0", ".13 0 0", (-1.65, 1.65)),
        ("hinge", "1 0 0", ".06 0 0", (-2.7, 2.8)),
    ],
    "six": [
        ("hinge", "0 0 1", "0 0 .16", (-6.28, 6.28)),
        ("hinge", "0 1 0", "0 .14 0", (-6.28, 6.28)),
        ("hinge", "0 1 0", "0 -.12 .425", (-3.1, 3.1)),
        ("hinge", "0 1 0", "0 0 .39", (-6.28, 6.28)),
        ("hinge", "0 0 1", "0 .09 0", (-6.28, 6.28)),
        ("hinge", "0 1 0", "0 0 .095", (-6.28, 6.28)),
    ],
    "seven": [
        ("hinge", "0 0 1", "0 0 .33", (-2.9, 2.9)),
        ("hinge", "0 1 0", "0 0 0", (-1.76, 1.76)),
        ("hinge", "0 0 1", "0 0 .32", (-2.9, 2.9)),
        ("hinge", "0 -1 0", ".08 0 0", (-3.07, -0.07)),
        ("hinge", "0 0 1", "-.08 0 .38", (-2.9, 2.9)),
        ("hinge", "0 -1 0", "0 0 0", (-0.02, 3.75)),
        ("hinge", "0 0 -1", ".09 0 0", (-2.9, 2.9)),
    ],
}  # fmt: skip
ARMS["rail"] = [("slide", "1 0 0", "0 0 .1", (-1.0, 1.0)), *ARMS["six"]]


def arm(name, limits=None, **given):
    """Make an arm; `limits` replaces ranges by joint, j0 first, and None leaves a joint without limits."""
    ranges = {f"j{k}": limit for k, (*_, limit) in enumerate(ARMS[name])} | (limits or {})
    opened, closed = "", ""
    for k, (kind, axis, offset, _) in enumerate(ARMS[name]):
        limit = ranges[f"j{k}"]
        held = "" if limit is None else f'range="{limit[0]} {limit[1]}"'
        opened += f"""<body name="arm/l{k}" pos="{offset}"><joint name="arm/j{k}" type="{kind}" axis="{axis}" {held}/>
        <geom type="sphere" size=".01" mass=".5" contype="0" conaffinity="0"/>"""
        closed += "</body>"
    text = f"""<mujoco><compiler angle="radian"/><worldbody><geom name="far" type="box" size=".1 .1 .1" pos="9 9 9"/>
    {opened}<geom name="tip" type="sphere" size=".005" pos="0 0 .1" mass=".1"/><site name="arm/tip" pos="0 0 .1"/>
    {closed}</worldbody></mujoco>"""
    n = len(ARMS[name])
    return gp.Scene.from_mjcf(
        text, robot="arm/l0", tool="arm/tip", **{"velocity": [2.0] * n, "acceleration": [8.0] * n, **given}
    )
