"""Places where an object can stand: on the flat top of a body, or on whatever is flat inside a region.

Frames: W world, O object, G geom. An object keeps the side on which it stands in the scene; it is turned about the
vertical axis.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Bool, Float
from graceful_plan.core.frames import pose_matrix
from graceful_plan.exceptions import SettingError, UnsupportedError
from graceful_plan.job.placed import Placed
from graceful_plan.path import finite_array, is_real
from graceful_plan.query.arguments import checked_seed
from graceful_plan.scene.model_parts import colliding_geoms, subtree
from graceful_plan.scene.roles import held_note
from graceful_plan.scene.scene import Scene

Array = np.ndarray

_GEOM = mujoco.mjtGeom
APART = 0.01
"""Least distance of a placed object from other things [m], so that fingers and errors of control have space."""
_LOW = 0.005
"""Height above the underside of an object up to which its geoms carry it [m]."""
_OVERLAP = 0.003
"""Overlap from which two objects cannot be in one place [m]; as deep as contacts with a support may be."""
_TOUCHING = 5e-4
"""Gap or overlap up to which objects touch [m]; with a larger one, they are apart or overlap."""
_LEVEL = 0.999
"""Least cosine between a top and the horizontal plane."""
_TRIES = 64
"""Samples for each placement."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Top:
    """A horizontal face: pose of its middle in W (z upwards), and half sizes or the radius."""

    body: str
    X_WG: Float[Array, "4 4"]
    half: tuple[float, float] | float

    def contains(self, p_W: Float[Array, "point xyz"]) -> Bool[Array, " point"]:
        """Tell which points are above the face, along the vertical."""
        p = (p_W - self.X_WG[:3, 3]) @ self.X_WG[:3, :3]
        if isinstance(self.half, float):
            return np.asarray(np.hypot(p[:, 0], p[:, 1]) <= self.half)
        return np.asarray((np.abs(p[:, :2]) <= self.half).all(axis=1))

    def sample(self, rng: np.random.Generator) -> Float[Array, " xyz"]:
        """Return a point on the face in W."""
        if isinstance(self.half, float):
            turn, radius = 2.0 * np.pi * rng.random(), self.half * np.sqrt(rng.random())
            p = np.array([radius * np.cos(turn), radius * np.sin(turn), 0.0])
        else:
            p = np.array([*rng.uniform(-1.0, 1.0, 2) * self.half, 0.0])
        return self.X_WG[:3, :3] @ p + self.X_WG[:3, 3]


def placements(
    scene: Scene,
    name: str,
    *,
    on: str | None = None,
    in_region: ArrayLike | None = None,
    n: int = 16,
    seed: int = 0,
) -> Float[Array, "placement 4 4"]:
    """Sample poses in W in which an object stands freely, by its underside on a horizontal face.

    Args:
        scene: The scene; the object stands somewhere in it.
        name: Object of the scene, or any body whose parent is the world.
        on: Body or geom with a horizontal top: a box or a cylinder.
        in_region: Lower and upper corner of a box in W [m] in which the object's underside has to be; with `on`, on
            that body only.
        n: Largest number of placements; fewer if there is no space.
        seed: Seed of the samples.

    Raises:
        SettingError: If neither `on` nor `in_region` is given, or the region is empty.
        UnknownNameError: If there is no such object, body or geom.
        UnsupportedError: If there is no horizontal top.
    """
    if on is None and in_region is None:
        raise SettingError("on", None, "a body with a horizontal top, or in_region=")
    if not (is_real(n) and n >= 1):
        raise SettingError("n", n, "at least 1")
    rng = checked_seed(seed)
    note = held_note(scene.model, scene.notes, scene.robot_bodies, name, X_TO=np.eye(4))
    thing = _Standing(scene, note.body)
    tops = [top for top in _tops(thing, on) if top.body != note.body]
    if not tops:
        raise UnsupportedError(f"{on!r} has no horizontal top of a box or cylinder" if on else "nothing has a flat top")
    region = None if in_region is None else _region(in_region)
    if region is not None:
        tops = [top for top in tops if region[0, 2] <= top.X_WG[2, 3] <= region[1, 2]]
    found: list[Array] = []
    areas = np.array([top.half**2 * np.pi if isinstance(top.half, float) else 4.0 * np.prod(top.half) for top in tops])
    for _ in range(_TRIES * int(n) if tops else 0):
        if len(found) == n:
            break
        top = tops[int(rng.choice(len(tops), p=areas / areas.sum()))]
        X_WO = thing.standing(top.sample(rng), 2.0 * np.pi * rng.random())
        feet = thing.feet @ X_WO[:3, :3].T + X_WO[:3, 3]
        inside = region is None or bool(((feet >= region[0]) & (feet <= region[1]))[:, :2].all())
        if inside and bool(top.contains(feet).all()) and thing.blocker(X_WO, top.body, APART) is None:
            found.append(X_WO)
    return np.array(found).reshape(-1, 4, 4)


