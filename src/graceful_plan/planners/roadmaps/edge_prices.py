"""Costs of edges, independent of severities: motion cost, and exposure by column.

A column is a pair of a component and an entity that may be hit, or any other item with a severity. The impact of an
edge is the sum of exposure times severity over its columns, so new severities need only a product.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float, Int

_NO_INDEX = np.zeros(0, dtype=np.int32)
_TELLING = 8  # edges with exposure that are needed to compare directions


@final
@dataclass(frozen=True, eq=False)
class EdgeCosts:
    """Motion cost and exposure of edges; exposures of 0 are not stored.

    | field    | meaning                                                      | unit     | shape |
    |----------|--------------------------------------------------------------|----------|-------|
    | motion   | V of each edge                                               | rad      | edge  |
    | edge     | edge of each exposure, ascending                             |          | entry |
    | column   | column of each exposure                                      |          | entry |
    | exposure | integral of P along the edge, above 0; over time by default  | s or rad | entry |
    """

    motion: Float[Array, " edge"]
    edge: Int[Array, " entry"]
    column: Int[Array, " entry"]
    exposure: Float[Array, " entry"]

    def __len__(self) -> int:
        return len(self.motion)

    @classmethod
    def of(cls, motion: Float[Array, " edge"], exposure: Float[Array, "edge column"]) -> EdgeCosts:
        """Create it from a dense matrix of exposures; zeros are dropped."""
        edge, column = np.nonzero(exposure)
        return cls(motion, edge.astype(np.int32), column.astype(np.int32), exposure[edge, column])

    @classmethod
    def concatenated(cls, parts: Sequence[EdgeCosts]) -> EdgeCosts:
        """Concatenate the costs of several sets of edges."""
        first = np.cumsum([0, *map(len, parts)], dtype=np.int32)
        return cls(
            np.concatenate([np.zeros(0), *(part.motion for part in parts)]),
            np.concatenate([_NO_INDEX, *(part.edge + k for part, k in zip(parts, first[:-1], strict=True))]),
            np.concatenate([_NO_INDEX, *(part.column for part in parts)]),
            np.concatenate([np.zeros(0), *(part.exposure for part in parts)]),
        )

    def impact(self, severity: Float[Array, " column"]) -> Float[Array, " edge"]:
        """Return the impact S of each edge under these severities."""
        impact = np.zeros(len(self.motion))
        if len(self.edge):
            impact[self.edge[self.first_entries]] = np.add.reduceat(
                self.exposure * severity.take(self.column), self.first_entries
            )
        return impact

    @cached_property
    def first_entries(self) -> Int[Array, " priced"]:
        """Index of the first entry of each edge that has entries."""
        return np.flatnonzero(np.diff(self.edge, prepend=-1))


Price = Callable[[Float[Array, "n nq"], Float[Array, "n nq"]], EdgeCosts]
"""Computes the costs of straight edges, in the direction in which they are given."""


@final
@dataclass(frozen=True, eq=False)
class Edges:
    """Directed edges with their costs.

    | field  | meaning                     | unit | shape |
    |--------|-----------------------------|------|-------|
    | tail   | node that each edge leaves  |      | edge  |
    | head   | node that each edge enters  |      | edge  |
    | prices | costs of the edges          |      |       |
    """

    tail: Int[Array, " edge"]
    head: Int[Array, " edge"]
    prices: EdgeCosts

    def __len__(self) -> int:
        return len(self.tail)

    @classmethod
    def concatenated(cls, parts: Sequence[Edges]) -> Edges:
        """Concatenate several sets of edges."""
        tail, head = ([_NO_INDEX, *(getattr(part, name) for part in parts)] for name in ("tail", "head"))
        prices = EdgeCosts.concatenated([part.prices for part in parts])
        return cls(np.concatenate(tail, dtype=np.int32), np.concatenate(head, dtype=np.int32), prices)


def symmetric(price: Price, q0: Float[Array, "n nq"], q1: Float[Array, "n nq"]) -> bool | None:
    """Return whether these edges cost the same in both directions; None if too few of them have exposure."""
    there, back = price(q0, q1), price(q1, q0)
    same = (
        np.array_equal(there.edge, back.edge)
        and np.array_equal(there.column, back.column)
        and np.allclose(there.exposure, back.exposure, rtol=1e-9, atol=1e-12)
        and np.allclose(there.motion, back.motion, rtol=1e-9, atol=1e-12)
    )
    return None if same and len(there.first_entries) < _TELLING else same
