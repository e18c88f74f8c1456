"""Entities that are knocked onto one another.

No sensor feels that: a sensor for every pair of entities would slow every step. Instead, wherever an entity moves, a
few states are looked at again. A touch shorter than the time between looks is missed, and neither force nor impulse
is known: they are 0 in these events.
"""

from __future__ import annotations

import numpy as np

from failbench.recording.bounds import Bounds
from failbench.recording.closeup import Closeup
from failbench.recording.records import ContactEvent
from failbench.simulated.world import World
from graceful_plan.array_types import Float

Array = np.ndarray

STRIDE = 5
"""Steps from one look to the next."""
MOVING = 0.02
"""An entity that is faster [m/s], or turns ten times as fast [rad/s], may be on its way to another."""
_LOOKS = 60
"""Looks at one simulation, at most: a heap of things that touch all the time must not cost more than its rollout."""


class Secondary:
    """Finds the first touch of every two entities that did not touch at the onset.

    Args:
        world: Where.
        closeup: What to look with.
        bounds: Boxes around its entities.
        onset: Positions and velocities at the onset [sim, ...].
    """

    def __init__(self, world: World, closeup: Closeup, bounds: Bounds, onset: tuple[Array, Array]) -> None:
        self._dt = float(world.model.opt.timestep)
        self._closeup = closeup
        self._onset = onset
        self._movable = [closeup.entities.index(name) for name in world.movable]
        joints = world.model.body_jntadr[list(world.movable.values())]
        self._dofs = world.model.jnt_dofadr[joints].astype(int)
        self._bounds = bounds
        entities = len(closeup.entities)
        self._known = np.zeros((len(onset[0]), entities, entities), dtype=bool)
        """Which entities touched at the onset or have touched since."""
        self._begun = np.zeros(len(onset[0]), dtype=bool)
        self._looks = np.zeros(len(onset[0]), dtype=int)
        self._events: list[list[ContactEvent]] = [[] for _ in onset[0]]

    def observe(self, done: int, qpos: Float[Array, "sim step qpos"], qvel: Float[Array, "sim step qvel"]) -> None:
        """Look at the next steps; `done` is how many were there before."""
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
        """Return what was found in one simulation."""
        return self._events[sim]

    def _begin(self, sim: int) -> None:
        """Find out which entities touch at the onset. None is near itself."""
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
        """Look whether entities that are near each other touch."""
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
        """Go back to the first touch and describe it."""
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
