"""Recorder of contacts: one event for all touches of one entity by one component.

Contact sensors, recorded natively, give time and force. Direction, speed and mass are computed in a second pass, for
the few states with a first touch. Touches of the healthy run are left out. Sensors of sleeping bodies keep their
values, so an object that rests on an entity keeps pressing.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from failbench.recording.bounds import Bounds
from failbench.recording.contact_query import CARRIED, OBSTACLE, ROBOT, ContactQuery
from failbench.recording.final_state import FinalState
from failbench.recording.records import ContactEvent
from failbench.recording.secondary import Secondary
from failbench.recording.spill import Spill
from failbench.simulated.world import SENSOR_SIZE, World
from graceful_plan.array_types import Array, Float, Int

BLOCK = 50
"""Steps per processed block. Blocks are counted from the onset, so segment boundaries do not change results."""

_OWNER = {"body": ROBOT, "carried": CARRIED}
_State = tuple[Array, Array]
"""Positions and velocities."""


@dataclass(eq=False)
class _Hit:
    """Effect of one component on one entity in one simulation, up to now."""

    step: int
    position: Array
    first: _State
    """State at the first touch."""
    peak: float = 0.0
    """Greatest force up to now [N]."""
    force: Array = field(default_factory=lambda: np.zeros(3))
    """Greatest force up to now, in W [N]."""
    strongest: _State = field(default_factory=lambda: (np.zeros(0), np.zeros(0)))
    """State at the greatest force."""
    impulse: float = 0.0


class Recorder:
    """Collects the consequences of failures from a batch of simulations that runs in segments.

    Args:
        world: The simulated world.
        baseline: Components and entities that touch in the healthy run; these touches only count as landings of the
            carried object.
        qpos: Positions at the onset.
        qvel: Velocities at the onset.
        kept: Volume in the container at each onset, see `spill.HealthyLoss` [m^3]; by default the volume that the tilt
            at the onset allows.
    """

    def __init__(
        self,
        world: World,
        baseline: frozenset[tuple[str, str]],
        qpos: Float[Array, "sim qpos"],
        qvel: Float[Array, "sim qvel"],
        kept: Float[Array, " sim"] | None = None,
    ) -> None:
        self._world = world
        self._dt = float(world.model.opt.timestep)
        self._closeup = ContactQuery(world)
        self._onset = self._last = (qpos.copy(), qvel.copy())
        self._done = 0
        self._block = [np.zeros((len(qpos), BLOCK, n)) for n in (world.model.nsensordata, qpos.shape[1], qvel.shape[1])]
        self._filled = 0
        counted = [i for i, pair in enumerate(world.pairs) if pair not in baseline or pair[0] == "carried"]
        self._pairs = [world.pairs[i] for i in counted] + [("carried", "")] * len(world.obstacle_adr)
        self._adr = np.concatenate([world.sensor_adr[counted], world.obstacle_adr])
        self._landings = baseline | {("carried", "")}
        unique = list(dict.fromkeys(self._pairs))
        self._pair = np.array([unique.index(pair) for pair in self._pairs], dtype=int)
        self._hits: list[dict[tuple[str, str], _Hit]] = [{} for _ in qpos]
        bounds = Bounds(world)
        self._aftermath = FinalState(world, self._closeup, bounds)
        self._secondary = Secondary(world, self._closeup, bounds, self._onset)
        self._spill = Spill(world, self._closeup, self._onset, kept)

    def observe(
        self,
        sensordata: Float[Array, "sim step sensordata"],
        qpos: Float[Array, "sim step qpos"],
        qvel: Float[Array, "sim step qvel"],
    ) -> None:
        """Process the next segment; its arrays are not kept.

        Args:
            sensordata: Recorded along each step, so each row belongs to the state before the step.
            qpos: Positions after each step.
            qvel: Velocities after each step.
        """
        steps, taken = qpos.shape[1], 0
        while taken < steps:
            count = min(BLOCK - self._filled, steps - taken)
            part = slice(taken, taken + count)
            if count == BLOCK:
                self._work(sensordata[:, part], qpos[:, part], qvel[:, part])
            else:
                for kept, given in zip(self._block, (sensordata, qpos, qvel), strict=True):
                    kept[:, self._filled : self._filled + count] = given[:, part]
                self._filled += count
                if self._filled == BLOCK:
                    self._flush()
            taken += count

    def finish(self, sim: int) -> dict[str, Any]:
        """Return the consequences in one simulation, as fields of a Rollout."""
        self._flush()
        touches = {pair: self._event(pair, hit) for pair, hit in self._hits[sim].items()}
        events = [event for pair, event in touches.items() if pair not in self._landings]
        landings = sorted((touches[pair] for pair in touches.keys() & self._landings), key=_order)
        spilled, reached = self._spill.finish(sim, self._last[0][sim])
        events += self._secondary.events(sim) + reached
        fields = self._aftermath.fields(self._onset[0][sim], self._last[0][sim])
        events.sort(key=_order)
        return fields | {"events": tuple(events), "landings": tuple(landings), "spilled": spilled}

    def _flush(self) -> None:
        if self._filled:
            part, self._filled = self._filled, 0
            self._work(*(kept[:, :part] for kept in self._block))

    def _work(
        self,
        sensordata: Float[Array, "sim step sensordata"],
        qpos: Float[Array, "sim step qpos"],
        qvel: Float[Array, "sim step qvel"],
    ) -> None:
        """Process one block."""
        touched = (sensordata[:, :, self._adr] > 0.0).any(axis=1)
        sims, sensors = np.nonzero(touched)
        if len(sims):
            self._touches(sims, sensors, sensordata, qpos, qvel)
        self._secondary.observe(self._done, qpos, qvel)
        self._spill.observe(qpos, qvel)
        self._done += qpos.shape[1]
        self._last = qpos[:, -1].copy(), qvel[:, -1].copy()

    def _touches(
        self,
        sims: Int[Array, " touch"],
        sensors: Int[Array, " touch"],
        sensordata: Float[Array, "sim step sensordata"],
        qpos: Float[Array, "sim step qpos"],
        qvel: Float[Array, "sim step qvel"],
    ) -> None:
        """Add the block's sensor contacts; sensors between one component and one entity are summed."""
        order = np.lexsort((self._pair[sensors], sims))
        sims, sensors = sims[order], sensors[order]
        columns = self._adr[sensors][:, None, None] + np.arange(SENSOR_SIZE)
        felt = sensordata[sims[:, None, None], np.arange(qpos.shape[1])[:, None], columns]
        starts = np.flatnonzero(np.diff(sims, prepend=-1) | np.diff(self._pair[sensors], prepend=-1))
        force = np.add.reduceat(felt[..., 1:4], starts)
        # Written out, since einsum's rounding depends on the shape and results must not depend on the batch.
        size = np.sqrt(force[..., 0] ** 2 + force[..., 1] ** 2 + force[..., 2] ** 2)
        found = np.add.reduceat(felt[..., 0], starts) > 0.0
        rows = zip(
            starts.tolist(),
            found.argmax(axis=1).tolist(),
            size.argmax(axis=1).tolist(),
            (size.sum(axis=1) * self._dt).tolist(),
            strict=True,
        )
        for row, (i, first, peak, impulse) in enumerate(rows):
            sim, pair = int(sims[i]), self._pairs[sensors[i]]

            def before(step: int, sim: int = sim) -> _State:
                if step == 0:
                    return self._last[0][sim], self._last[1][sim]
                return qpos[sim, step - 1].copy(), qvel[sim, step - 1].copy()

            hit = self._hits[sim].get(pair)
            if hit is None:
                hit = self._hits[sim][pair] = _Hit(self._done + first, felt[i, first, 4:].copy(), before(first))
            hit.impulse += impulse
            if size[row, peak] > hit.peak:
                hit.peak, hit.force, hit.strongest = float(size[row, peak]), force[row, peak].copy(), before(peak)

    def _event(self, pair: tuple[str, str], hit: _Hit) -> ContactEvent:
        striker, entity = _OWNER[pair[0]], self._closeup.entities.index(pair[1]) if pair[1] else OBSTACLE
        self._closeup.place(*hit.first)
        touch = self._closeup.touch(striker, entity)
        peak = hit.peak
        if peak > 0.0:
            self._closeup.place(*hit.strongest)
            normal = self._closeup.normal(striker, entity)
            peak = peak if normal is None else abs(float(hit.force @ normal))
        x, y, z = hit.position if touch is None else touch.position
        return ContactEvent(
            striker=pair[0],
            entity=pair[1],
            time=hit.step * self._dt,
            position=(float(x), float(y), float(z)),
            peak_force=peak,
            impulse=hit.impulse,
            speed=0.0 if touch is None else touch.speed,
            energy=0.0 if touch is None else touch.energy,
        )


def _order(event: ContactEvent) -> tuple[float, str, str]:
    return event.time, event.entity, event.striker
