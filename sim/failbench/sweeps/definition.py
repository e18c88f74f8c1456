"""Definition of a sweep: its motions, faults and number of rollouts, its JSON form, and its chunks."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from types import NoneType
from typing import Any, get_type_hints

import graceful_plan as gp
from failbench.basics.chunks import Chunk
from failbench.fault.registry import Fault, from_document, load_class
from failbench.rollouts.execution import LONGEST
from failbench.rollouts.sampling import MOST, check_whole
from failbench.simulated.world import SimSettings
from failbench.surroundings.registry import disturbances
from graceful_plan import Scene, Trajectory
from graceful_plan.exceptions import FormatError, GracefulPlanError, SettingError, UnknownNameError, naming
from graceful_plan.formats.samples import text_of
from graceful_plan.path import plain_numbers
from graceful_plan.untrusted_json import check_form, parse_json

_SCHEMA = "failbench.sweep"
_VERSION = 1
_FORM = {"schema": str, "version": int, "motions": list, "faults": list, "settings": dict}
_FORM |= {"rollouts": int, "horizon": float, "seed": int}
_MOTION = {"name": str, "scene": str, "task": (str, NoneType), "grasp": (str, NoneType)}
_MOTION |= {"plan": (dict, NoneType), "trajectory": (dict, NoneType)}
"""Types of the values of a document, and of a motion in it."""

CHUNK = 32
"""Greatest number of rollouts in a chunk: one batch of simulations, at most a second of work."""


@dataclass(frozen=True, kw_only=True)
class PlanSettings:
    """Settings of a planned motion; the same settings give the same motion.

    Args:
        w: Safety weight.
        planner: Name of a planner.
        iterations: Planner iterations.
        seed: Seed of the planner.
        speed: Fraction of the velocity limits to use.
    """

    w: float = 1.0
    planner: str = "auto"
    iterations: int = 2000
    seed: int = 0
    speed: float = 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class SweepMotion:
    """A motion during which faults occur: a trajectory, or the settings to plan one.

    Args:
        name: Name in the dataset.
        scene: Bundled scene, or scene file.
        task: Task of the scene whose object is carried; None carries nothing.
        plan: Planning settings; None if the trajectory is given.
        trajectory: The trajectory; None if it is not planned yet.
        grasp: How the object is held; None for the sweep's settings.
    """

    name: str
    scene: str
    task: str | None = None
    plan: PlanSettings | None = None
    trajectory: Trajectory | None = None
    grasp: str | None = None

    def __post_init__(self) -> None:
        if self.grasp is not None:
            SimSettings(grasp=self.grasp)  # raises unless valid
        if self.plan is None and self.trajectory is None:
            raise SettingError(f"trajectory of motion {self.name!r}", None, "a trajectory, or plan settings")
        if self.plan is not None and self.task is None:
            raise SettingError(f"task of motion {self.name!r}", None, "a task, whose start and goal are planned for")

    def planned(self) -> SweepMotion:
        """Return the motion with its trajectory, planned if necessary.

        Raises:
            PlanningFailed: If planning fails.
        """
        if self.plan is None or self.trajectory is not None or self.task is None:
            return self
        task = _task(self.scene, self.task)
        return replace(self, trajectory=gp.plan(task.start, task.goal, task.scene, **asdict(self.plan)).unwrap())


@dataclass(frozen=True, kw_only=True, eq=False)
class Sweep:
    """Every fault on every motion, a number of times with different onsets.

    Args:
        motions: Motions during which the faults occur.
        faults: Faults as documents (`failbench.fault.registry.to_document`); a user-defined fault has the name
            "path/to/file.py:ClassName" there.
        rollouts: Number of rollouts of each fault on each motion.
        horizon: Simulated time after the onset [s].
        seed: Seed of all random numbers except the planner's. Rollout i has the same random numbers for all faults and
            motions.
        settings: Settings of the simulation.
    """

    motions: tuple[SweepMotion, ...]
    faults: tuple[Mapping[str, Any], ...]
    rollouts: int
    horizon: float = 1.0
    seed: int = 0
    settings: SimSettings = SimSettings()

    def __post_init__(self) -> None:
        plain_numbers(self)
        names = [motion.name for motion in self.motions]
        if not names or len(set(names)) < len(names):
            raise SettingError("motions", names, "at least one, all of different names")
        if not self.faults:
            raise SettingError("faults", self.faults, "at least one")
        check_whole("rollouts", self.rollouts, 1, MOST // (len(self.motions) * len(self.faults)))
        check_whole("seed", self.seed, 0)
        if not self.settings.timestep <= self.horizon <= LONGEST:
            raise SettingError("horizon", self.horizon, f"between {self.settings.timestep:g} s and {LONGEST:g} s")

    @cached_property
    def chunks(self) -> tuple[Chunk, ...]:
        """Chunks of the sweep; they depend on the sweep alone."""
        pieces = [
            (m, f, first, min(first + CHUNK, self.rollouts))
            for m in range(len(self.motions))
            for f in range(len(self.faults))
            for first in range(0, self.rollouts, CHUNK)
        ]
        return tuple(
            Chunk(index=i, motion=m, fault=f, first=first, last=last, name=self._chunk_name(m, f, first, last))
            for i, (m, f, first, last) in enumerate(pieces)
        )

    def _chunk_name(self, motion: int, fault: int, first: int, last: int) -> str:
        what = self.faults[fault]
        struck = f"{what.get('fault')} {what.get('degree', '')}".strip()
        return f"{self.motions[motion].name} / {struck} / rollouts {first}-{last - 1}"

    def first_rollout(self, chunk: Chunk) -> int:
        """Return the number of a chunk's first rollout in the whole sweep."""
        return (chunk.motion * len(self.faults) + chunk.fault) * self.rollouts + chunk.first

    def place(self, rollout: int) -> tuple[int, int, int]:
        """Return the indices of motion, fault and repetition of the rollout with this number.

        Raises:
            SettingError: If there is no such rollout.
        """
        total = len(self.motions) * len(self.faults) * self.rollouts
        if not 0 <= rollout < total:
            raise SettingError("rollout", rollout, f"between 0 and {total - 1}")
        both, i = divmod(rollout, self.rollouts)
        return *divmod(both, len(self.faults)), i

    def to_document(self) -> dict[str, Any]:
        """Return the sweep as JSON values."""
        motions = [
            {
                "name": motion.name,
                "scene": motion.scene,
                "task": motion.task,
                "plan": None if motion.plan is None else asdict(motion.plan),
                "trajectory": None if motion.trajectory is None else json.loads(motion.trajectory.to_json()),
                "grasp": motion.grasp,
            }
            for motion in self.motions
        ]
        own = {name: getattr(self, name) for name in ("rollouts", "horizon", "seed")}
        return {
            "schema": _SCHEMA,
            "version": _VERSION,
            **own,
            "motions": motions,
            "faults": [dict(fault) for fault in self.faults],
            "settings": asdict(self.settings),
        }

    @classmethod
    def from_document(cls, document: Any, source: str = "sweep") -> Sweep:
        """Read a document made by `to_document`.

        Raises:
            FormatError: If it is not such a document, or of another version.
            SettingError: If a setting is out of its range.
        """
        with naming(source):
            return cls._read(document, source)

    @classmethod
    def _read(cls, document: Any, source: str) -> Sweep:
        check_form(source, document, _FORM)
        for key, value in (("schema", _SCHEMA), ("version", _VERSION)):
            if document[key] != value:
                raise FormatError(source, f"{key} is {document[key]!r}, this version reads {value!r}")
        for i, fault in enumerate(document["faults"]):
            if not isinstance(fault, dict):
                raise FormatError(source, f"fault {i} has to be an object, not {fault!r:.100}")
        settings = {"people": "walk"} | document["settings"]  # which earlier documents do not have
        check_form(f"{source}: settings", settings, get_type_hints(SimSettings))
        return cls(
            motions=tuple(_motion(motion, f"{source}: motion {i}") for i, motion in enumerate(document["motions"])),
            faults=tuple(map(dict, document["faults"])),
            settings=SimSettings(**settings),
            **{name: document[name] for name in ("rollouts", "horizon", "seed")},
        )

    @classmethod
    def from_json(cls, file: str | Path) -> Sweep:
        """Read a document from a file.

        Raises:
            FormatError: If the file cannot be read or holds no such document, or a setting is out of its range.
        """
        try:
            return cls.from_document(parse_json(text_of(file, lambda _: False, "JSON")[1], str(file)), str(file))
        except FormatError as error:
            raise FormatError(str(file), error.problem) from None
        except GracefulPlanError as error:
            raise FormatError(str(file), str(error)) from None

    @property
    def question(self) -> dict[str, Any]:
        """Definition of the sweep as JSON values: its document without planned trajectories."""
        unplanned = (motion if motion.plan is None else replace(motion, trajectory=None) for motion in self.motions)
        return replace(self, motions=tuple(unplanned)).to_document()

    def planned(self) -> Sweep:
        """Return the sweep with all trajectories planned.

        Raises:
            PlanningFailed: If planning fails.
        """
        return replace(self, motions=tuple(motion.planned() for motion in self.motions))


