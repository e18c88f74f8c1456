"""Five jobs and three larger ones with drawn poses and severities; nothing of the library was fitted on them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import graceful_plan as gp
from graceful_plan.core.frames import pose_matrix
from graceful_plan.job.placing import APART, nearer, occupant, overlapping

FOLDER = Path(__file__).parent
SEED = 42
SHIFT, GOAL_SHIFT = 0.03, 0.02
"""Largest shift of objects and of their goals along x and y [m]."""
FACTOR = 2.0
"""Largest factor of a severity, up or down."""


@dataclass(frozen=True, kw_only=True)
class JobKind:
    """A job before poses and severities are drawn."""

    goals: Mapping[str, Sequence[float]]
    """Position of each object in the end [m]."""
    on_tray: tuple[str, ...] = ()
    """Objects that have to stand on the tray in the end."""
    extras: tuple[gp.Clear | gp.CloseLid, ...] = ()
    """Actions that are no part of the goal and cost motion: only harm can make them pay."""
    others: tuple[str, ...] = ()
    """Further bodies that are shifted."""
    precious: tuple[str, ...] = ()
    """Entities whose severities are drawn."""
    is_small: bool = False
    """Whether an exhaustive search takes seconds."""


KINDS: Mapping[str, JobKind] = {
    "lid": JobKind(
        goals={"kettle": (0.5, 0.3, 0.4)},
        extras=(gp.CloseLid("kettle", "lid"),),
        others=("laptop", "lid"),
        precious=("laptop",),
        is_small=True,
    ),
    "clear_once": JobKind(
        goals={f"mug{i + 1}": (0.5, 0.25 + 0.11 * i, 0.4) for i in range(3)},
        extras=(gp.Clear("laptop", on="side_table"),),
        others=("laptop",),
        precious=("laptop",),
    ),
    "order": JobKind(goals={"dome": (0.5, 0.12, 0.4), "crate": (0.5, 0.48, 0.4)}, precious=("dome",), is_small=True),
    "person": JobKind(
        goals={"mug": (0.6, 0.3, 0.4), "crate": (0.4, 0.4, 0.4), "box": (0.4, 0.2, 0.4)}, precious=("guest",)
    ),
    "tray": JobKind(
        goals={"tray": (0.48, 0.3, 0.4)},
        on_tray=("glass1", "glass2"),
        others=("laptop",),
        precious=("laptop",),
    ),
}

LARGER: Mapping[str, JobKind] = {
    "lay": JobKind(
        goals={
            "plate": (0.55, 0.29, 0.4),
            "bowl": (0.55, 0.12, 0.4),
            "wine_glass": (0.42, 0.18, 0.4),
            "tumbler": (0.42, 0.33, 0.4),
            "mug": (0.51, 0.45, 0.4),
            "vase": (0.27, 0.37, 0.4),
            "salt": (0.28, 0.17, 0.4),
            "bread_basket": (0.36, 0.53, 0.4),
        },
        precious=("vase", "candle", "person_head", "person_torso", "person_left_hand", "person_right_hand"),
    ),
    "clear_desk": JobKind(
        goals={
            "phone": (0.32, 0.4, 0.4),
            "mug": (0.47, 0.38, 0.4),
            "vase": (0.31, 0.55, 0.4),
            "glass": (0.45, 0.52, 0.4),
            "pen_cup": (-0.01, 0.5, 0.45),
            "book": (-0.15, 0.5, 0.45),
            "stapler": (0.14, 0.49, 0.45),
        },
        extras=(gp.Clear("laptop", on="stand"),),
        others=("laptop",),
        precious=("laptop", "monitor", "vase", "phone"),
    ),
    "groceries": JobKind(
        goals={
            "oil": (0.47, 0.16, 0.45),
            "juice": (0.47, 0.3, 0.45),
            "jar": (0.47, 0.44, 0.45),
            "eggs": (0.31, 0.2, 0.4),
            "bread": (0.31, 0.38, 0.4),
            "tin": (0.31, 0.52, 0.4),
        },
        precious=("child",),
    ),
}
"""Jobs with six to eight objects."""

ALL: Mapping[str, JobKind] = {**KINDS, **LARGER}
"""Numbers are drawn by the position in this table: new jobs come last."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Variant:
    """A job with drawn poses and severities."""

    scene: gp.Scene
    kind: JobKind
    goals: Mapping[str, np.ndarray]

    @property
    def objects(self) -> int:
        """Number of objects with a goal."""
        return len(self.goals) + len(self.kind.on_tray)

    def job(self, *, extras: bool = True) -> gp.Job:
        """Return the job, with or without actions that only harm can make pay."""
        job = gp.Job(self.scene)
        for name, at in self.goals.items():
            job.place(name, at=at)
        for name in self.kind.on_tray:
            job.place(name, on="tray")
        if self.kind.on_tray:
            job.allow(gp.Load("tray"))
        return job.allow(*self.kind.extras) if extras else job


def variant(name: str, number: int) -> Variant:
    """Draw a variant of a job; number 0 is the scene as it is."""
    kind, scene = ALL[name], gp.load_scene(FOLDER / f"{name}.yaml")
    goals = {body: np.array(at) for body, at in kind.goals.items()}
    if number == 0:
        return Variant(scene=scene, kind=kind, goals=goals)
    rng = np.random.default_rng([SEED, list(ALL).index(name), number])
    data = scene.data_at(scene.keyframes["ready"])
    bodies = (*kind.goals, *kind.on_tray, *kind.others)
    while True:  # until no two objects are in one place
        moved = {body: data.body(body).xpos + [*rng.uniform(-SHIFT, SHIFT, 2), 0.0] for body in bodies}
        drawn = scene.edit(move=moved)
        if any(occupant(drawn, body, standing(drawn, body)) for body in bodies):
            continue
        if overlapping(drawn, bodies) is None:
            break
    while True:  # until places are as far apart as those that a job samples itself
        goals = {body: np.add(at, [*rng.uniform(-GOAL_SHIFT, GOAL_SHIFT, 2), 0.0]) for body, at in kind.goals.items()}
        if next(nearer(drawn.edit(move=goals), list(goals), APART), None) is None:
            break
    factors = {body: float(FACTOR ** rng.uniform(-1.0, 1.0)) for body in kind.precious}
    table = scene.notes.severity
    severity = {}
    for body, factor in factors.items():
        note = scene.moving[body] if body in scene.moving else scene.entities[body]
        severity[body] = {component: factor * value for component, value in table.rows[note.category].items()}
    return Variant(scene=drawn.with_severity(severity), kind=kind, goals=goals)


def standing(scene: gp.Scene, body: str) -> np.ndarray:
    """Return the pose of a body in W."""
    found = scene.data_at(scene.keyframes["ready"]).body(body)
    return pose_matrix(found.xmat, found.xpos)
