"""NumPy twins of the core for contents: rows of limits on acceleration, and the surface of a liquid."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

import graceful_plan as gp
from graceful_plan.constraints.specific_force import Felt, SpecificForceCone
from graceful_plan.core.arrays import RobotArrays
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import Kernels
from graceful_plan.exceptions import RetimingError
from graceful_plan.timing.blend import CurveGrid
from graceful_plan.timing.topp import Restraint

Array = np.ndarray


def felt_limits(felt: Sequence[Felt], kernels: Kernels) -> Restraint:
    """Return limits a u + b x <= c on path acceleration u and squared path speed x, at both ends of each interval."""

    def limits(grid: CurveGrid) -> Array:
        steps, rows = np.diff(grid.s)[:, None], [np.zeros((len(grid.s) - 1, 0, 3))]
        for one in felt:
            for end in (0, 1):
                q = grid.q[end : len(grid.q) - 1 + end]
                X_WL = kernels.link_poses(q)
                derivatives = grid.slope[:, end], grid.bend[:, end]
                slope, bend = curve_of_point(kernels.robot, X_WL, (one.link, one.point), derivatives)
                v = np.einsum("nij,fj->nfi", X_WL[:, one.link, :3, :3], one.facets)
                a, b = np.einsum("nfi,ni->nf", v, slope), np.einsum("nfi,ni->nf", v, bend)
                c = one.room - one.gravity * v[..., 2]
                if np.any(c < 1e-3 * one.gravity):
                    at = grid.s[int(np.argmin(c.min(axis=1))) + end] / grid.s[-1]
                    raise RetimingError(f"{one.name} does not hold at rest after {at:.0%} of the path")
                # At the end of an interval the squared speed is x + 2 step u.
                rows.append(np.stack([a + (2.0 * steps * b if end else 0.0), b, c], axis=-1))
        return np.ascontiguousarray(np.concatenate(rows, axis=1))

    return limits


def curve_of_point(
    robot: RobotArrays, X_WL: Array, rider: tuple[int, Array], derivatives: tuple[Array, Array]
) -> tuple[Array, Array]:
    """Return the first and second derivative of a point's position along a curve in joint space."""
    link, point = rider
    slope, bend = derivatives
    at = X_WL[:, link, :3, 3] + X_WL[:, link, :3, :3] @ point
    chain, k = [], link
    while k >= 0:
        if robot.joint[k] >= 0:
            chain.append(k)
        k = int(robot.parent[k])
    first, second, omega = np.zeros_like(at), np.zeros_like(at), np.zeros_like(at)
    for k in reversed(chain):  # from the base outwards
        j, z = int(robot.joint[k]), X_WL[:, k, :3, 2]
        s, b = slope[:, j : j + 1], bend[:, j : j + 1]
        turned = omega if robot.slide[k] else omega + s * z
        J = z if robot.slide[k] else np.cross(z, at - X_WL[:, k, :3, 3])
        first += s * J
        # dJ/ds: the joint turns with the joints before it, and by itself
        second += b * J + s * np.cross(omega + turned, J)
        omega = turned
    return first, second


def swing(felt: Array, dt: float, length: float, drag: float, steps: int = 4) -> Array:
    """Return unit normals of a surface, initially at rest, for specific forces [m/s^2] at times `dt` apart [s]."""
    d, rate, h, normals = np.array([0.0, 0.0, -1.0]), np.zeros(3), dt / steps, []
    for k in range(len(felt)):
        normals.append(-d)
        end = felt[min(k + 1, len(felt) - 1)]
        for s in range(steps):
            pull = -(felt[k] + (s + 0.5) / steps * (end - felt[k])) / length
            rate = rate + h * (pull - (pull @ d) * d - drag * rate)
            d = d + h * rate
            d /= np.linalg.norm(d)
            rate -= (rate @ d) * d
    return np.array(normals)


def stays_below(
    cone: SpecificForceCone, trajectory: gp.Trajectory, scene: gp.Scene, angle: float
) -> Callable[[float], bool]:
    """Return whether the surface stays within an angle of the axis if a motion is slowed by a factor."""
    samples, after = 0.004, 0.5
    kernels, motion = compile_scene(scene).kernels, trajectory.sample(samples)
    X_WL = kernels.link_poses(motion.q)
    _, acceleration = curve_of_point(kernels.robot, X_WL, (cone.link, cone.point), (motion.qd, motion.qdd))
    axis = X_WL[:, cone.link, :3, :3] @ cone.axis

    def stays(slowdown: float) -> bool:
        dt = slowdown * samples
        rest = int(after / dt)
        surface = np.concatenate([acceleration / slowdown**2, np.zeros((rest, 3))]) + [0.0, 0.0, cone.gravity]
        if cone.slosh is not None:
            surface = swing(surface, dt, cone.slosh.length, cone.slosh.drag)
        upright = np.concatenate([axis, np.repeat(axis[-1:], rest, axis=0)])
        cosine = (surface * upright).sum(axis=1) / np.linalg.norm(surface, axis=1)
        return bool(cosine.min() >= np.cos(angle))

    return stays
