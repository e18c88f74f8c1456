"""Drops in generated scenes, and the training data of a network."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from failbench.calibrations.failure_jobs import FailureJob, Progress, failure_jobs, run_jobs
from failbench.calibrations.failures import Failures
from failbench.learning.generated import PREFIX, generated_scene, scene_names
from failbench.rollouts.sampling import MOST, check_whole
from graceful_plan import Scene, load_scene, scenes
from graceful_plan.array_types import Array, Bool, Float, Int
from graceful_plan.costs.models.drop.constants import DropSettings
from graceful_plan.costs.models.drop.kernel import drop_kernel
from graceful_plan.costs.models.drop.network import LEAST, looks
from graceful_plan.costs.models.drop.tables import SHAPE_CLASSES, drop_tables
from graceful_plan.path import plain_numbers

_STRIDE = 2
"""Each task gets every second kind of motion, alternating between tasks."""


@dataclass(frozen=True, kw_only=True)
class DropData:
    """Numbers of generated scenes and drops.

    Args:
        scenes: Number of generated scenes.
        rollouts: Approximate number of drops in all of them.
        seed: Seed of scenes and drops. Results depend on it alone, not on `processes`.
        processes: Number of processes.
    """

    scenes: int = 180
    rollouts: int = 15000
    seed: int = 0
    processes: int = 1

    def __post_init__(self) -> None:
        plain_numbers(self)
        check_whole("scenes", self.scenes, 2, MOST)
        check_whole("rollouts", self.rollouts, 1, MOST)
        check_whole("seed", self.seed, 0, MOST)


def drop_jobs(data: DropData) -> list[FailureJob]:
    """Return jobs in generated scenes, along every second kind of motion for each task."""
    names = scene_names(data.scenes, first=data.seed * 100_000)
    jobs = failure_jobs(generated_scene, names, n=1, seed=data.seed)[::_STRIDE]
    n = max(1, round(data.rollouts / len(jobs)))
    return [replace(job, n=n) for job in jobs]


def bundled_jobs(data: DropData) -> list[FailureJob]:
    """Return jobs in bundled scenes, for the selection of networks; as many drops along each motion."""
    n = drop_jobs(data)[0].n
    return failure_jobs(load_scene, scenes(), n=n, seed=data.seed)[::_STRIDE]


def drop_things(data: DropData, progress: Progress | None = None) -> tuple[list[Failures], list[str]]:
    """Simulate drops in generated and bundled scenes; return them, and the reasons why motions have none."""
    return run_jobs([*drop_jobs(data), *bundled_jobs(data)], data.processes, progress)


def scene_of(name: str) -> Scene:
    """Load a generated or a bundled scene."""
    return generated_scene(name) if name.startswith(PREFIX) else load_scene(name)


@dataclass(frozen=True, kw_only=True, eq=False)
class Pairs:
    """Pairs of a drop and an entity, with the surfaces of the entity that the object may hit, as rows.

    | field   | meaning                                                        | shape          |
    |---------|----------------------------------------------------------------|----------------|
    | told    | network inputs of state and surface                            | surface told   |
    | looks   | network inputs of the surface alone                            | surface looks  |
    | shape   | one-hot shape class of the dropped object                      | surface shape  |
    | plain   | P of a hit by the drop model                                   | surface        |
    | first   | index of each pair's first surface                             | pair           |
    | hit     | whether the entity was hit                                     | pair           |
    | chooses | whether the pair selects networks: it is of a bundled scene    | pair           |
    | motion  | number of the motion                                           | pair           |
    """

    told: Float[Array, "surface told"]
    looks: Float[Array, "surface looks"]
    shape: Float[Array, "surface shape"]
    plain: Float[Array, " surface"]
    first: Int[Array, " pair"]
    hit: Bool[Array, " pair"]
    chooses: Bool[Array, " pair"]
    motion: Int[Array, " pair"]

    def __len__(self) -> int:
        return len(self.hit)

    def of(self, chosen: Bool[Array, " pair"]) -> Pairs:
        """Return a subset of the pairs."""
        counts = np.diff(np.append(self.first, len(self.plain)))
        rows = np.repeat(chosen, counts)
        first = np.concatenate([[0], np.cumsum(counts[chosen])[:-1]]).astype(np.int64)[: int(chosen.sum())]
        surfaces = {name: getattr(self, name)[rows] for name in ("told", "looks", "shape", "plain")}
        pairs = {name: getattr(self, name)[chosen] for name in ("hit", "chooses", "motion")}
        return Pairs(**surfaces, first=first, **pairs)


def pairs_of(failures: Sequence[Failures], load: Callable[[str], Scene] = scene_of) -> Pairs:
    """Return the training pairs of drops: those with a P above the threshold of the network."""
    found = [_pairs(part, load(part.scene).tasks[part.task].scene) for part in failures]
    starts = np.cumsum([0, *(len(part["plain"]) for part in found)])
    columns: dict[str, Any] = {
        name: np.concatenate([part[name] for part in found]) for name in ("told", "looks", "shape", "plain", "hit")
    }
    columns["first"] = np.concatenate([part["first"] + s for part, s in zip(found, starts, strict=False)])
    columns["chooses"] = np.concatenate(
        [np.full(len(x["hit"]), not part.scene.startswith(PREFIX)) for x, part in zip(found, failures, strict=True)]
    )
    columns["motion"] = np.concatenate([np.full(len(x["hit"]), i) for i, x in enumerate(found)])
    return Pairs(**{field.name: columns[field.name] for field in fields(Pairs)})


def _pairs(part: Failures, scene: Scene) -> Mapping[str, Array]:
    tables = drop_tables(scene)
    sights = drop_kernel(scene, DropSettings.shipped()).sights(part.q, part.qd)
    hit, counted = part.events(["carried"])
    # By state, then by entity, so that surfaces of an entity are consecutive.
    order = np.argsort(tables.target_entity, kind="stable")
    entity = tables.target_entity[order]
    sights, seen = sights[:, order], looks(tables)[order]
    kept = (sights[..., -1] > LEAST) & (entity >= 0) & np.append(counted, False)[entity]
    state, surface = np.nonzero(kept)
    pair = state * len(counted) + entity[surface]
    first = np.flatnonzero(np.append(True, np.diff(pair) != 0)) if len(pair) else np.zeros(0, dtype=np.int64)
    rows = sights[state, surface]
    return {
        "told": rows[:, :-1],
        "looks": seen[surface],
        "shape": np.tile(np.eye(len(SHAPE_CLASSES))[tables.shape_class], (len(rows), 1)),
        "plain": rows[:, -1],
        "first": first,
        "hit": hit[state[first], entity[surface[first]]],
    }
