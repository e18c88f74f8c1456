r"""The objective J = V + w S, and how a path is charged for it.

.. math:: J = \int (m(q) + w\, I(q))\, ds \qquad V = \int m\, ds, \quad S = \int I\, ds

ds is joint-space length by default, the same for motion and impact, so that J does not depend on how densely a path is
sampled and stays additive over edges. Integrals are trapezoid sums with sub-steps of at most `COST_STEP`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import COST_STEP, ImpactKernel
from graceful_plan.costs.cost import AHEAD, Cost, StateBatch, checked_state
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.motion import JointLength
from graceful_plan.exceptions import SettingError, ShapeError
from graceful_plan.path import Path
from graceful_plan.result import CostBreakdown
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import Trajectory

Array = np.ndarray


MAX_WEIGHT = 1e9
"""Greatest safety weight; beyond, the motion drowns in the rounding of the impact."""
MEAN_PACE = 0.7
"""Mean share of the velocity limits over the time of a motion that is retimed at full speed: 0.71 on the bundled tasks,
0.36 at half speed."""
PACE_SPREAD = 0.42
"""Standard deviation of that share, relative to its mean."""


@final
@dataclass(frozen=True, kw_only=True)
class Objective:
    """What to minimise.

    Args:
        motion: Cost of moving, a density over length.
        impact: Cost of failing, a density over the exposure.
        w: Safety weight, at least 0; 0 is an ordinary planner.
        exposure: What the impact is integrated over: "length" [rad]; "time" [s], on a path at the joints' velocity
            limits and on a trajectory as timed; "waypoints", the paper's plain sum over vertices, start included.
        pace: How fast a path will be travelled, for models that ask for velocities: mean share of the velocity at which
            one joint is at its limit. Not used if the exposure is time.
    """

    motion: Cost = JointLength()
    impact: Cost = ImpactCost()
    w: float = 1.0
    exposure: str = "length"
    pace: float = MEAN_PACE

    def __post_init__(self) -> None:
        if not 0.0 <= self.w <= MAX_WEIGHT:
            raise SettingError("w", self.w, f"a number from 0 to {MAX_WEIGHT:g}")
        if not 0.0 <= self.pace <= 1.0:
            raise SettingError("pace", self.pace, "a share from 0 to 1")
        if self.exposure not in ("length", "time", "waypoints"):
            raise SettingError("exposure", self.exposure, "'length', 'time' or 'waypoints'")
        for name, cost in (("motion", self.motion), ("impact", self.impact)):
            if not isinstance(cost, Cost):
                raise SettingError(name, cost, "a graceful_plan.Cost")

    def with_weight(self, w: float) -> Objective:
        """The same objective with another safety weight."""
        return replace(self, w=w)

    @property
    def paces(self) -> tuple[float, float]:
        """Two shares of the greatest velocity that stand for the spread of velocities along a motion.

        With one alone, paths are found along which an object that flies on at just that velocity lands in a gap.
        """
        if self.exposure == "time":
            return 1.0, 1.0  # at the velocity limits, as the exposure itself
        return self.pace * (1.0 - PACE_SPREAD), self.pace * (1.0 + PACE_SPREAD)

    def bind(self, scene: Scene) -> SceneObjective:
        """Make it ready to evaluate edges in a scene."""
        return SceneObjective(self, scene)


@final
@dataclass(frozen=True, eq=False)
class ChargedStates:
    """States at which a motion is charged for its impact: the integral is the sum of weight times density."""

    batch: StateBatch
    weight: Float[Array, " n"]
    """Exposure that each stands for: [rad], [s], or 1 if the exposure is waypoints."""
    place: Float[Array, " n"]
    """Where each is, in numbers of vertices or samples of the motion from its start; fractions lie in between."""


@final
class SceneObjective:
    """An objective in a scene: what planners see (`BoundObjective`), and the breakdown of whole paths."""

    def __init__(self, objective: Objective, scene: Scene) -> None:
        self.objective, self.scene = objective, scene
        self.kernels = compile_scene(scene).kernels

    @property
    def w(self) -> float:
        """Safety weight."""
        return self.objective.w

    @property
    def motion_is_length(self) -> bool:
        """Whether V is the joint-space length, so that distances bound J from below."""
        return self.objective.motion == JointLength()

    @cached_property
    def kernel(self) -> ImpactKernel | None:
        """The native kernel that computes the edge costs, None if there is none."""
        impact = self.objective.impact
        by_length = self.motion_is_length and self.objective.exposure == "length"
        return impact.kernel(self.scene, self.objective.paces) if by_length and isinstance(impact, ImpactCost) else None

    def states(self, q: Float[Array, "n nq"], qd: Float[Array, "n nq"] | None = None) -> Float[Array, " n"]:
        """Impact given a failure at each state, at rest without joint velocities [rad/s or m/s]."""
        return checked_state(self.objective.impact, moving_batch(self.scene, q, qd))

    def edges(self, q0: Float[Array, "n nq"], q1: Float[Array, "n nq"]) -> Float[Array, "n 2"]:
        """V and S of straight edges from `q0` to `q1`."""
        if self.kernel is not None:
            return self.kernel.edges(q0, q1)
        samples = EdgeSamples(q0, q1, self.scene.limits.velocity, self.objective.paces)
        batch = StateBatch(self.scene, samples.q, samples.direction, samples.speed)
        motion = samples.integral(checked_state(self.objective.motion, batch), samples.length)
        if self.objective.exposure == "waypoints":
            return np.stack([motion, self.states(q1)], axis=1)
        measure = samples.length if self.objective.exposure == "length" else samples.duration
        return np.stack([motion, samples.integral(checked_state(self.objective.impact, batch), measure)], axis=1)

    def edge_gradients(
        self, q0: Float[Array, "n nq"], q1: Float[Array, "n nq"], step: float = COST_STEP
    ) -> tuple[Float[Array, "n 2"], Float[Array, "n nq"], Float[Array, "n nq"]] | None:
        """`edges`, and the derivatives of V + w S of each edge with respect to `q0` and `q1`; see `ImpactKernel`.

        None without a native kernel that has derivatives. An edge without length has none; they are given as 0.

        Args:
            q0: Where the edges begin.
            q1: Where they end.
            step: Largest distance between samples [rad]; `edges` takes `COST_STEP`.
        """
        found = None if self.kernel is None else self.kernel.edge_gradients(q0, q1, step)
        if found is None:
            return None
        cost, d_q0, d_q1 = found
        length = cost[:, :1]
        along = np.divide(q1 - q0, length, out=np.zeros_like(d_q0), where=length > 0.0)
        return cost, self.w * d_q0 - along, self.w * d_q1 + along

    def widened(self, metres: float) -> SceneObjective | None:
        """Return the objective with hits smeared by so much more, None if its impact has no such form.

        A descent that begins wide feels hazards from afar; costs are only true at the width of the objective itself.

        Raises:
            SettingError: If the width is not a positive number.
        """
        if not 0.0 < metres < np.inf:
            raise SettingError("metres", metres, "a finite number > 0 [m]")
        impact = self.objective.impact
        wide = impact.widened(metres) if isinstance(impact, ImpactCost) else None
        return None if wide is None else replace(self.objective, impact=wide).bind(self.scene)

    def breakdown(self, path: Path | Trajectory, start_time: float = 0.0) -> CostBreakdown:
        """Cost of a whole path, or of a trajectory, with where its impact comes from; see `charged_states`."""
        charged = self.charged_states(path, start_time)
        samples = self._samples(path.path if isinstance(path, Trajectory) else path)
        batch = StateBatch(self.scene, samples.q, samples.direction, samples.speed)
        motion = samples.integral(checked_state(self.objective.motion, batch), samples.length).sum()
        return self._breakdown(float(motion), charged.batch, charged.weight)

    def charged_states(self, path: Path | Trajectory, start_time: float = 0.0) -> ChargedStates:
        """Return the states at which a path, or a trajectory, is charged for its impact: sums over them are integrals.

        Only a trajectory's states have times, whatever the exposure: those of its samples plus `start_time` [s].

        Raises:
            ShapeError: If the path does not fit the scene.
        """
        points = path.path if isinstance(path, Trajectory) else path
        if points.q.shape[1] != len(self.scene.joints):
            raise ShapeError("path", points.q.shape, f"(n, {len(self.scene.joints)})")
        vertices = np.arange(len(points), dtype=np.float64)
        times = start_time + path.t if isinstance(path, Trajectory) else None
        if isinstance(path, Trajectory) and self.objective.exposure == "time":
            return ChargedStates(*_timed_batch(self.scene, path, times), place=vertices)
        if self.objective.exposure == "waypoints":
            return ChargedStates(StateBatch(self.scene, points.q, time=times), np.ones(len(points)), place=vertices)
        samples = self._samples(points)
        measure = samples.length if self.objective.exposure == "length" else samples.duration
        if times is not None:
            times = np.interp(samples.place, vertices, times)
        batch = StateBatch(self.scene, samples.q, samples.direction, samples.speed, times)
        return ChargedStates(batch, samples.weights(measure), place=samples.place)

    def _samples(self, points: Path) -> EdgeSamples:
        return EdgeSamples(points.q[:-1], points.q[1:], self.scene.limits.velocity, self.objective.paces)

    def _breakdown(self, motion: float, batch: StateBatch, weight: Float[Array, " n"]) -> CostBreakdown:
        impact = self.objective.impact
        if not isinstance(impact, ImpactCost):
            total = float(weight @ checked_state(impact, batch))
            return CostBreakdown(motion=motion, impact=total, w=self.w)
        exposure = np.tensordot(weight, impact.probability(batch), axes=1)
        parts = exposure * impact.hazard_severity(self.scene)
        return CostBreakdown(
            motion=motion,
            impact=float(parts.sum()),
            w=self.w,
            impact_by_entity=dict(zip(impact.hazards(self.scene), parts.sum(axis=0).tolist(), strict=True)),
            impact_by_component=dict(zip(self.scene.components, parts.sum(axis=1).tolist(), strict=True)),
        )


@final
class EdgeSamples:
    """Evenly spaced samples of many edges in one batch, both ends of each included, with trapezoid weights.

    Their speeds are by turns the first and the second of `paces`, times that of the slowest joint at its limit.
    """

    def __init__(
        self,
        q0: Float[Array, "n nq"],
        q1: Float[Array, "n nq"],
        velocity: Float[Array, " nq"],
        paces: tuple[float, float],
        step: float = COST_STEP,
    ) -> None:
        delta = q1 - q0
        self.length = np.linalg.norm(delta, axis=1)
        self.duration = np.max(np.abs(delta) / velocity, axis=1, initial=0.0)
        pieces = np.maximum(1, np.ceil(self.length / step)).astype(int)
        self.first = np.cumsum(pieces + 1) - (pieces + 1)
        self.edge = np.repeat(np.arange(len(q0)), pieces + 1)
        self._piece = np.arange(len(self.edge)) - self.first[self.edge]
        self._pieces = pieces
        s = self._piece / pieces[self.edge]
        self.place = self.edge + s
        self.q = q0[self.edge] + s[:, None] * delta[self.edge]
        safe = np.where(self.length > 0, self.length, 1.0)
        self.direction = (delta / safe[:, None])[self.edge]
        limit = np.where(self.duration > 0, self.length / np.where(self.duration > 0, self.duration, 1.0), 0.0)
        self.speed = limit[self.edge] * np.array(paces)[self._piece % 2]

    def weights(self, measure: Float[Array, " n"]) -> Float[Array, " m"]:
        """Trapezoid weight of each sample when each edge measures `measure`."""
        ends = (self._piece == 0) | (self._piece == self._pieces[self.edge])
        return np.where(ends, 0.5, 1.0) * (measure / self._pieces)[self.edge]

    def integral(self, values: Float[Array, " m"], measure: Float[Array, " n"]) -> Float[Array, " n"]:
        """Integral of sampled values over each edge."""
        if len(self.first) == 0:
            return np.zeros(0)
        return np.add.reduceat(values * self.weights(measure), self.first)


def moving_batch(
    scene: Scene,
    q: Float[Array, "n nq"],
    qd: Float[Array, "n nq"] | None,
    times: Float[Array, " n"] | None = None,
) -> StateBatch:
    """Return states with these joint velocities, at rest without any, at these times [s] if they are known."""
    if qd is None:
        return StateBatch(scene, q, time=times)
    speed = np.linalg.norm(qd, axis=1)
    return StateBatch(scene, q, qd / np.where(speed > 0, speed, 1.0)[:, None], speed, times)


def trajectory_batch(
    scene: Scene, trajectory: Trajectory, t: Float[Array, " n"], times: Float[Array, " n"] | None = None
) -> StateBatch:
    """Return the states of a trajectory at some of its times [s], with the motion to come.

    Args:
        scene: The scene.
        trajectory: The trajectory.
        t: On its own clock.
        times: The same on the clock of the scene's predictions, if they are known.
    """
    state = trajectory.at(t)
    found = moving_batch(scene, state.q, state.qd, times)
    return StateBatch(scene, found.q, found.direction, found.speed, times, trajectory.at(t[:, None] + AHEAD).q)


def _timed_batch(
    scene: Scene, trajectory: Trajectory, times: Float[Array, " n"] | None
) -> tuple[StateBatch, Float[Array, " n"]]:
    gaps = np.diff(trajectory.t)
    weight = np.zeros(len(trajectory.t))
    weight[:-1] += 0.5 * gaps
    weight[1:] += 0.5 * gaps
    return trajectory_batch(scene, trajectory, trajectory.t, times), weight


def evaluate(
    path: Path | Trajectory | Array, scene: Scene, objective: Objective | None = None, *, start_time: float = 0.0
) -> CostBreakdown:
    """Compute the cost of any path, from any planner.

    Entities that move are met where they are at the times of a trajectory, whatever the exposure; a path without times
    meets them anywhere along their predicted paths.

    Args:
        path: A path, a trajectory, or an array of configurations [n, nq].
        scene: The scene, with what is carried attached.
        objective: What to compute; the default `Objective()` if None.
        start_time: What to add to a trajectory's times to have those of the scene's predictions [s].

    Raises:
        ShapeError: If the path does not fit the scene.
        CostError: If a cost breaks its contract.
        SettingError: If the start time is not finite.
    """
    if not np.isfinite(start_time):
        raise SettingError("start_time", start_time, "a finite time [s]")
    points = path if isinstance(path, Path | Trajectory) else Path(path)
    return (objective or Objective()).bind(scene).breakdown(points, start_time)