def support_of(scene: Scene, name: str) -> str | None:
    """Return the body on whose horizontal top an object stands; None if there is none below it."""
    thing = _Standing(scene, name)
    p = thing.X_WO[:3, 3] + thing.X_WO[:3, :3] @ thing.feet.mean(axis=0)
    below = [
        top
        for top in _tops(thing, None)
        if top.body != name and top.contains(p[None]).all() and abs(top.X_WG[2, 3] - p[2]) < 2.0 * _LOW
    ]
    return max(below, key=lambda top: top.X_WG[2, 3]).body if below else None


def occupant(scene: Scene, name: str, X_WO: Float[Array, "4 4"]) -> str | None:
    """Return a body that an object would overlap at a pose; None if the place is free."""
    return _Standing(scene, name).blocker(X_WO, None, -_OVERLAP)


def touched(scene: Scene, name: str) -> set[str]:
    """Return the bodies that an object touches where it stands, such as its support and close neighbours."""
    thing = _Standing(scene, name)
    return set(thing.nearer(thing.X_WO, None, _TOUCHING)) - {""}


def nearer(scene: Scene, names: Sequence[str], than: float) -> Iterator[tuple[str, str]]:
    """Yield pairs of objects that are nearer to each other than a distance [m], unless they may touch in the scene."""
    data = scene.data_at(scene.home_qpos[scene.qpos_adr])
    geoms = {name: colliding_geoms(scene.model, subtree(scene.model, scene.model.body(name).id)) for name in names}
    allowed = scene.allowed_pairs("always") | scene.allowed_pairs("ends")
    for first, second in combinations(names, 2):
        pairs = ((a, b) for a, b in product(geoms[first], geoms[second]) if (min(a, b), max(a, b)) not in allowed)
        if any(mujoco.mj_geomDistance(scene.model, data, a, b, abs(than) + APART, None) < than for a, b in pairs):
            yield first, second


def overlapping(scene: Scene, names: Sequence[str]) -> tuple[str, str] | None:
    """Return the first two of some objects that overlap where they stand in a scene; None if all are apart."""
    return next(nearer(scene, names, -_TOUCHING), None)


