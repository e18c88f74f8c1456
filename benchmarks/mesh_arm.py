"""A six-axis arm whose links are convex meshes, and the same arm of capsules, to compare meshes with primitives.

Sizes are those of a mid-sized industrial arm; the meshes are convex hulls of seeded random points, two per link with
about 200 faces each, as in simplified collision meshes.
"""

from __future__ import annotations

import numpy as np

import graceful_plan as gp

_POINTS = 400
"""Number of points per hull."""
_LINKS: tuple[tuple[str, tuple[float, float, float], tuple[float, float, float], str, tuple[float, float, float]], ...]
_LINKS = (
    ("shoulder", (0.075, 0.075, 0.09), (0.0, 0.0, 0.16), "0 0 1", (0.0, 0.0, 0.0)),
    ("upper", (0.07, 0.06, 0.26), (0.0, 0.13, 0.0), "0 1 0", (0.0, 0.0, 0.21)),
    ("fore", (0.06, 0.055, 0.24), (0.0, -0.12, 0.425), "0 1 0", (0.0, 0.0, 0.2)),
    ("wrist1", (0.05, 0.06, 0.06), (0.0, 0.0, 0.392), "0 1 0", (0.0, 0.1, 0.0)),
    ("wrist2", (0.05, 0.05, 0.06), (0.0, 0.11, 0.0), "0 0 1", (0.0, 0.0, 0.09)),
    ("wrist3", (0.04, 0.04, 0.03), (0.0, 0.0, 0.095), "0 1 0", (0.0, 0.08, 0.0)),
)
"""Name, half size, position on the parent, axis, centre of the geoms [m]."""
READY = (0.0, -1.2, 1.5, -0.3, 0.0, 0.0)
START, GOAL = (-0.9, -1.0, 1.2, 0.2, 0.3, 0.0), (0.9, -1.1, 1.4, 0.1, -0.3, 0.5)


def mesh_arm(*, capsules: bool = False) -> gp.Scene:
    """Return the arm beside a table and a post."""
    rng = np.random.default_rng(0)
    assets, body, excluded = "", "", []
    for k, (name, half, position, axis, centre) in enumerate(_LINKS):
        geoms, place = "", " ".join(map(str, position))
        if capsules:
            radius = min(half[:2])
            size = f"{radius} {max(half[2] - radius, 0.005)}"
            geoms = f'<geom type="capsule" size="{size}" pos="{" ".join(map(str, centre))}"/>'
        for part, scale in enumerate(() if capsules else (1.0, 0.8)):
            points = _points(scale * np.array(half), rng)
            assets += f'<mesh name="{name}{part}" vertex="{" ".join(f"{x:.5f}" for x in points.ravel())}"/>'
            at = f"{centre[0]} {centre[1]} {centre[2] + 0.02 * part}"
            geoms += f'<geom type="mesh" mesh="{name}{part}" pos="{at}"/>'
        joint = f'<joint name="arm/joint{k}" axis="{axis}" range="-3.1 3.1"/>'
        body += f'<body name="arm/{name}" pos="{place}">{joint}{geoms}'
        excluded += [(name, other[0]) for other in _LINKS[k + 1 : k + 3]]
    body += '<site name="arm/tool" pos="0 0.12 0"/>' + "</body>" * len(_LINKS)
    excluded += [("base", "shoulder"), ("base", "upper")]
    pairs = "".join(f'<exclude body1="arm/{a}" body2="arm/{b}"/>' for a, b in excluded)
    around = (
        '<geom name="ground" type="plane" size="3 3 .1" pos="0 0 -.3"/>'
        '<body name="table" pos=".9 0 0"><geom type="box" size=".3 .5 .02"/></body>'
        '<body name="post" pos=".5 -.5 .3"><geom type="box" size=".05 .05 .3"/></body>'
    )
    base = f'<body name="arm/base"><geom type="cylinder" size=".07 .04" pos="0 0 .04"/>{body}</body>'
    text = f"<asset>{assets}</asset><worldbody>{around}{base}</worldbody><contact>{pairs}</contact>"
    return gp.Scene.from_mjcf(
        f'<mujoco model="mesh_arm"><compiler angle="radian"/>{text}</mujoco>',
        robot="arm/",
        tool="arm/tool",
        velocity=[3.0] * len(_LINKS),
        acceleration=[10.0] * len(_LINKS),
    )


def _points(half: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Draw points on a surface between an ellipsoid and a box."""
    points = rng.normal(size=(_POINTS, 3))
    points /= np.abs(points) ** 0.5 + 0.3
    points /= np.linalg.norm(points, axis=1, keepdims=True) ** 0.6
    return points / np.abs(points).max(axis=0) * half
