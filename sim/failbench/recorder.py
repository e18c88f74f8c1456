"""What a failing robot touches: one event for everything that one component does to one entity.

Contact sensors, recorded natively, say when and how hard; the few states at which something is touched for the first
time are looked at again for directions, speeds and masses. What the healthy run touches is left out.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from failbench.aftermath import aftermath
from failbench.closeup import CARRIED, ROBOT, Closeup
from failbench.records import ContactEvent
from failbench.world import World
from graceful_plan.array_types import Float

Array = np.ndarray

_OWNER = {"body": ROBOT, "carried": CARRIED}


@dataclass(eq=False)
class _Hit:
    """What one simulation's component has done to one entity so far. States are pairs of qpos and qvel."""

    step: int
    position: Array
    first: tuple[Array, Array]
    peak: float = 0.0
    peak_state: tuple[Array, Array] = field(default_factory=lambda: (np.zeros(0), np.zeros(0)))
    peak_force: Array = field(default_factory=lambda: np.zeros(3))
    impulse: float = 0.0


class Recorder:
    """Collects the consequences of failures from a batch of simulations that runs in segments.

    Args:
        world: Where.
        baseline: Components and entities that touch in the healthy run; they do not count.
        qpos: Positions at the onset.
        qvel: Velocities at the onset.
    """

    def __init__(
        self,
        world: World,
        baseline: frozenset[tuple[str, str]],
        qpos: Float[Array, "sim qpos"],
        qvel: Float[Array, "sim qvel"],
    ) -> None:
        self.world = world
        self.closeup = Closeup(world)
        self.onset = qpos.copy(), qvel.copy()
        self.last = self.onset
        self.steps = 0
        counted = [i for i, pair in enumerate(world.pairs) if pair not in baseline]
        self._pairs = [world.pairs[i] for i in counted]
        self._adr = world.sensor_adr[counted]
        self._hits: dict[tuple[int, tuple[str, str]], _Hit] = {}

    def observe(
        self,
        sensordata: Float[Array, "sim step sensordata"],
        qpos: Float[Array, "sim step qpos"],
        qvel: Float[Array, "sim step qvel"],
    ) -> None:
        """Take in the next segment.

        Args:
            sensordata: Recorded along each step, so it belongs to the state before the step.
            qpos: Positions after each step.
            qvel: Velocities after each step.
        """
        if qpos.shape[1] == 0:
            return
        touched = (sensordata[:, :, self._adr] > 0.0).any(axis=1)
        sensors: dict[tuple[int, tuple[str, str]], list[int]] = {}
        for sim, i in np.argwhere(touched):
            sensors.setdefault((int(sim), self._pairs[i]), []).append(int(self._adr[i]))
        for key, adr in sensors.items():
            self._record(key, sensordata[key[0]], adr, qpos, qvel)
        self.steps += qpos.shape[1]
        self.last = qpos[:, -1].copy(), qvel[:, -1].copy()

    def _record(
        self,
        key: tuple[int, tuple[str, str]],
        sensordata: Float[Array, "step sensordata"],
        adr: list[int],
        qpos: Float[Array, "sim step qpos"],
        qvel: Float[Array, "sim step qvel"],
    ) -> None:
        """Add what the sensors of one component and entity felt during the segment."""
        found = sensordata[:, adr] > 0.0
        steps = np.flatnonzero(found.any(axis=1))
        force = np.add.reduce([sensordata[steps, a + 1 : a + 4] for a in adr])
        size = np.sqrt(force[:, 0] ** 2 + force[:, 1] ** 2 + force[:, 2] ** 2)

        def before(step: int) -> tuple[Array, Array]:
            if step == 0:
                return self.last[0][key[0]], self.last[1][key[0]]
            return qpos[key[0], step - 1].copy(), qvel[key[0], step - 1].copy()

        if key not in self._hits:
            a = adr[int(np.argmax(found[steps[0]]))]
            first = int(steps[0])
            self._hits[key] = _Hit(self.steps + first, sensordata[first, a + 4 : a + 7].copy(), before(first))
        hit = self._hits[key]
        # One after the other, so that rounding does not depend on where segments end.
        hit.impulse = float(np.add.accumulate(np.append(hit.impulse, size * self.world.model.opt.timestep))[-1])
        strongest = int(np.argmax(size))
        if size[strongest] > hit.peak:
            hit.peak, hit.peak_force = float(size[strongest]), force[strongest].copy()
            hit.peak_state = before(int(steps[strongest]))

    def finish(self, sim: int) -> dict[str, Any]:
        """Return what became of one simulation: the fields of a Rollout that are consequences."""
        hits = [(pair, hit) for (s, pair), hit in self._hits.items() if s == sim]
        events = [self._event(pair, hit) for pair, hit in hits]
        fields = aftermath(self.world, self.closeup, (self.onset[0][sim], self.last[0][sim]))
        return fields | {"events": tuple(sorted(events, key=lambda e: e.time))}

    def _event(self, pair: tuple[str, str], hit: _Hit) -> ContactEvent:
        striker, entity = _OWNER[pair[0]], self.closeup.entities.index(pair[1])
        self.closeup.place(*hit.first)
        touch = self.closeup.touch(striker, entity)
        position = hit.position if touch is None else touch.position
        peak = hit.peak
        if peak > 0.0:
            self.closeup.place(*hit.peak_state)
            at_peak = self.closeup.touch(striker, entity)
            peak = peak if at_peak is None else abs(float(hit.peak_force @ at_peak.normal))
        return ContactEvent(
            striker=pair[0],
            entity=pair[1],
            time=hit.step * self.world.model.opt.timestep,
            position=(float(position[0]), float(position[1]), float(position[2])),
            peak_force=peak,
            impulse=hit.impulse,
            speed=0.0 if touch is None else touch.speed,
            energy=0.0 if touch is None else touch.energy,
        )
