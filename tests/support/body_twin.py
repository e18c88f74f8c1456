"""The body model in plain NumPy: a slow reference for the native kernel.

It handles one state at a time. Dynamics use the Jacobians of every frame's centre of mass instead of composite
inertias, and all spheres are tested against all obstacles. Scalars are in single precision where the core's are.
"""

from __future__ import annotations

import numpy as np

from graceful_plan import Scene
from graceful_plan.core.compile import compile_scene
from graceful_plan.costs.models.body.body import FAR, mode_margins
from graceful_plan.costs.models.body.constants import GENERATORS, BodySettings
from graceful_plan.costs.models.body.tables import body_tables

Array = np.ndarray
_f = np.float32


class BodyTwin:
    """Distances and dynamics of one scene."""

    def __init__(self, scene: Scene, settings: BodySettings) -> None:
        compiled = compile_scene(scene)
        self.settings, self.tables = settings, body_tables(scene)
        self.robot, self.world, self.n_entity = compiled.robot, compiled.world, len(scene.entities)
        self.nq = len(scene.joints)

    # --- kinematics and dynamics ---------------------------------------------------------------------------------

    def poses(self, x: Array) -> Array:
        """Return X_W of all links."""
        robot, X = self.robot, []
        for link, parent in enumerate(robot.parent):
            here = (X[parent] if parent >= 0 else np.eye(4)) @ robot.X_PL[link]
            joint = robot.joint[link]
            if joint >= 0:
                motion = np.eye(4)
                if robot.slide[link]:
                    motion[2, 3] = x[joint]
                else:
                    c, s = np.cos(x[joint]), np.sin(x[joint])
                    motion[:2, :2] = [[c, -s], [s, c]]
                here = here @ motion
            X.append(here)
        return np.array(X)

    def dynamics(self, x: Array) -> tuple[Array, Array]:
        """Return M with armature, and the torques that hold the arm."""
        X, t, robot = self.poses(x), self.tables, self.robot
        M, G = np.diag(t.armature), np.zeros(self.nq)
        for frame, mass in enumerate(t.mass):
            R, c = X[frame, :3, :3], X[frame, :3, :3] @ t.centre[frame] + X[frame, :3, 3]
            J_v, J_w, link = np.zeros((3, self.nq)), np.zeros((3, self.nq)), frame
            while link >= 0:
                joint, z = robot.joint[link], X[link, :3, 2]
                if joint >= 0 and robot.slide[link]:
                    J_v[:, joint] = z
                elif joint >= 0:
                    J_v[:, joint], J_w[:, joint] = np.cross(z, c - X[link, :3, 3]), z
                link = robot.parent[link]
            M = M + mass * J_v.T @ J_v + J_w.T @ R @ t.inertia[frame] @ R.T @ J_w
            G = G + 9.81 * mass * J_v[2]
        return M, G

    # --- failed configurations -----------------------------------------------------------------------------------

    def paths(self, q: Array, qd: Array, ahead: Array | None) -> list[Array]:
        """Return the configurations of each failure mode, the state itself first."""
        k, t, n = self.settings, self.tables, self.nq
        known = ahead is not None
        if ahead is None:
            times = np.arange(1, k.steps + 1) * k.step
            share = k.carry_on * (1.0 - np.exp(-times / k.carry_on)) if k.carry_on else 0.0 * times
            ahead = np.clip(q + share[:, None] * qd, t.lower, t.upper)
        reference = np.vstack([q, ahead])
        stuck = [reference.copy() for _ in range(n)]
        for j in range(n):
            stuck[j][:, j] = q[j]
        late = slice(None) if known else [0, -1]
        loose = [self._loose(reference, qd, j) for j in range(n)]
        return [self._collapse(q, qd), *loose, *(path[late] for path in stuck), reference[late]]

    def _collapse(self, q: Array, qd: Array) -> Array:
        k, t = self.settings, self.tables
        h, x, v, path = k.brake_time / 5, q, qd, [q]
        for _ in range(5):
            M, G = self.dynamics(x)
            A = M + h * np.diag(t.damping)
            x, v = self._moved(x, v, _soft(np.linalg.solve(A, M @ v - h * G), h * t.friction / np.diag(A)), h)
            path.append(x)
        return np.array([*path, np.clip(x + k.brake_stop * v, t.lower, t.upper)])

    def _loose(self, reference: Array, qd: Array, j: int) -> Array:
        k, t = self.settings, self.tables
        path, v, at, depth = reference.copy(), qd.copy(), reference[0, j], self.depth(reference[0])
        M, _ = self.dynamics(reference[0])
        for s in range(1, len(path)):
            _, G = self.dynamics(path[s - 1])
            share = 1.0 / (M[j, j] + k.step * (t.damping[j] + k.resistance))
            after = v.copy()
            after[j] = _soft((M[j, j] * v[j] - k.step * G[j]) * share, k.step * t.friction[j] * share)
            before = path[s - 1].copy()
            before[j] = at
            x, moving = self._moved(before, v, after, k.step)
            path[s, j] = x[j]
            rests = self.depth(path[s]) > depth + k.joint.stop_tolerance
            at, v = (at, np.zeros(self.nq)) if rests else (x[j], moving)
            depth = depth if rests else max(depth, self.depth(path[s]))
        return path

    def depth(self, x: Array) -> float:
        """Return how deep the arm is in obstacles."""
        return max(0.0, -float(self.separations(x).min()))

    def _moved(self, x: Array, v: Array, after: Array, h: float) -> tuple[Array, Array]:
        y = x + 0.5 * h * (v + after)
        outside = (y < self.tables.lower) | (y > self.tables.upper)
        return np.clip(y, self.tables.lower, self.tables.upper), np.where(outside, 0.0, after)

    # --- distances -----------------------------------------------------------------------------------------------

    def separations(self, x: Array) -> Array:
        """Return the signed distance of each row to each obstacle, infinite for ignored pairs."""
        robot, X = self.robot, self.poses(x)
        found = np.full((self.tables.n_row, len(self.world.kind)), np.inf)
        sphere = robot.sphere.astype(_f).astype(float)
        centre = np.einsum("sij,sj->si", X[robot.sphere_link, :3, :3], sphere[:, :3]) + X[robot.sphere_link, :3, 3]
        for s, link in enumerate(robot.sphere_link):
            row = self.tables.link_row[link]
            for o in range(len(self.world.kind)):
                if row >= 0 and not int(self.world.ignores[o]) >> int(link) & 1:
                    found[row, o] = min(found[row, o], self.distance_to(o, centre[s]) - sphere[s, 3])
        return found

    def distance_to(self, o: int, point: Array) -> float:
        """Return the signed distance of a point from an obstacle."""
        world = self.world
        kind, R = world.kind[o], world.pose[o, :9].astype(_f).reshape(3, 3).astype(float)
        p = (point - world.pose[o, 9:].astype(_f)) @ R
        size = world.size[o].astype(_f)
        if kind == 0:
            return p[2]
        if kind == 1:
            return float(np.linalg.norm(p)) - size[0]
        if kind == 2:
            return float(np.hypot(np.hypot(p[0], p[1]), p[2] - np.clip(p[2], -size[1], size[1]))) - size[0]
        if kind == 3:
            return _ellipsoid(size, p)
        if kind == 4:
            return _outside(np.array([np.hypot(p[0], p[1]) - size[0], abs(p[2]) - size[1]]))
        if kind == 5:
            return _outside(np.abs(p) - size)
        return _hull(world.triangles[world.hull_start[o] : world.hull_start[o + 1]], point)

    # --- the model -----------------------------------------------------------------------------------------------

    def distances(self, q: Array, qd: Array, ahead: Array | None = None) -> Array:
        """Return d [m] of each mode, row and entity, as `BodyModel.distances`."""
        k, t = self.settings, self.tables
        offset, spread = mode_margins(k, self.nq)
        found = np.repeat((offset + FAR * spread)[..., None], self.n_entity, axis=2)
        for mode, path in enumerate(self.paths(q, qd, ahead)):
            n = self.nq
            generator = GENERATORS[0 if mode == 0 else 1 if mode <= n else 2 if mode <= 2 * n else 3]
            stop, depth = getattr(k, generator), 0.0
            for step, x in enumerate(path):
                d, before = self.separations(x), stop.stop_gain * max(depth - stop.stop_tolerance, 0.0)
                for o, entity in enumerate(t.entity):
                    if entity >= 0:
                        rows = found[mode, : t.n_row, entity]
                        rows[:] = np.minimum(rows, d[:, o] + before)
                deeper = max(depth, float(-d.min()))
                rests = generator == "joint" and step > 0 and deeper > depth + stop.stop_tolerance
                depth = depth if rests else deeper
        return found


