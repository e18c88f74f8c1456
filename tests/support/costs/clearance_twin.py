"""Clearance in double precision with NumPy, to measure its derivative by finite differences.

The kernels compute distances in single precision, whose finite differences are accurate to about four digits; their
gradient is compared with differences of this twin. Ellipsoids and hulls are left out and count as infinitely far.
"""

from __future__ import annotations

import numpy as np

from graceful_plan.core.arrays import OBSTACLE_TYPES, RobotArrays, WorldArrays

Array = np.ndarray


class ClearanceTwin:
    """Distances between every sphere and all obstacles and spheres that it may touch.

    Args:
        robot: Links and spheres.
        world: Obstacles.
    """

    def __init__(self, robot: RobotArrays, world: WorldArrays) -> None:
        self.robot, self.world = robot, world
        links = robot.sphere_link
        met = ((world.ignores[None, :] >> links[:, None]) & 1) == 0
        self.sphere, self.obstacle = np.nonzero(met)
        pairs = {tuple(sorted(pair)) for pair in robot.self_pair.tolist()}
        first, second = np.triu_indices(len(links), k=1)
        own = np.array([tuple(sorted(pair)) in pairs for pair in zip(links[first], links[second], strict=True)])
        self.first, self.second = first[own], second[own]

    @property
    def n_self(self) -> int:
        """Number of pairs of two robot spheres; they come last."""
        return len(self.first)

    def distances(self, q: Array) -> Array:
        """Return the signed distance of every pair [n, pair], at configurations [n, nq]."""
        centre, radius = self.centres(q), self.robot.sphere[:, 3].astype(np.float64)
        outside = np.full((len(q), len(self.sphere)), np.inf)
        for i in range(len(self.world.kind)):
            mine = np.flatnonzero(self.obstacle == i)
            outside[:, mine] = self._to_obstacle(i, centre[:, self.sphere[mine]])
        outside -= radius[self.sphere]
        apart = np.linalg.norm(centre[:, self.first] - centre[:, self.second], axis=2)
        return np.concatenate([outside, apart - radius[self.first] - radius[self.second]], axis=1)

    def distance(self, q: Array, pair: Array) -> Array:
        """Return the signed distance of one pair each [n], at configurations [n, nq]."""
        centre, radius = self.centres(q), self.robot.sphere[:, 3].astype(np.float64)
        rows, result = np.arange(len(q)), np.empty(len(q))
        own = pair >= len(self.sphere)
        a, b = (ends[pair[own] - len(self.sphere)] for ends in (self.first, self.second))
        result[own] = np.linalg.norm(centre[rows[own], a] - centre[rows[own], b], axis=1) - radius[a] - radius[b]
        for i in np.unique(self.obstacle[pair[~own]]):
            mine = np.flatnonzero(~own)[self.obstacle[pair[~own]] == i]
            sphere = self.sphere[pair[mine]]
            result[mine] = self._to_obstacle(int(i), centre[mine, sphere]) - radius[sphere]
        return result

    def centres(self, q: Array) -> Array:
        """Return the centres of the spheres in W [n, sphere, 3]."""
        poses = np.empty((len(q), len(self.robot.parent), 4, 4))
        for link, (parent, joint) in enumerate(zip(self.robot.parent, self.robot.joint, strict=True)):
            poses[:, link] = self.robot.X_PL[link] if parent < 0 else poses[:, parent] @ self.robot.X_PL[link]
            if joint >= 0:
                poses[:, link] = poses[:, link] @ _moved(q[:, joint], bool(self.robot.slide[link]))
        mine = poses[:, self.robot.sphere_link]
        return np.einsum("nsij,sj->nsi", mine[..., :3, :3], self.robot.sphere[:, :3]) + mine[..., :3, 3]

    def _to_obstacle(self, i: int, point: Array) -> Array:
        pose, size = self.world.pose[i].astype(np.float64), self.world.size[i].astype(np.float64)
        p = (point - pose[9:]) @ pose[:9].reshape(3, 3)
        kind = OBSTACLE_TYPES[self.world.kind[i]]
        if kind == "plane":
            return p[..., 2]
        if kind == "sphere":
            return np.linalg.norm(p, axis=-1) - size[0]
        if kind == "capsule":
            p[..., 2] -= np.clip(p[..., 2], -size[1], size[1])
            return np.linalg.norm(p, axis=-1) - size[0]
        if kind == "cylinder":
            return _beyond(np.stack([np.linalg.norm(p[..., :2], axis=-1) - size[0], np.abs(p[..., 2]) - size[1]], -1))
        if kind == "box":
            return _beyond(np.abs(p) - size)
        return np.full(p.shape[:-1], np.inf)


def _beyond(excess: Array) -> Array:
    """Return the distance from a product of intervals, given by how much each coordinate is outside its interval."""
    return np.linalg.norm(np.maximum(excess, 0.0), axis=-1) + np.minimum(excess.max(axis=-1), 0.0)


def _moved(position: Array, slide: bool) -> Array:
    """Return the poses [n, 4, 4] of a joint along or about z."""
    X = np.tile(np.eye(4), (len(position), 1, 1))
    if slide:
        X[:, 2, 3] = position
    else:
        X[:, 0, 0] = X[:, 1, 1] = np.cos(position)
        X[:, 1, 0] = np.sin(position)
        X[:, 0, 1] = -X[:, 1, 0]
    return X