class _Standing(Placed):
    """An object that stands in a scene."""

    def __init__(self, scene: Scene, body: str) -> None:
        super().__init__(scene, body)
        others = set(range(self.model.nbody)) - self.bodies - scene.robot_bodies
        self.others = colliding_geoms(self.model, others)
        X_OW, X_WG = np.linalg.inv(self.X_WO), self.X_WO @ self.X_OG
        box = self.model.geom_aabb[list(self.geoms)].reshape(-1, 6)
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
        corners = box[:, None, :3] + signs * box[:, None, 3:]
        corners = np.einsum("gij,gcj->gci", X_WG[:, :3, :3], corners) + X_WG[:, None, :3, 3]
        low = float(corners[..., 2].min())
        feet = corners[corners[..., 2] < low + _LOW].copy()
        feet[:, 2] = low
        self.feet = feet @ X_OW[:3, :3].T + X_OW[:3, 3]
        """Corners in O of what carries the object."""

    def standing(self, p_W: Float[Array, " xyz"], turn: float) -> Float[Array, "4 4"]:
        """Return the pose turned about the vertical axis, with the middle of the feet at a point."""
        X = np.eye(4)
        X[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
        X[:3, :3] = X[:3, :3] @ self.X_WO[:3, :3]
        X[:3, 3] = p_W - X[:3, :3] @ self.feet.mean(axis=0)
        return X

    def blocker(self, X_WO: Float[Array, "4 4"], but: str | None, apart: float) -> str | None:
        """Return a body that is nearer than a distance [m] to the object at a pose, other than its support."""
        return next(self.nearer(X_WO, but, apart), None)

    def nearer(self, X_WO: Float[Array, "4 4"], but: str | None, than: float) -> Iterator[str]:
        """Yield the bodies that are nearer than a distance [m] to the object at a pose, other than one."""
        self.move(self.geoms, X_WO @ self.X_OG)
        for other in self.others:
            body = self.model.body(self.model.geom_bodyid[other]).name
            if body == but:
                continue
            for g in self.geoms:
                if mujoco.mj_geomDistance(self.model, self.data, g, other, abs(than) + APART, None) < than:
                    yield body
                    break


def _tops(thing: _Standing, on: str | None) -> Iterator[_Top]:
    """Yield the horizontal tops of a body or geom, or of everything that is not the robot."""
    model, data = thing.model, thing.data
    geoms = thing.scene.geoms_named(on) if on is not None else thing.others
    for g in geoms:
        kind, size = int(model.geom_type[g]), model.geom_size[g]
        R, p = data.geom_xmat[g].reshape(3, 3), data.geom_xpos[g]
        axis = int(np.argmax(np.abs(R[2])))
        if abs(R[2, axis]) < _LEVEL or kind not in (int(_GEOM.mjGEOM_BOX), int(_GEOM.mjGEOM_CYLINDER)):
            continue
        round_ = kind == int(_GEOM.mjGEOM_CYLINDER)
        if round_ and axis != 2:
            continue
        first, second = R[:, (axis + 1) % 3], R[:, (axis + 2) % 3]
        height = float(size[1] if round_ else size[axis])
        X = pose_matrix(np.stack([first, second, np.cross(first, second)], axis=1), p + [0.0, 0.0, height])
        half = float(size[0]) if round_ else (float(size[(axis + 1) % 3]), float(size[(axis + 2) % 3]))
        yield _Top(body=model.body(model.geom_bodyid[g]).name, X_WG=X, half=half)


def _region(value: ArrayLike) -> Float[Array, "2 xyz"]:
    region = finite_array("in_region", value, ndim=2, last=3)
    if region.shape != (2, 3) or (region[0] > region[1]).any():
        raise SettingError("in_region", region.tolist(), "a lower and an upper corner in W")
    return region


def lid_pose(scene: Scene, vessel: str, lid: str) -> Float[Array, "4 4"]:
    """Return the pose of a lid on a vessel, X_VL: as it is oriented, centred on top of the vessel."""
    under, over = _Standing(scene, vessel), _Standing(scene, lid)
    top = max(
        float((under.X_WO @ X)[2, 3] + np.abs((under.X_WO @ X)[2, :3]) @ scene.model.geom_aabb[g, 3:])
        for g, X in zip(under.geoms, under.X_OG, strict=True)
    )
    middle = under.X_WO[:3, :3] @ under.feet.mean(axis=0) + under.X_WO[:3, 3]
    X_WL = over.standing(np.array([*middle[:2], top]), 0.0)
    return np.linalg.inv(under.X_WO) @ X_WL
