"""The drop model in the native core: the same as `footprint_drop.py`, which it is tested against."""

from __future__ import annotations

import weakref

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan import _native
from graceful_plan.array_types import Float
from graceful_plan.compile import compile_scene
from graceful_plan.costs.interactions.footprint_constants import FootprintConstants, FootprintSettings
from graceful_plan.costs.interactions.footprint_tables import FootprintTables, footprint_tables
from graceful_plan.exceptions import ShapeError, UnsupportedError
from graceful_plan.kernels import CAPACITY, ImpactKernel, Kernels
from graceful_plan.path import finite_array
from graceful_plan.scene import Scene

Array = np.ndarray

CONSTANTS: tuple[str, ...] = tuple(_native.drop_constants())
"""Names of the constants in the order in which the core takes them."""


class FootprintKernel:
    """The drop model of one scene in which something is carried.

    Args:
        tables: Those of the scene.
        constants: Those for the class of what is carried.
        kernels: Those of the scene.
        speed: Joint velocities [rad/s], one of which is reached along an edge.
        n_entity: How many entities the scene has.

    Raises:
        UnsupportedError: If there is more of something than the core holds.
    """

    def __init__(
        self,
        tables: FootprintTables,
        constants: FootprintConstants,
        kernels: Kernels,
        speed: Float[Array, " nq"],
        n_entity: int,
    ) -> None:
        for what, count in (("carried parts", len(tables.part_half)), ("surfaces", len(tables.target_entity))):
            if count > CAPACITY[what]:
                raise UnsupportedError(f"the drop model has {count} {what}, the kernels hold {CAPACITY[what]}")
        self.kernels, self.n_entity = kernels, n_entity
        self.native = _native.DropModel(
            core=kernels.core,
            link=tables.link,
            centre=_reals(tables.centre),
            part_shape=np.ascontiguousarray(tables.part_kind, dtype=np.int32),
            part_offset=_reals(tables.part_offset),
            part_rotation=_reals(tables.part_rotation),
            part_half=_reals(tables.part_half),
            main=tables.main,
            size=tables.size,
            target_entity=np.ascontiguousarray(tables.target_entity, dtype=np.int32),
            target=_reals(_targets(tables)),
            level_start=np.ascontiguousarray(tables.level_start, dtype=np.int32),
            n_entity=n_entity,
            speed=_reals(speed),
            constants=np.array([getattr(constants, name) for name in CONSTANTS]),
        )

    def probability(self, q: ArrayLike, qd: ArrayLike | None = None) -> Float[Array, "*batch entity"]:
        """P that the object hits each entity if it is let go at q with joint velocities qd [rad/s], at rest if None."""
        flat, rates, batch = self._states(q, qd)
        return self.native.probability(flat, rates).reshape(*batch, self.n_entity)

    def impact(
        self, q: ArrayLike, severity: Float[Array, " entity"], qd: ArrayLike | None = None
    ) -> Float[Array, "*batch"]:
        """Sum of P S over the entities."""
        flat, rates, batch = self._states(q, qd)
        return self.native.impact(self._severity(severity), flat, rates).reshape(batch)

    def gradient(
        self, q: ArrayLike, severity: Float[Array, " entity"], qd: ArrayLike | None = None
    ) -> tuple[Float[Array, "*batch"], Float[Array, "*batch nq"], Float[Array, "*batch nq"]]:
        """Sum of P S with its derivatives with respect to q [1/rad] and to qd [s/rad].

        Where two surfaces of an entity or two parts of the object are equally likely, the derivative is that of one.
        """
        flat, rates, batch = self._states(q, qd)
        impact, d_q, d_qd = self.native.gradient(self._severity(severity), flat, rates)
        return impact.reshape(batch), d_q.reshape(*batch, self.kernels.nq), d_qd.reshape(*batch, self.kernels.nq)

    def with_severity(self, severity: Float[Array, " entity"], paces: tuple[float, float] = (1.0, 1.0)) -> ImpactKernel:
        """Return the impact with these severities, for planners; edges are travelled at these shares of `speed`."""
        return ImpactKernel(self.kernels, _native.DropImpact(self.native, self._severity(severity), *paces))

    def _severity(self, severity: Array) -> Float[Array, " entity"]:
        if np.shape(severity) != (self.n_entity,):
            raise ShapeError("severity", np.shape(severity), f"({self.n_entity},)")
        return _reals(finite_array("severity", severity))

    def _states(self, q: ArrayLike, qd: ArrayLike | None) -> tuple[Array, Array, tuple[int, ...]]:
        flat, batch = self.kernels.rows("q", q)
        rates = np.zeros_like(flat) if qd is None else finite_array("qd", qd, last=self.kernels.nq)
        if qd is not None and rates.shape != (*batch, self.kernels.nq):
            raise ShapeError("qd", rates.shape, f"that of q, {(*batch, self.kernels.nq)}")
        return flat, _reals(rates.reshape(flat.shape)), batch


_KEPT = 4
"""Sets of constants for which the tables of a scene are kept."""
_made: weakref.WeakKeyDictionary[Scene, dict[FootprintConstants, FootprintKernel]] = weakref.WeakKeyDictionary()


def footprint_kernel(scene: Scene, settings: FootprintSettings) -> FootprintKernel:
    """Return the drop model of a scene in which something is carried; it is made once per set of constants.

    Raises:
        UnsupportedError: If the core cannot represent it.
    """
    tables = footprint_tables(scene)
    constants = settings.of(tables.shape_class)
    made = _made.setdefault(scene, {})
    if constants not in made:
        if len(made) == _KEPT:  # a fit tries many constants, one after the other
            made.pop(next(iter(made)))
        kernels = compile_scene(scene).kernels
        made[constants] = FootprintKernel(tables, constants, kernels, scene.limits.velocity, len(scene.entities))
    return made[constants]


def _targets(tables: FootprintTables) -> Float[Array, "target 11"]:
    """Rows of centre, axis, half sizes, diagonal, carrying half sizes, bottom and top."""
    columns = (
        tables.target_centre,
        tables.target_axis,
        tables.target_half,
        tables.target_diagonal[:, None],
        tables.target_carries,
        tables.target_height,
    )
    return np.concatenate(columns, axis=1)


def _reals(values: Array) -> Array:
    return np.ascontiguousarray(values, dtype=np.float64)
