"""Harm of the healthy robot: it happens with probability 1, before any failure.

Contents poured out on the way reach entities by the same puddle model as after a failure. Touches that the scene does
not allow, and hits of an object that slips out of the healthy gripper, are added to the same sum.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, NamedTuple

import numpy as np

from failbench.recording.contact_query import ContactQuery
from failbench.recording.puddle import Parcel, Puddles
from failbench.recording.recorder import Recorder
from failbench.recording.records import ContactEvent, Rollout
from failbench.recording.score import Touches, impact_by_entity
from failbench.recording.spill import HealthyLoss, healthy_loss
from failbench.simulated.moving_entities import EntityPoses, append_entity_states
from failbench.simulated.states import CHECKPOINT
from failbench.simulated.world import World
from graceful_plan import Scene
from graceful_plan.array_types import Array, Float


@dataclass(frozen=True, kw_only=True, eq=False)
class HealthyHarm:
    """Harm of a healthy run. Made by `execute`.

    Args:
        carried: Name of the carried object; "" if there is none.
        contents: Class of its contents, such as "hot"; "" if there are none.
        spilled: Fraction of the contents that is lost on the way, in [0, 1].
        kept: Remaining volume of the contents at each checkpoint [m^3]; None if there is no container.
        dropped: Whether the object left the gripper.
        events: Touches of entities by contents, object and robot, in the order of time; times are after the start of
            the motion [s]. Initial touches and touches that the scene allows are left out.
        landings: Other touches of the object, as in a `Rollout`; they may damage the object itself.
        poured: For each entity that contents reach, the time when enough had left to reach it [s].
        by_entity: Severity by entity, the carried object itself last, as for a failure.
    """

    carried: str = ""
    contents: str = ""
    spilled: float = 0.0
    kept: Float[Array, " checkpoint"] | None = None
    dropped: bool = False
    events: tuple[ContactEvent, ...] = ()
    landings: tuple[ContactEvent, ...] = ()
    poured: Mapping[str, float] = field(default_factory=dict)
    by_entity: Mapping[str, float] = field(default_factory=dict)

    @property
    def harm(self) -> float:
        """Sum of the severities of all hits, as after a failure."""
        return math.fsum(self.by_entity.values())

    @property
    def harmless(self) -> bool:
        """Whether nothing is spilt, dropped or touched."""
        return not (self.spilled or self.dropped or self.events)

    def __str__(self) -> str:
        """Describe the harm in one sentence; "" if there is none."""
        if self.harmless:
            return ""
        touched = dict.fromkeys(e.entity for e in self.events if e.striker != "contents" and not e.secondary)
        said = [
            f"pours out {100.0 * self.spilled:.3g} % of the contents of {self.carried!r} ({self.contents})"
            if self.spilled
            else "",
            f"drops {self.carried!r}" if self.dropped else "",
            f"touches {', '.join(touched)}" if touched else "",
        ]
        hit = sorted(((name, x) for name, x in self.by_entity.items() if x > 0.0), key=lambda item: -item[1])
        shares = ": " + ", ".join(f"{name} {x:.3g}" for name, x in hit) if hit else ""
        done = " and ".join(part for part in said if part)
        return f"the healthy robot {done}: harm {self.harm:.3g} with probability 1, before any failure{shares}"

    def to_document(self) -> dict[str, Any]:
        """Return the harm as plain values."""
        return {
            "harm": self.harm,
            "spilled": self.spilled,
            "dropped": self.dropped,
            "by_entity": dict(self.by_entity),
            "events": [asdict(event) for event in self.events],
        }


class ExecutionTouches(NamedTuple):
    """Touches of an execution, before and after a failure; each pair of things is listed once."""

    events: tuple[ContactEvent, ...]
    landings: tuple[ContactEvent, ...]


def whole_execution(rollout: Rollout, healthy: HealthyHarm) -> ExecutionTouches:
    """Return all touches of an execution that ends in a failure, before and after its onset.

    Contents that left before the onset count as the healthy run's; the rest counts as the failure's. Other touches of
    the healthy run count whenever the failure begins, since rollouts leave them out.

    Args:
        rollout: The rollout from the onset on.
        healthy: Harm of the same execution without a failure.
    """
    own = {(event.striker, event.entity) for event in rollout.events if not event.secondary}
    before = [event for event in healthy.events if _had_happened(event, healthy, rollout.onset)]
    return ExecutionTouches(
        (*(event for event in before if (event.striker, event.entity) not in own), *rollout.events),
        (*healthy.landings, *rollout.landings),
    )


def _had_happened(event: ContactEvent, healthy: HealthyHarm, onset: float) -> bool:
    return event.striker != "contents" or healthy.poured[event.entity] <= onset


class HealthySteps(NamedTuple):
    """A healthy run, step by step, in the recorder's format."""

    sensordata: Float[Array, "step sensordata"]
    """Sensor data of the state before each step."""
    states: Float[Array, "state_and_step state"]
    """MuJoCo's integration state at the beginning and after each step."""


