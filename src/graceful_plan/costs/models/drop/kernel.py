"""The drop and spill models of one scene in the native core; the docstrings of both packages specify them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Float
from graceful_plan.core import _native
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import CAPACITY, ImpactKernel, Kernels
from graceful_plan.costs.cost import StateBatch
from graceful_plan.costs.models.drop.constants import DropConstants, DropSettings
from graceful_plan.costs.models.drop.loss import (
    CARRIED_LOSS,
    LANDING_LOSS,
    NODES,
    WEIGHTS,
    LossTables,
    damage_tables,
    loss_tables,
)
from graceful_plan.costs.models.drop.network import DropNetwork
from graceful_plan.costs.models.drop.tables import DropTables, drop_tables
from graceful_plan.costs.models.spill.constants import USES, SpillSettings, StopSettings
from graceful_plan.costs.models.spill.tables import SpillTables, spill_tables
from graceful_plan.exceptions import ShapeError, UnsupportedError
from graceful_plan.path import finite_array
from graceful_plan.scene.harm.fragility import FragilityTable
from graceful_plan.scene.per_scene import per_scene
from graceful_plan.scene.scene import Scene

CONSTANTS: tuple[str, ...] = tuple(_native.drop_constants())
"""Names of the constants that the core takes."""
SPILL_CONSTANTS: tuple[str, ...] = tuple(_native.spill_constants())
"""Names of the constants of the spill model that the core takes."""
ROWS = ("carried", *USES, "stopped")
"""Rows of probabilities and severities: the object after a drop; contents after a drop; contents that leave a held
container; contents spilled by a protective stop."""


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class StopTables:
    """Protective stop of the robot: constants, and the greatest accelerations of its joints [rad/s^2]."""

    settings: StopSettings
    acceleration: Float[Array, " nq"]


@final
class DropKernel:
    """The drop model of one scene with a carried object, and the spill model if it has contents.

    Probabilities have the rows `ROWS`; without contents, their rows are zero. Rows without severity are not computed.
    The loss of the object itself is a separate value.

    Args:
        tables: Drop tables of the scene.
        constants: Constants for the class of the carried object.
        kernels: Kernels of the scene.
        speed: Velocity limits of the joints [rad/s]; at pace 1, an edge is travelled with one joint at its limit.
        n_entity: Number of entities in the scene.
        contents: Tables and constants of the spill model if there are contents.
        loss: Fragility of the object itself; no damage by default.
        stop: Protective stop of the robot; by default it spills nothing.
        network: Correction of the object's hits; none by default.
        damage: `damage_tables` of the entities: the row "carried" is then P of damage; by default P of a hit.

    Raises:
        UnsupportedError: If a capacity of the core is exceeded.
    """

    def __init__(
        self,
        tables: DropTables,
        constants: DropConstants,
        kernels: Kernels,
        speed: Float[Array, " nq"],
        n_entity: int,
        contents: tuple[SpillTables, SpillSettings] | None = None,
        loss: LossTables | None = None,
        stop: StopTables | None = None,
        network: DropNetwork | None = None,
        damage: Float[Array, "entity 3"] | None = None,
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
            constants={name: getattr(constants, name) for name in CONSTANTS},
        )
        if contents is not None:
            self._add_contents(*contents)
        if stop is not None:
            self._add_stop(stop.settings, stop.acceleration)
        if loss is not None:
            self.native.add_loss(
                strength=_reals(loss.strength),
                sharpness=1.0 / loss.spread,
                shift=np.array([LANDING_LOSS * node / loss.spread for node in NODES]),
                weight=np.array(WEIGHTS),
            )
        if damage is not None:
            self.native.add_damage(entity=_reals(damage), loss=CARRIED_LOSS)
        if network is not None:
            self.native.add_network(len(network.last), network.bound, _reals(network.weights_for(tables)))

    def _add_contents(self, tables: SpillTables, settings: SpillSettings) -> None:
        self.native.add_contents(
            mouth=_reals(tables.mouth),
            axis=_reals(tables.axis),
            container={name: getattr(tables, name) for name in ("rim", "depth", "full", "radius", "power", "repose")},
            stands=np.ascontiguousarray(tables.stands, dtype=np.int32),
            visible=_reals(tables.visible),
            constants=[{name: getattr(settings.of(use), name) for name in SPILL_CONSTANTS} for use in USES],
        )

    def _add_stop(self, settings: StopSettings, acceleration: Float[Array, " nq"]) -> None:
        self.native.add_stop(
            deceleration=_reals(settings.deceleration * acceleration),
            constants={name: getattr(settings, name) for name in ("amplification", "response", "spread")},
            places={name: getattr(settings.places, name) for name in SPILL_CONSTANTS},
        )

    def of(self, batch: StateBatch) -> tuple[Float[Array, "n row entity"], Float[Array, " n"]]:
        """Return `probability` and `own_loss` of a batch of states; computed together and cached in the batch."""
        found = batch.kept.get(np.ndarray, self, lambda: self._all(batch.q, batch.qd)[0])
        return found[:, :-1].reshape(len(batch), len(ROWS), self.n_entity), found[:, -1]

    def probability(self, q: ArrayLike, qd: ArrayLike | None = None) -> Float[Array, "*batch row entity"]:
        """Compute P that object or contents reach each entity, with joint velocities qd [rad/s], at rest if None."""
        found, batch = self._all(q, qd)
        return found[:, :-1].reshape(*batch, len(ROWS), self.n_entity)

    def sights(self, q: ArrayLike, qd: ArrayLike | None = None) -> Float[Array, "*batch target told"]:
        """Return the network inputs of every surface, see `network.STATE_FEATURES`, then the uncorrected P of a hit.

        All is zero for surfaces of obstacles.
        """
        flat, rates, batch = self._states(q, qd)
        found = self.native.sights(flat, rates)
        return found.reshape(*batch, *found.shape[1:])

    def own_loss(self, q: ArrayLike, qd: ArrayLike | None = None) -> Float[Array, "*batch"]:
        """Compute P that the fall damages the object itself, with joint velocities qd [rad/s], at rest if None."""
        found, batch = self._all(q, qd)
        return found[:, -1].reshape(batch)

    def impact(
        self, q: ArrayLike, severity: Float[Array, "row entity"], qd: ArrayLike | None = None, *, own: float = 0.0
    ) -> Float[Array, "*batch"]:
        """Compute the sum of P S over rows and entities, plus the own loss; S includes the weights of the failures.

        Args:
            q: Configurations.
            severity: S of each row against each entity.
            qd: Joint velocities [rad/s], at rest if None.
            own: S of the loss of the object itself.
        """
        flat, rates, batch = self._states(q, qd)
        return self.native.impact(self.severities(severity, own), flat, rates).reshape(batch)

    def gradient(
        self, q: ArrayLike, severity: Float[Array, "row entity"], qd: ArrayLike | None = None, *, own: float = 0.0
    ) -> tuple[Float[Array, "*batch"], Float[Array, "*batch nq"], Float[Array, "*batch nq"]]:
        """Compute `impact` with its derivatives with respect to q [1/rad] and to qd [s/rad].

        If two surfaces of an entity or two parts of the object are equally likely, the derivative is that of one.
        """
        flat, rates, batch = self._states(q, qd)
        impact, d_q, d_qd = self.native.gradient(self.severities(severity, own), flat, rates)
        return impact.reshape(batch), d_q.reshape(*batch, self.kernels.nq), d_qd.reshape(*batch, self.kernels.nq)

    def with_severity(
        self, severity: Float[Array, "row entity"], paces: tuple[float, float] = (1.0, 1.0), *, own: float = 0.0
    ) -> ImpactKernel:
        """Return the kernel of the impact with these severities, for planners; `paces` are fractions of `speed`."""
        return ImpactKernel(self.kernels, _native.DropImpact(self.native, self.severities(severity, own), *paces))

    def severities(self, severity: Float[Array, "row entity"], own: float = 0.0) -> Float[Array, " all"]:
        """Return severities in one row, as the core takes them: those of entities, then that of the object itself.

        Raises:
            NonFiniteError: If a severity is not finite.
            ShapeError: If the shape is not (row, entity).
        """
        if np.shape(severity) != (len(ROWS), self.n_entity):
            raise ShapeError("severity", np.shape(severity), f"({len(ROWS)}, {self.n_entity})")
        return _reals(finite_array("severity", np.append(np.ravel(severity), own)))

    def _all(self, q: ArrayLike, qd: ArrayLike | None) -> tuple[Float[Array, "n harmed"], tuple[int, ...]]:
        """Return P of each row and entity, last that of the own loss, and the batch axes."""
        flat, rates, batch = self._states(q, qd)
        return self.native.probability(flat, rates), batch

    def _states(self, q: ArrayLike, qd: ArrayLike | None) -> tuple[Array, Array, tuple[int, ...]]:
        flat, batch = self.kernels.rows("q", q)
        rates = np.zeros_like(flat) if qd is None else finite_array("qd", qd, last=self.kernels.nq)
        if qd is not None and rates.shape != (*batch, self.kernels.nq):
            raise ShapeError("qd", rates.shape, f"that of q, {(*batch, self.kernels.nq)}")
        return flat, _reals(rates.reshape(flat.shape)), batch


def drop_kernel(
    scene: Scene,
    settings: DropSettings,
    spill: SpillSettings | None = None,
    fragility: FragilityTable | None = None,
    stop: StopSettings | None = None,
    network: DropNetwork | None = None,
    damage: FragilityTable | None = None,
) -> DropKernel:
    """Return the drop and spill kernel of a scene with a carried object; cached per set of constants.

    Args:
        scene: The scene.
        settings: Constants of the drop model.
        spill: Constants of the spill model; the shipped ones by default.
        fragility: Table of fragilities, including the carried object's; the shipped table by default.
        stop: Constants of the protective stop; the shipped ones by default.
        network: Correction of the object's hits; none by default.
        damage: Fragilities of the entities: the row "carried" is then P of damage; by default P of a hit.

    Raises:
        UnsupportedError: If the core cannot represent the scene.
    """
    constants = settings.of(drop_tables(scene).shape_class)
    spill = SpillSettings.shipped() if spill is None else spill
    fragility = FragilityTable.shipped() if fragility is None else fragility
    stop = StopSettings.shipped() if stop is None else stop
    return _kernel(scene, constants, spill, fragility, stop, network, damage)


@per_scene(most=4)
def _kernel(
    scene: Scene,
    constants: DropConstants,
    spill: SpillSettings,
    fragility: FragilityTable,
    stop: StopSettings,
    network: DropNetwork | None,
    damage: FragilityTable | None,
) -> DropKernel:
    return DropKernel(
        drop_tables(scene),
        constants,
        compile_scene(scene).kernels,
        speed=scene.limits.velocity,
        n_entity=len(scene.entities),
        contents=None if scene.contents is None else (spill_tables(scene), spill),
        loss=loss_tables(scene, fragility),
        stop=StopTables(settings=stop, acceleration=scene.limits.acceleration),
        network=network,
        damage=None if damage is None else damage_tables(scene, damage),
    )


def _targets(tables: DropTables) -> Float[Array, "target 12"]:
    """Return rows of centre, axis, half sizes, diagonal, supporting half sizes, bottom and top, fixed."""
    columns = (
        tables.target_centre,
        tables.target_axis,
        tables.target_half,
        tables.target_diagonal[:, None],
        tables.target_carries,
        tables.target_height,
        tables.target_fixed[:, None],
    )
    return np.concatenate(columns, axis=1)


def _reals(values: Array) -> Array:
    return np.ascontiguousarray(values, dtype=np.float64)
