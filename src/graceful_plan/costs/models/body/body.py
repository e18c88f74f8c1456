"""The body model: entities that the arm and the carried object hit if joints fail at this state.

For each failure mode, the model computes a few configurations after the failure. The least distance of the arm (or of
the carried object) to an entity in any of them determines the probability of a hit. Modes:

- *collapse*: no joint has power until brakes hold them; rigid-body dynamics under gravity.
- *joint j*: joint j has no power and falls; the others move on.
- *stuck j*: joint j stays where it is; the others move on.
- *stray*: the arm moves on, but deviates from its path.

The working joints follow the motion ahead. If a trajectory is known it is given as `ahead`; for a single state, joints
move on along their velocity and soon stop. Stuck joints do harm late, at the end of a motion that is completed with a
wrong joint: without `ahead` the model predicts hardly any of that.

Obstacles stop the arm, even those that could be pushed away, since most of them stand on something. Hence penetration
at earlier configurations adds to later distances. A joint without power yields instead: it rests on an obstacle while
the others move on.

Specification
-------------
Everything is in double precision, z is up, g = 9.81. Tables: `BodyTables`; constants: `BodySettings`. Spheres,
obstacles and their signed distances are those of collision checking (`RobotArrays`, `WorldArrays`, stored in single
precision, computed in double). The native kernel (native/body.hpp) follows this text. Planners use sums of P S in
single precision; `SINGLE` is the error.

.. code-block:: text

    Dynamics at a configuration x
      M(x)  : mass matrix of the frames with their rotors' inertia (armature) on the diagonal
      G(x)  : torques that hold the arm against gravity. Velocity products are left out.
      soft(v, u) = sign(v) max(|v| - u, 0)
      move(x, v, v') : y = x + h (v + v')/2;  v <- 0 if y is out of the joint's range, else v';  x <- y clamped to it

    Motion ahead: r_0 = q;  r_k = ahead_k, or q + T (1 - exp(-k h/T)) qd, clamped to the joints' ranges

    Failed configurations x_0 = q, x_1, ..
      collapse : h = brake_time/5, v = qd; five times
                   v' = soft((M + h D)^-1 (M v - h G), h f_i/(M + h D)_ii);  move every joint
                 D: damping on the diagonal, f: dry friction
                 x_6 = x_5 + tb v, clamped: the brakes engage
      joint j  : h = step, v = qd_j, z_0 = q_j, M as at q;  K times, G as at x_(k-1):
                   s = 1/(M_jj + h (damping_j + resistance))
                   v' = soft((M_jj v - h G_j) s, h f_j s);  move joint j from z_(k-1) to z_k
                   x_k = r_k but for joint j, which is at z_k
                   where b_k > b_(k-1) + tolerance, it rests on something: z_k <- z_(k-1), v <- 0, b_k <- b_(k-1)
      stuck j  : x_k = r_k but for joint j, which is at q_j
      stray    : x_k = r_k
      Without ahead, stuck and stray evaluate only x_0 and x_K: both are hardly predictable then, and the configurations
      in between add nothing.

    Distances: of a row (body, carried) at x_k to an entity
      d_k = min over the row's spheres and the entity's geoms that they may hit of the signed distance
      b_k = max over earlier configurations and x_k, all rows, all obstacles of -(signed distance), 0
      d = min over k of d_k + gain max(b_(k-1) - tolerance, 0),   b_(-1) = 0;  gain, tolerance: by generator
      s(u) = 1/(1 + exp(u));  P = max(0, s((d - offset)/spread) - s(U))/(1 - s(U)),  U = 8,  by generator and row;
        0 for entities without geoms. P is 0 beyond U spreads from the offset

    Together: of generators "joint" and "stuck", the mean over joints

Derivatives of the impact are those of the nearest spheres along their contact normals, through the motion ahead and the
falls above. They neglect how inertia changes with q, how the joints of a collapsing arm are coupled and how contacts
stop a fall. So they are approximate, but good enough for descents.

Searches and descents use a rough impact. Of falling joints, only the step at three fifths and the last one are
evaluated. Hits below a small share of the worst possible impact are ignored (s(U) is that share). Edges are sampled
every 0.2 rad, and motions in a descent at 32 states, with linear interpolation. `SEARCHED` is the error of sums along
motions. Returned motions are evaluated in full.

References:
    Own work, fitted to rollouts in MuJoCo; see the head of `body.yaml`. Composite inertias: Featherstone, "Rigid Body
    Dynamics Algorithms", 2008, chapter 6.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.core import _native
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import CAPACITY, ImpactKernel, Kernels
from graceful_plan.costs.cost import StateBatch
from graceful_plan.costs.models.body.constants import GENERATORS, BodySettings
from graceful_plan.costs.models.body.tables import ROWS, body_tables, native_rows
from graceful_plan.exceptions import SettingError, ShapeError
from graceful_plan.path import finite_array
from graceful_plan.scene.per_scene import per_scene
from graceful_plan.scene.scene import Scene

FAR = 8.0
"""U: number of spreads beyond which P is 0."""
SINGLE = 1e-4
"""Bound of the relative error of sums of P S in single precision; at most 6e-5 measured in bundled scenes."""
SEARCHED = 0.16
"""Error of sums of P S along motions in descents: root mean square relative to their mean over motions. Measured: 0.03
to 0.15 in bundled scenes. For edges of 1 rad, as in searches, up to half as much again."""
_MOTION = ("brake_time", "brake_stop", "step", "carry_on")


@final
@dataclass(frozen=True)
class BodyModel:
    """P that the arm and the carried object hit each entity, by failure mode.

    Args:
        settings: Constants; the shipped ones by default.
    """

    settings: BodySettings = field(default_factory=BodySettings.shipped)

    def distances(
        self, batch: StateBatch, ahead: Float[Array, "n step nq"] | None = None
    ) -> Float[Array, "n mode row entity"]:
        """Compute d [m] for each mode (see `mode_names`) and row of `ROWS`; clamped at the distance where P is 0.

        Args:
            batch: States at which the robot fails.
            ahead: Configurations 1, 2, .. times `settings.step` after each state; None to move on along the velocity.

        Raises:
            ShapeError: If `ahead` is not one path for each state.
            SettingError: If `ahead` has too many steps.
        """
        scene, nq = batch.scene, batch.q.shape[1]
        known = None if ahead is None else _checked(ahead, len(batch), nq)
        offset, spread = mode_margins(self.settings, nq)
        d = np.tile((offset + FAR * spread)[..., None], (len(batch), 1, 1, len(scene.entities)))
        if d.size:
            native = native_model(scene, self.settings)
            d[:, :, : body_tables(scene).n_row] = native.distances(_reals(batch.q), _reals(batch.qd), known)
        return d

    def modes(
        self, batch: StateBatch, ahead: Float[Array, "n step nq"] | None = None
    ) -> Float[Array, "n mode row entity"]:
        """Compute P for each failure mode; see `distances`."""
        return chance(self.distances(batch, ahead), *mode_margins(self.settings, batch.q.shape[1]))

    def probability(
        self, batch: StateBatch, ahead: Float[Array, "n step nq"] | None = None
    ) -> Float[Array, "n generator row entity"]:
        """Compute P for each of `GENERATORS`, with equally likely joints; see `modes`."""
        n = batch.q.shape[1]
        P = self.modes(batch, ahead)
        return np.stack([P[:, 0], P[:, 1 : n + 1].mean(axis=1), P[:, n + 1 : -1].mean(axis=1), P[:, -1]], axis=1)

    def impact(
        self, batch: StateBatch, severity: Float[Array, "component entity"], weights: Float[Array, "generator row"]
    ) -> Float[Array, " n"]:
        """Compute sums of weights P S, with weights for each of `ROWS`; other components do not count."""
        native = native_model(batch.scene, self.settings)
        return native.impact(*_harm(batch.scene, severity, weights), _reals(batch.q), _reals(batch.qd))

    def impact_gradient(
        self, batch: StateBatch, severity: Float[Array, "component entity"], weights: Float[Array, "generator row"]
    ) -> tuple[Float[Array, " n"], Float[Array, "n nq"], Float[Array, "n nq"]]:
        """Compute `impact` and its approximate derivatives in q and in the joint velocities; see above."""
        native = native_model(batch.scene, self.settings)
        return native.gradient(*_harm(batch.scene, severity, weights), _reals(batch.q), _reals(batch.qd))

    def kernel(
        self,
        scene: Scene,
        severity: Float[Array, "component entity"],
        weights: Float[Array, "generator row"],
        paces: tuple[float, float] = (1.0, 1.0),
    ) -> ImpactKernel:
        """Return the impact with these severities and weights, for planners; see `NativeModel.kernel`."""
        native = native_model(scene, self.settings)
        harm = _harm(scene, severity, weights)
        return ImpactKernel(compile_scene(scene).kernels, _native.BodyImpact(native, *harm, *paces))


def mode_margins(settings: BodySettings, nq: int) -> tuple[Float[Array, "mode row"], Float[Array, "mode row"]]:
    """Return offset and spread of each failure mode [m]."""
    generators = ("collapse", *("joint",) * nq, *("stuck",) * nq, "stray")
    margins = [[settings.margin(generator, row) for row in ROWS] for generator in generators]
    offset, spread = (np.array([[getattr(m, name) for m in rows] for rows in margins]) for name in ("offset", "spread"))
    return offset, spread


def chance(
    d: Float[Array, "n mode row entity"], offset: Float[Array, "mode row"], spread: Float[Array, "mode row"]
) -> Float[Array, "n mode row entity"]:
    """Compute the probability of a hit at a distance [m]."""
    least = 1.0 / (1.0 + np.exp(FAR))
    scaled = np.clip((d - offset[..., None]) / spread[..., None], -60.0, FAR)
    return np.maximum(1.0 / (1.0 + np.exp(scaled)) - least, 0.0) / (1.0 - least)


def mode_names(scene: Scene) -> tuple[str, ...]:
    """Return the failure modes in the order of `BodyModel.modes`: "collapse", "joint/..", "stuck/..", "stray"."""
    return ("collapse", *(f"joint/{j}" for j in scene.joints), *(f"stuck/{j}" for j in scene.joints), "stray")


def mode_weights(weights: Float[Array, "generator row"], nq: int) -> Float[Array, "mode row"]:
    """Spread weights of `GENERATORS` over failure modes; those of joints are shared evenly.

    Raises:
        ShapeError: If there is not one for each generator and each of `ROWS`.
        SettingError: If a weight is negative.
    """
    values = finite_array("weights", weights)
    if values.shape != (len(GENERATORS), len(ROWS)):
        raise ShapeError("weights", values.shape, f"({len(GENERATORS)}, {len(ROWS)}): {', '.join(GENERATORS)}")
    if (values < 0.0).any():
        raise SettingError("weights", float(values.min()), "at least 0")
    collapse, joint, stuck, stray = values[:, None]
    return np.concatenate([collapse, np.repeat(joint / nq, nq, axis=0), np.repeat(stuck / nq, nq, axis=0), stray])


def _checked(ahead: Array, n: int, nq: int) -> Float[Array, "n step nq"]:
    known = finite_array("ahead", ahead)
    if known.ndim != 3 or known.shape[0] != n or known.shape[2] != nq:
        raise ShapeError("ahead", known.shape, f"({n}, step, {nq})")
    if known.shape[1] > CAPACITY["steps ahead"]:
        raise SettingError("steps ahead", known.shape[1], f"at most {CAPACITY['steps ahead']}")
    return _reals(known)


def _harm(scene: Scene, severity: Array, weights: Array) -> tuple[Float[Array, "mode row"], Float[Array, "row entity"]]:
    """Return weights by failure mode and severities by entity, as the core takes them."""
    rows = _severity(scene, severity)
    return _reals(mode_weights(weights, len(scene.joints))[:, : len(rows)]), rows


def _severity(scene: Scene, severity: Array) -> Float[Array, "row entity"]:
    names = list(scene.components)
    shape = (len(names), len(scene.entities))
    if np.shape(severity) != shape:
        raise ShapeError("severity", np.shape(severity), str(shape))
    values, rows = finite_array("severity", severity), np.zeros((body_tables(scene).n_row, shape[1]))
    for row, name in enumerate(ROWS[: len(rows)]):
        if name in names:
            rows[row] = values[names.index(name)]
    return rows


@per_scene(most=4)
def native_model(scene: Scene, settings: BodySettings) -> _native.BodyModel:
    """Return the native model; cached per scene."""
    return native_model_of(scene, settings, compile_scene(scene).kernels)


def native_model_of(scene: Scene, settings: BodySettings, kernels: Kernels) -> _native.BodyModel:
    """Return the native model with the given kernels."""
    compiled, tables = compile_scene(scene), body_tables(scene)
    n_frame = len(tables.mass)
    resistance = np.full(len(tables.lower), settings.resistance)
    drive = [tables.lower, tables.upper, tables.armature, tables.damping, tables.friction, resistance, tables.speed]
    inertia = [tables.mass[:, None], tables.centre, tables.inertia.reshape(n_frame, 9)]
    constants = {name: getattr(settings, name) for name in _MOTION}
    for generator in GENERATORS:
        for name in ("stop_gain", "stop_tolerance"):
            constants[f"{generator}.{name}"] = getattr(getattr(settings, generator), name)
        for row in ROWS:
            margin = settings.margin(generator, row)
            constants |= {f"{generator}.{row}.offset": margin.offset, f"{generator}.{row}.spread": margin.spread}
    return _native.BodyModel(
        core=kernels.core,
        inertia=_reals(np.concatenate(inertia, axis=1)),
        drive=_reals(np.stack(drive, axis=1)),
        row=_integers(native_rows(tables, compiled.robot.sphere_link)),
        entity=_integers(tables.entity),
        n_row=tables.n_row,
        n_entity=len(scene.entities),
        n_step=settings.steps,
        constants=constants,
    )


def _reals(values: Array) -> Array:
    return np.ascontiguousarray(values, dtype=np.float64)


def _integers(values: Array) -> Array:
    return np.ascontiguousarray(values, dtype=np.int32)
