"""Distribution of the impact of a failure at a state: independent entities are convolved; `risk` has the definition.

The support holds all possible sums of severities: for each entity, of any of the components that harm it. If there are
too many sums, the support is an even grid, and mass that falls between two grid points is split between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple, final

import numpy as np

from graceful_plan.array_types import Array, Float, Int
from graceful_plan.costs.cost import Cost, NonFiniteCostError, StateBatch
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.exceptions import SettingError
from graceful_plan.scene.scene import Scene

_MOST_SUMS = 1024
"""Largest number of distinct sums of severities for an exact distribution; also the number of grid points otherwise."""
_IMPOSSIBLE = 1e-9
"""Probability of harm to an entity up to which it is ignored."""
_CHUNK = 256  # states per batch


@final
class _Move(NamedTuple):
    """One step of adding a severity to all sums: a share of the mass at each origin moves to its own target."""

    origin: Int[Array, " k"] | slice
    target: Int[Array, " k"] | slice
    share: float


@final
class _Kind(NamedTuple):
    """A kind of failure: its probability given a failure, and P(L >= s) given this kind, by entity."""

    weight: float
    at_least: list[Float[Array, "n _"]]


@final
class HarmLaw:
    """Distributions of the impact at states, in one scene.

    Args:
        cost: The impact cost; only interaction models resolve entities.
        scene: The scene.
        most_sums: Largest number of distinct sums for an exact distribution, and number of grid points otherwise.

    Attributes:
        value: Possible impacts, increasing from 0.
        exact: Whether the values hold all sums of severities.
    """

    def __init__(self, cost: Cost, scene: Scene, most_sums: int | None = None) -> None:
        if not isinstance(cost, ImpactCost):
            raise SettingError("impact", cost, "an ImpactCost, which resolves entities")
        self._cost = cost
        severity = cost.severity_table(scene)
        self._entities = np.flatnonzero(severity.max(axis=0, initial=0.0) > 0.0)
        self._subsets = [_subsets(column) for column in severity[:, self._entities].T]
        self._levels = [np.unique(sums) for _, sums in self._subsets]
        self.value, self.exact = _sums(self._levels, _MOST_SUMS if most_sums is None else most_sums)
        self._moves = {s: _moves(self.value, s, self.exact) for levels in self._levels for s in levels.tolist()}

    def states(self, batch: StateBatch) -> Float[Array, "n atom"]:
        """Compute the probability of each value, given a failure at each state."""
        kinds = self._kinds(batch)
        mass = np.tile(self._harmless(kinds), (len(batch), 1))
        for weight, at_least in kinds:
            mass += weight * self._convolved(at_least, len(batch))
        return mass

    def mixture(
        self, batch: StateBatch, weight: Float[Array, " n"]
    ) -> tuple[Float[Array, " atom"], Float[Array, " entity"]]:
        """Return the weighted sum of the distributions at states, and the worst possible impact on each entity."""
        kinds = self._kinds(batch)
        mass = self._harmless(kinds) * weight.sum()
        worst = np.zeros(len(self._entities))
        for share, at_least in kinds:
            for first in range(0, len(batch), _CHUNK):
                rows = slice(first, first + _CHUNK)
                part = self._convolved([reached[rows] for reached in at_least], len(weight[rows]))
                mass = mass + share * (weight[rows] @ part)
            reached = [levels * part.any(axis=0) for levels, part in zip(self._levels, at_least, strict=True)]
            worst = np.maximum(worst, [levels.max() for levels in reached])
        return mass, worst

    def _harmless(self, kinds: Sequence[_Kind]) -> Float[Array, " atom"]:
        """Return the probability that a failure is of none of these kinds, as a point mass at 0."""
        return (1.0 - sum(kind.weight for kind in kinds)) * (self.value == 0.0)

    def _kinds(self, batch: StateBatch) -> list[_Kind]:
        """Return the kinds of failure that the model resolves, or a single kind for all."""
        shares = {name: np.asarray(share)[:, :, self._entities] for name, share in self._cost.sources(batch).items()}
        if not all(np.all(np.isfinite(share)) for share in shares.values()):
            raise NonFiniteCostError(self._cost, "probability() returned a NaN or an infinity")
        weights = {name: sum(faults.values()) for name, faults in self._cost.interaction.fault_shares().items()}
        excess = max(1.0, sum(weights.values()))  # some faults act like two kinds at once
        weights = {name: weight / excess for name, weight in weights.items()}
        shares = {name: share for name, share in shares.items() if share.any()}
        if all(weights.get(name, 0.0) > 0.0 for name in shares):
            return [_Kind(weights[name], self._at_least([share / weights[name]])) for name, share in shares.items()]
        return [_Kind(1.0, self._at_least(list(shares.values())))] if shares else []

    def _at_least(self, shares: Sequence[Float[Array, "n component entity"]]) -> list[Float[Array, "n _"]]:
        """Return P(L >= s) for each entity that can be harmed and each of its sums of severities s, increasing.

        Args:
            shares: Probabilities of mutually exclusive causes; at least one.
        """
        found = []
        for e, (levels, (subsets, sums)) in enumerate(zip(self._levels, self._subsets, strict=True)):
            reached = np.zeros((len(shares[0]), len(levels)))
            for share in shares:
                # Components strike together: all of a subset do with the probability of its least likely one.
                together = np.stack([share[:, list(subset), e].min(axis=1) for subset in subsets], axis=1)
                for k, s in enumerate(levels):
                    reached[:, k] += together[:, sums >= s].max(axis=1)
            found.append(np.clip(reached, 0.0, 1.0))
        return found

    def _convolved(self, at_least: Sequence[Float[Array, "n _"]], n: int) -> Float[Array, "n atom"]:
        """Convolve independent entities, one after the other."""
        mass = np.zeros((n, len(self.value)))
        mass[:, 0] = 1.0
        for levels, reached in zip(self._levels, at_least, strict=True):
            # Most entities are out of reach at most states.
            rows = np.flatnonzero(reached[:, 0] > _IMPOSSIBLE)
            if not len(rows):
                continue
            exactly = -np.diff(reached[rows], axis=1, append=0.0)
            before = mass[rows]
            after = before * (1.0 - reached[rows, :1])
            for k, s in enumerate(levels.tolist()):
                for move in self._moves[s]:
                    after[:, move.target] += (move.share * exactly[:, k : k + 1]) * before[:, move.origin]
            mass[rows] = after
        return mass


def _subsets(severity: Float[Array, " component"]) -> tuple[list[tuple[int, ...]], Float[Array, " subset"]]:
    """Return all non-empty sets of components with a severity > 0, and the sum of severities of each."""
    members = np.flatnonzero(severity > 0.0).tolist()
    subsets = [subset for size in range(1, len(members) + 1) for subset in combinations(members, size)]
    return subsets, np.round([severity[list(subset)].sum() for subset in subsets], 9)


def _sums(levels: Sequence[Float[Array, " _"]], most: int) -> tuple[Float[Array, " atom"], bool]:
    """Return all sums of at most one level per entity, or an even grid over their range if there are too many."""
    value = np.zeros(1)
    for severities in levels:
        sums = np.add.outer(np.append(0.0, severities), value).ravel()
        value = np.unique(np.round(sums, 9))
        if len(value) > most:
            step = sum(float(column.max()) for column in levels) / (most - 1)
            # Splitting may raise a sum by one step per entity.
            return step * np.arange(most + len(levels)), False
    return value, True


def _moves(value: Float[Array, " atom"], s: float, exact: bool) -> list[_Move]:
    """Return where the mass at each value goes when `s` is added; within one move all targets are distinct."""
    if exact:
        target = np.searchsorted(value, value + s - 1e-9 * value[-1])
        # Values whose sum with s is not in the support already include s and have no mass.
        origin = np.flatnonzero(np.isclose(value[np.minimum(target, len(value) - 1)], value + s, rtol=1e-9, atol=0.0))
        return [_Move(origin, target[origin], 1.0)]
    step = value[1]
    whole = int(np.floor(s / step))
    above = s / step - whole
    parts = ((whole, 1.0 - above), (whole + 1, above))
    return [_Move(slice(len(value) - k), slice(k, None), share) for k, share in parts if share > 0.0]