def fault_of(document: Mapping[str, Any]) -> Fault:
    """Return the fault that a sweep's document describes.

    Raises:
        UnknownNameError: If there is no such fault or setting.
        FormatError: If the named file has no such fault.
    """
    name = str(document.get("fault"))
    if not own_file(document):
        return from_document(document, disturbances())
    fault = _own_class(name)
    return from_document({**document, "fault": fault.NAME}, {fault.NAME: fault})


def own_file(document: Mapping[str, Any]) -> str:
    """Return the file of a document's user-defined fault; "" for a fault of FailBench."""
    file, colon, _ = str(document.get("fault")).rpartition(":")
    return file if colon else ""


_own_class = lru_cache(maxsize=None)(load_class)  # all chunks must share one class object


def scene_of(scene: str, task: str | None) -> Scene:
    """Return a scene with the object of a task in the gripper.

    Raises:
        UnknownNameError: If there is no such scene or task.
    """
    return gp.load_scene(scene) if task is None else _task(scene, task).scene


def _task(scene: str, task: str) -> gp.Task:
    tasks = gp.load_scene(scene).tasks
    if task not in tasks:
        raise UnknownNameError(f"task of {scene}", task, tasks)
    return tasks[task]


def _motion(document: Any, source: str) -> SweepMotion:
    check_form(source, document, _MOTION)
    plan, trajectory = document["plan"], document["trajectory"]
    if plan is not None:
        check_form(f"{source}: plan", plan, get_type_hints(PlanSettings))
    return SweepMotion(
        name=document["name"],
        scene=document["scene"],
        task=document["task"],
        plan=None if plan is None else PlanSettings(**plan),
        trajectory=None if trajectory is None else Trajectory.from_json(json.dumps(trajectory)),
        grasp=document["grasp"],
    )
