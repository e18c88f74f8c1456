"""Contacts between entities that are knocked onto one another.

There are no sensors for pairs of entities, since they would slow down every step. Instead, the states of moving
entities are sampled. Touches shorter than the sampling interval are missed, and force and impulse are not known: they
are 0 in these events.
"""

from __future__ import annotations

import numpy as np

from failbench.recording.bounds import Bounds
from failbench.recording.contact_query import ContactQuery
from failbench.recording.records import ContactEvent
from failbench.simulated.world import World
from graceful_plan.array_types import Array, Float

STRIDE = 5
"""Steps between samples."""
MOVING = 0.02
"""Speed [m/s], and tenth of the angular speed [rad/s], above which an entity is checked for new contacts."""
_LOOKS = 60
"""Greatest number of checked states per simulation, so that a heap of touching objects costs less than its rollout."""


class Secondary:
    """Finds the first touch of each pair of entities that does not touch at the onset.

    Args:
        world: The simulated world.
        closeup: Contact queries for single states.
        bounds: Boxes around the entities.
        onset: Positions and velocities at the onset [sim, ...].
    """

    def __init__(self, world: World, closeup: ContactQuery, bounds: Bounds, onset: tuple[Array, Array]) -> None:
        self._dt = float(world.model.opt.timestep)
        self._closeup = closeup
        self._onset = onset
        self._movable = [closeup.entities.index(name) for name in world.movable]
        joints = world.model.body_jntadr[list(world.movable.values())]
        self._dofs = world.model.jnt_dofadr[joints].astype(int)
        self._bounds = bounds
        entities = len(closeup.entities)
        self._known = np.zeros((len(onset[0]), entities, entities), dtype=bool)
        """Pairs of entities that touched at the onset or have touched since."""
        self._begun = np.zeros(len(onset[0]), dtype=bool)
        self._looks = np.zeros(len(onset[0]), dtype=int)
        self._events: list[list[ContactEvent]] = [[] for _ in onset[0]]

    def observe(self, done: int, qpos: Float[Array, "sim step qpos"], qvel: Float[Array, "sim step qvel"]) -> None:
        """Check the next steps for new contacts; `done` is the number of steps before them."""
        steps = np.arange(STRIDE - 1, qpos.shape[1], STRIDE)
        if not len(steps) or not self._movable:
            return
        sampled = np.abs(qvel[:, steps][:, :, self._dofs[:, None] + np.arange(6)])
        moving = (sampled[..., :3].max(axis=-1) > MOVING) | (sampled[..., 3:].max(axis=-1) > 10.0 * MOVING)
        for sim in np.flatnonzero(moving.any(axis=(1, 2)) & ~self._begun).tolist():
            self._begin(sim)
        sims, looks, movers = np.nonzero(moving)
        near = self._bounds.overlap(qpos, sims, steps[looks], movers, self._known)
        asked: dict[tuple[int, int], list[tuple[int, int]]] = {}
        for sim, step, a, b in near.tolist():
            asked.setdefault((sim, step), []).append((a, b))
        for (sim, step), pairs in asked.items():
            if self._looks[sim] < _LOOKS:
                self._look(sim, step, pairs, done, qpos[sim], qvel[sim])

    def events(self, sim: int) -> list[ContactEvent]:
        """Return the contacts between entities in one simulation."""
        return self._events[sim]

    def _begin(self, sim: int) -> None:
        """Find the pairs of entities that touch at the onset, and exclude pairs of an entity with itself."""
        self._begun[sim] = True
        self._closeup.place(self._onset[0][sim])
        owners = self._closeup.owners()
        first, second = owners[(owners >= 0).all(axis=1)].T
        self._known[sim, first, second] = self._known[sim, second, first] = True
        np.fill_diagonal(self._known[sim], True)

    def _look(
        self,
        sim: int,
        step: int,
        pairs: list[tuple[int, int]],
        done: int,
        qpos: Float[Array, "step qpos"],
        qvel: Float[Array, "step qvel"],
    ) -> None:
        """Check whether pairs of near entities touch in a state."""
        self._looks[sim] += 1
        self._closeup.place(qpos[step], qvel[step])
        touching = {(a, b) for a, b in self._closeup.owners().tolist()}
        for a, b in pairs:
            if not self._known[sim, a, b] and ((a, b) in touching or (b, a) in touching):
                self._known[sim, a, b] = self._known[sim, b, a] = True
                self._found(sim, done, step, (a, b), qpos, qvel)

    def _found(
        self,
        sim: int,
        done: int,
        step: int,
        pair: tuple[int, int],
        qpos: Float[Array, "step qpos"],
        qvel: Float[Array, "step qvel"],
    ) -> None:
        """Find the first step of a touch, and record its event."""
        closeup = self._closeup
        first = step
        for earlier in range(step - 1, step - STRIDE, -1):
            closeup.place(qpos[earlier], qvel[earlier])
            if closeup.normal(*pair) is None:
                break
            first = earlier
        striker, struck = sorted(pair, key=lambda entity: -self._speed_of(entity, qvel[first]))
        closeup.place(qpos[first], qvel[first])
        touch = closeup.touch(striker, struck)
        assert touch is not None
        x, y, z = touch.position
        self._events[sim].append(
            ContactEvent(
                striker=closeup.entities[striker],
                entity=closeup.entities[struck],
                time=(done + first + 1) * self._dt,
                position=(float(x), float(y), float(z)),
                peak_force=0.0,
                impulse=0.0,
                speed=touch.speed,
                energy=touch.energy,
                secondary=True,
            )
        )

    def _speed_of(self, entity: int, qvel: Float[Array, " qvel"]) -> float:
        if entity not in self._movable:
            return 0.0
        adr = int(self._dofs[self._movable.index(entity)])
        return float(np.linalg.norm(qvel[adr : adr + 3]) + 0.1 * np.linalg.norm(qvel[adr + 3 : adr + 6]))
