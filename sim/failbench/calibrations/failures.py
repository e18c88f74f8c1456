"""Outcomes of failures, event by event, for fitting and evaluating failure models.

Each rollout has the fault, and the configuration and velocity that models predict its outcome from. For every entity it
tells whether body, carried object or contents touched it. Later touches among entities, and touches of the healthy run,
do not count.

Models predict from the planned state at the onset. A grip that weakens along a ramp is the exception: the object stays
in the fingers until little force is left, and models of drops predict from the state of the release. That state is the
planned one at the end of the ramp.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from failbench.basics.errors import ExecutionRefused
from failbench.calibrations.varied import Variation, bounce, spun
from failbench.fault.end_effector import GripperFailure, WeakGrip
from failbench.fault.fault import Fault
from failbench.recording.records import Rollout
from failbench.rollouts.execution import Execution, execute
from failbench.rollouts.rollout import run_rollouts
from failbench.rollouts.sampling import make_requests
from failbench.simulated.world import SimSettings, build_world
from graceful_plan import Scene, StateBatch, Trajectory
from graceful_plan.array_types import Array, Bool, Float, Int
from graceful_plan.costs.cost import AHEAD
from graceful_plan.costs.objective import moving_batch
from graceful_plan.exceptions import FormatError, SettingError
from graceful_plan.formats.npz_file import read_arrays
from graceful_plan.untrusted_json import parse_json

_SCHEMA, _VERSION = "failbench.failures", 1
DROP: tuple[Fault, ...] = (GripperFailure(degree="critical"),)
"""Immediate release by the gripper."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Failures:
    """The failures along one motion. Made by `simulate_failures`.

    | field      | meaning                                                               | shape              |
    | ---------- | --------------------------------------------------------------------- | ------------------ |
    | scene      | name of the scene                                                     |                    |
    | task       | name of the task, whose object is carried                             |                    |
    | motion     | kind of the motion, if known                                          |                    |
    | grasp      | how the object was held: "fingers" or "weld"                          |                    |
    | components | names of the components, in the order of the scene                    | component          |
    | entities   | names of the entities, in the order of the scene                      | entity             |
    | categories | classes of the entities                                               | entity             |
    | faults     | labels of the faults, see `fault_label`                               | fault              |
    | counted    | whether the pair counts: False if it touches in the healthy run       | component entity   |
    | fault      | fault of each rollout, as an index into `faults`                      | n                  |
    | q          | planned configuration at the onset, or at the release [rad or m]      | n nq               |
    | qd         | planned velocity at that time                                         | n nq               |
    | ahead      | planned configurations `AHEAD` after that time [rad or m]             | n step nq          |
    | hit        | whether the component touched the entity                              | n component entity |
    | dropped    | whether the object left the gripper                                   | n                  |
    | spilled    | lost fraction of the contents                                         | n                  |
    | lost       | number of diverged rollouts, which are left out                       |                    |
    """

    scene: str
    task: str
    motion: str
    grasp: str
    components: tuple[str, ...]
    entities: tuple[str, ...]
    categories: tuple[str, ...]
    faults: tuple[str, ...]
    counted: Bool[Array, "component entity"]
    fault: Int[Array, " n"]
    q: Float[Array, "n nq"]
    qd: Float[Array, "n nq"]
    ahead: Float[Array, "n step nq"]
    hit: Bool[Array, "n component entity"]
    dropped: Bool[Array, " n"]
    spilled: Float[Array, " n"]
    lost: int = 0

    def __len__(self) -> int:
        return len(self.q)

    def states(self, scene: Scene) -> StateBatch:
        """Return the states that models predict from, in the scene of the failures."""
        found = moving_batch(scene, self.q, self.qd)
        return StateBatch(scene, self.q, found.direction, found.speed, ahead=self.ahead)

    def only(self, faults: Iterable[str]) -> Failures:
        """Return the failures of some faults, by the faults' labels."""
        return self.where(np.isin(self.fault, [self.faults.index(name) for name in faults if name in self.faults]))

    def where(self, rows: Bool[Array, " n"]) -> Failures:
        """Return a subset of the failures."""
        names = ("fault", "q", "qd", "ahead", "hit", "dropped", "spilled")
        return replace(self, **{name: getattr(self, name)[rows] for name in names})

    def events(self, components: Sequence[str]) -> tuple[Bool[Array, "n entity"], Bool[Array, " entity"]]:
        """Return the entities that any of some components touched, and the entities that count for all of these."""
        rows = [self.components.index(name) for name in components]
        return np.any(self.hit[:, rows], axis=1), np.all(self.counted[rows], axis=0)


def fault_label(fault: Fault) -> str:
    """Return the label of a fault: its name, and its targets if they are set."""
    return " ".join((fault.NAME, *fault.targets))


def release_delay(fault: Fault) -> float:
    """Return the time from the onset of a fault to the state that models predict from [s]; 0 except for weak grips.

    Fingers hold with a multiple of the weight of household objects, so friction gives way near the end of the ramp.
    """
    return fault.ramp if isinstance(fault, WeakGrip) else 0.0