def healthy_harm(world: World, run: HealthySteps, *, touched: bool, allowed: frozenset[tuple[str, str]]) -> HealthyHarm:
    """Compute the harm of a healthy run.

    Args:
        world: The simulated world.
        run: The run; if the object is lost, including its fall.
        touched: Whether there is a touch that is not allowed, or a lost object; otherwise touches are not evaluated.
        allowed: Pairs of component and entity whose touches do no harm.
    """
    scene = world.scene
    loss = healthy_loss(world, run.states[::CHECKPOINT])
    events, poured = _reached(world, run, loss)
    found = _touches(world, run, allowed) if touched else {}
    others = [event for event in found.get("events", ()) if event.striker != "contents"]
    landings = found.get("landings", ())
    ordered = tuple(sorted((*events, *others), key=lambda event: (event.time, event.entity, event.striker)))
    hits = ExecutionTouches(ordered, landings)
    return HealthyHarm(
        carried="" if scene.carried is None else scene.carried.body,
        contents="" if scene.contents is None else scene.contents.component_class,
        spilled=0.0 if loss is None else loss.part,
        kept=None if loss is None else loss.kept,
        dropped=bool(found.get("dropped", False)),
        events=ordered,
        landings=landings,
        poured=poured,
        by_entity=_shares(hits, scene),
    )


def _shares(hits: Touches, scene: Scene) -> dict[str, float]:
    """Return the positive severities by entity."""
    return {name: x for name, x in impact_by_entity(hits, scene).items() if x > 0.0}


def _touches(world: World, run: HealthySteps, allowed: frozenset[tuple[str, str]]) -> dict[str, Any]:
    """Return the run's consequences, as the fields of a Rollout that begins at its first state."""
    nq, nv = world.model.nq, world.model.nv
    qpos, qvel = run.states[:, 1 : 1 + nq], run.states[:, 1 + nq : 1 + nq + nv]
    if world.model.nmocap:
        dt = world.settings.timestep
        rows = EntityPoses(world.model, world.walkers).rows(np.append(run.states[:, 0], run.states[-1, 0] + dt))
        qpos, qvel = append_entity_states(qpos, qvel, rows, dt)
    recorder = Recorder(world, allowed, qpos[:1], qvel[:1])
    recorder.observe(run.sensordata[None], qpos[None, 1:], qvel[None, 1:])
    return recorder.finish(0)


def _reached(
    world: World, run: HealthySteps, loss: HealthyLoss | None
) -> tuple[Sequence[ContactEvent], dict[str, float]]:
    """Return the events of entities that contents reach, and the time when enough had left for each entity [s]."""
    if loss is None or not loss.parcels:
        return (), {}
    puddles = Puddles(world, ContactQuery(world))
    qpos = run.states[-1, 1 : 1 + world.model.nq]

    def reached(parcels: Sequence[Parcel]) -> list[ContactEvent]:
        return puddles.events(qpos, parcels)

    events = reached(loss.parcels)
    names, poured = {event.entity for event in events}, dict[str, float]()
    for n, parcel in enumerate(loss.parcels, 1):
        for event in reached(loss.parcels[:n]) if n < len(loss.parcels) else events:
            if event.entity in names:
                poured.setdefault(event.entity, parcel.time)
    return events, poured