def _soft(v: Array, u: Array) -> Array:
    return np.sign(v) * np.maximum(np.abs(v) - u, 0.0)


def _outside(excess: Array) -> float:
    return float(np.linalg.norm(np.maximum(excess, 0.0)) + min(excess.max(), 0.0))


def _ellipsoid(r: Array, y: Array) -> float:
    squares, r_min = (r * r).astype(float), float(r.min())
    r_min2 = float(_f(r.min()) * _f(r.min()))
    k = float(np.sqrt(np.sum(y * y * (_f(1.0) / (r * r)).astype(float))))
    t = max((k - 1.0) * r_min2, 0.0)
    for _ in range(8):
        u = r * y / (t + squares)
        t += max(float((u @ u - 1.0) / (2.0 * np.sum(u * u / (t + squares)) + 1e-20)), 0.0)
    lower = (k - 1.0) * r_min
    return max(float(np.linalg.norm(y * t / (t + squares))) - float(_f(1e-6)), lower) if k > 1.0 else lower


def _hull(triangles: Array, p: Array) -> float:
    deepest, nearest = -np.inf, np.inf
    for corners in triangles:
        a, b, c = (corner.astype(_f) for corner in corners)
        n = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        n = n / np.linalg.norm(n)
        height = float(p @ n.astype(_f) - _f(n @ corners[0]))
        deepest = max(deepest, height)
        ends, over = ((a, b), (b, c), (c, a)), True
        for first, second in ends:
            over &= float((p - first) @ np.cross(n, second.astype(float) - first)) >= 0.0
        edge = min(_segment(p, first.astype(float), second.astype(float)) for first, second in ends)
        if height > 0.0:
            nearest = min(nearest, height if over else edge)
    return nearest if deepest > 0.0 else deepest


def _segment(p: Array, a: Array, b: Array) -> float:
    e = b - a
    return float(np.linalg.norm(p - a - np.clip((p - a) @ e / (e @ e), 0.0, 1.0) * e))