def simulate_failures(
    motion: Trajectory,
    scene: Scene,
    faults: Sequence[Fault] = DROP,
    *,
    n: int,
    seed: int = 0,
    task: str = "",
    horizon: float = 1.0,
    threads: int = 1,
    variation: Variation | None = None,
) -> Failures:
    """Simulate many failures along a motion, and return the hits.

    The fingers hold the object if they can, otherwise a weld does.

    Args:
        motion: The motion.
        scene: The scene, with the object attached if there is one.
        faults: Faults to simulate, each with its label; by default, the gripper releases the object.
        n: Number of failures, rounded up to a multiple of the number of faults.
        seed: Seed of all random numbers.
        task: Name of the task, for the record.
        horizon: Simulated time after the onset [s].
        threads: Number of simulation threads; it does not affect the result.
        variation: Deviation of the carried object from the scene's; None for none.

    Raises:
        ExecutionRefused: If the healthy robot cannot execute the motion with either grasp.
        SettingError: If no object is carried and all faults are of the gripper.
    """
    if scene.carried is None and all(fault.NAME == GripperFailure.NAME for fault in faults):
        raise SettingError("scene", scene.name, "one with an object in the gripper, such as task.scene")
    execution = _held(motion, scene, variation, seed)
    jobs = make_requests(faults, execution.duration, n=n, seed=seed)
    rollouts = run_rollouts(execution, jobs, horizon=horizon, threads=threads)
    completed = [rollout for rollout in rollouts if rollout.status == "completed"]
    # The state that a planner knows: the planned one, not the one that the servos reach.
    moment = motion.t[0] + np.array([rollout.onset + release_delay(rollout.job.fault) for rollout in completed])
    state = motion.at(moment)
    names = tuple(dict.fromkeys(fault_label(fault) for fault in faults))
    components, entities = tuple(scene.components), tuple(scene.entities)
    return Failures(
        scene=scene.name,
        task=task,
        motion="",
        grasp=execution.world.settings.grasp,
        components=components,
        entities=entities,
        categories=tuple(entity.category for entity in scene.entities.values()),
        faults=names,
        counted=np.array(
            [[(part, name) not in execution.baseline for name in entities] for part in components], dtype=bool
        ).reshape(len(components), len(entities)),
        fault=np.array([names.index(fault_label(rollout.job.fault)) for rollout in completed], dtype=np.int64),
        q=state.q,
        qd=state.qd,
        ahead=motion.at(moment[:, None] + AHEAD).q,
        hit=_hits(completed, components, entities),
        dropped=np.array([rollout.dropped for rollout in completed], dtype=bool),
        spilled=np.array([rollout.spilled for rollout in completed], dtype=float),
        lost=len(rollouts) - len(completed),
    )


def _held(motion: Trajectory, scene: Scene, variation: Variation | None, seed: int) -> Execution:
    def held_by(grasp: str) -> Execution:
        world = build_world(scene, SimSettings(grasp=grasp))
        if variation is None:
            return execute(motion, world)
        bounce(world, variation, seed)
        return spun(execute(motion, world), variation, seed)

    try:
        return held_by("fingers")
    except ExecutionRefused:
        return held_by("weld")


def _hits(
    rollouts: Sequence[Rollout], components: tuple[str, ...], entities: tuple[str, ...]
) -> Bool[Array, "n component entity"]:
    hit = np.zeros((len(rollouts), len(components), len(entities)), dtype=bool)
    row, column = ({name: i for i, name in enumerate(names)} for names in (components, entities))
    for mine, rollout in zip(hit, rollouts, strict=True):
        for event in rollout.events:
            if not event.secondary:
                mine[row[event.striker], column[event.entity]] = True
    return hit


# --- files -----------------------------------------------------------------------------------------------------------

_TEXTS = ("scene", "task", "motion", "grasp", "components", "entities", "categories", "faults", "lost")
_ARRAYS = ("counted", "fault", "q", "qd", "ahead", "hit", "dropped", "spilled")


def write_failures(file: str | FilePath, failures: Iterable[Failures]) -> None:
    """Write failures into one compressed NumPy file."""
    arrays: dict[str, Array] = {}
    about: list[dict[str, Any]] = []
    for i, part in enumerate(failures):
        about.append({name: getattr(part, name) for name in _TEXTS})
        arrays |= {f"{i}.{name}": getattr(part, name) for name in _ARRAYS}
    document = {"schema": _SCHEMA, "version": _VERSION, "motions": about}
    with FilePath(file).open("wb") as out:
        np.savez_compressed(out, about=np.array(json.dumps(document)), **arrays)  # pyright: ignore[reportArgumentType]


def read_failures(file: str | FilePath) -> list[Failures]:
    """Read a file written by `write_failures`.

    Raises:
        FormatError: If the file holds something else.
    """
    data: dict[str, Any] = dict(read_arrays(file))
    try:
        document = parse_json(str(data["about"]), str(file))
        if (document["schema"], document["version"]) != (_SCHEMA, _VERSION):
            raise FormatError(str(file), f"not {_SCHEMA} of version {_VERSION}")
        return [
            Failures(
                **{name: tuple(x) if isinstance(x, list) else x for name, x in about.items()},
                **{name: data[f"{i}.{name}"] for name in _ARRAYS},
            )
            for i, about in enumerate(document["motions"])
        ]
    except FormatError:
        raise
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise FormatError(str(file), f"not a file of failures: {error}") from None
