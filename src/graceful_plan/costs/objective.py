r"""The objective J = V + w S, and its evaluation along paths and trajectories.

.. math:: J = V + w\, S \qquad V = \int m(q)\, ds, \quad S = \int I(q, \dot q)\, dt

ds is joint-space length. Failures have a rate in time, so S integrates the impact over the times of the motion: S times
the failure rate is the expected harm of executing the motion. A trajectory has times and velocities. A path has none:
each edge is evaluated as if travelled with one joint at its velocity limit, a lower bound of the time that is additive
over edges. Searches evaluate edges at the paces of real motions (`search_paces`). Integrals are trapezoid sums with
sub-steps of at most `COST_STEP`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.core import _native
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import COST_STEP, ImpactKernel
from graceful_plan.costs.blocks.native_cost import native_kernel
from graceful_plan.costs.breakdown import impact_breakdown
from graceful_plan.costs.cost import Cost, StateBatch, checked_state, moving_batch
from graceful_plan.costs.cost_samples import CostSamples, timed_samples
from graceful_plan.costs.edge_samples import EdgeSamples
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.motion import JointLength
from graceful_plan.costs.slopes import CostSlopes
from graceful_plan.exceptions import SettingError, ShapeError
from graceful_plan.path import Path, is_real, plain_numbers
from graceful_plan.result import CostBreakdown
from graceful_plan.scene.scene import Scene
from graceful_plan.setting_checks import finite, positive, positive_fraction
from graceful_plan.timing.trajectory import Trajectory

MAX_WEIGHT = 1e9
"""Greatest safety weight; beyond it, V is lost in the rounding error of w S."""
DEFAULT_WEIGHT = 0.3
"""Default safety weight. Over the bundled tasks, predicted harm per executed task falls by a median factor of 4.2 for
11 % more duration; at 0.1 it is 2.9 for 4 %, at 1 4.4 for 14 %. Observed: see benchmarks/results/prevention.md."""
MEAN_PACE = 0.7
"""Time average of the fraction of the velocity limits in motions retimed at full speed: 0.71 on the bundled tasks, 0.36
at half speed."""
AT_LIMITS = (1.0, 1.0)
"""Paces of a path without times: the slowest joint of each edge at its limit."""
EXPOSURES = ("time", "length", "waypoints")
"""Names of the integration variables of the impact."""
MOST_STATES = 150_000
"""Largest number of states at which one path is evaluated."""
PACE_SPREAD = 0.42
"""Standard deviation of the fraction in `MEAN_PACE`, relative to its mean."""


def search_paces(speed: float = 1.0) -> tuple[float, float]:
    """Return two paces that represent the spread of velocities along a motion at a fraction of the velocity limits.

    A single pace would favour paths along which an object that flies on at just that velocity lands in a gap.
    """
    return speed * MEAN_PACE * (1.0 - PACE_SPREAD), speed * MEAN_PACE * (1.0 + PACE_SPREAD)


@final
@dataclass(frozen=True, kw_only=True)
class Objective:
    """The objective J = V + w S to minimise.

    Args:
        motion: Motion cost m, a density over length.
        impact: Impact I of a failure, a density over the exposure.
        w: Safety weight, at least 0; 0 is an ordinary planner. It is the joint motion [rad] that is worth spending to
            avoid one second in which a failure would do harm of severity 1.
        exposure: Integration variable of the impact: "time" [s], from the timing of a trajectory. To reproduce other
            work: "length" [rad], or "waypoints", the paper's plain sum over vertices (of a trajectory, over its
            samples), including the start.
    """

    motion: Cost = JointLength()
    impact: Cost = ImpactCost()
    w: float = DEFAULT_WEIGHT
    exposure: str = "time"

    def __post_init__(self) -> None:
        plain_numbers(self)
        if not (is_real(self.w) and 0.0 <= self.w <= MAX_WEIGHT):
            raise SettingError("w", self.w, f"a number from 0 to {MAX_WEIGHT:g}")
        if self.exposure not in EXPOSURES:
            raise SettingError("exposure", self.exposure, f"one of {', '.join(EXPOSURES)}")
        for name, cost in (("motion", self.motion), ("impact", self.impact)):
            if not isinstance(cost, Cost):
                raise SettingError(name, cost, "a graceful_plan.Cost")

    def with_weight(self, w: float) -> Objective:
        """Return the same objective with another safety weight."""
        return replace(self, w=w)

    def bind(self, scene: Scene, paces: tuple[float, float] = AT_LIMITS) -> SceneObjective:
        """Bind the objective to a scene, to evaluate edges.

        Args:
            scene: The scene.
            paces: Alternating paces of an edge's samples: fractions of the speed at which one joint is at its limit.
        """
        return SceneObjective(self, scene, paces)


@final
@dataclass(frozen=True, eq=False)
class TimedImpact:
    """Native impact of states at given times: of static entities, and of moving ones, exact and approximate."""

    still: ImpactKernel
    moving: _native.MovingImpact
    rough: _native.MovingImpact


@final
class SceneObjective:
    """An objective in a scene: the planners' interface (`BoundObjective`), and the breakdown of whole paths."""

    def __init__(self, objective: Objective, scene: Scene, paces: tuple[float, float] = AT_LIMITS) -> None:
        self.objective, self.scene, self.paces = objective, scene, paces
        self.kernels = compile_scene(scene).kernels

    @property
    def w(self) -> float:
        """Safety weight."""
        return self.objective.w

    @property
    def motion_is_length(self) -> bool:
        """Whether V is the joint-space length, so that distances are lower bounds of J."""
        return self.objective.motion == JointLength()

    @property
    def pace(self) -> float:
        """Mean fraction of the velocity limits at which edges are travelled."""
        return 0.5 * sum(self.paces)

    @cached_property
    def kernel(self) -> ImpactKernel | None:
        """The native kernel of the edge costs, None if there is none."""
        exposure = self.objective.exposure
        if not self.motion_is_length or exposure == "waypoints":
            return None
        kernel = native_kernel(self.objective.impact, self.scene, self.paces)
        if kernel is None or exposure == "length":
            return kernel
        return kernel.timed(self.pace * self.scene.limits.velocity)

    @cached_property
    def timed_impact(self) -> TimedImpact | None:
        """The native impact at times in a scene with moving entities; None without them or without a native impact."""
        impact = self.objective.impact
        if not (self.scene.moving and isinstance(impact, ImpactCost) and self.objective.exposure != "waypoints"):
            return None
        still = impact.static_kernel(self.scene, self.paces)
        if still is None:
            return None
        return TimedImpact(still, *(impact.moving_impact(self.scene, rough=rough) for rough in (False, True)))

    def states(self, q: Float[Array, "n nq"], qd: Float[Array, "n nq"] | None = None) -> Float[Array, " n"]:
        """Compute the impact given a failure at each state, with joint velocities [rad/s or m/s], at rest if None."""
        if qd is None and self.kernel is not None:
            return self.kernel.states(q)
        return checked_state(self.objective.impact, moving_batch(self.scene, q, qd))

    def approximate_states(self, q: Float[Array, "n nq"], qd: Float[Array, "n nq"]) -> Float[Array, " n"]:
        """Compute the impact of moving states, by the kernel if there is one; approximate with moving entities."""
        return self.states(q, qd) if self.kernel is None else self.kernel.moving_states(q, qd)

    def edges(self, q0: Float[Array, "n nq"], q1: Float[Array, "n nq"]) -> Float[Array, "n 2"]:
        """Compute V and S of straight edges from `q0` to `q1`."""
        if self.kernel is not None:
            return self.kernel.edges(q0, q1)
        samples = self.samples(q0, q1)
        batch = StateBatch(self.scene, samples.q, samples.direction, samples.speed)
        motion = samples.integral(checked_state(self.objective.motion, batch), samples.length)
        if self.objective.exposure == "waypoints":
            return np.stack([motion, self.states(q1)], axis=1)
        measure = samples.length if self.objective.exposure == "length" else samples.duration
        return np.stack([motion, samples.integral(checked_state(self.objective.impact, batch), measure)], axis=1)

    def edge_gradients(
        self, q0: Float[Array, "n nq"], q1: Float[Array, "n nq"], step: float = COST_STEP
    ) -> tuple[Float[Array, "n 2"], Float[Array, "n nq"], Float[Array, "n nq"]] | None:
        """Compute `edges`, and the derivatives of V + w S of each edge with respect to `q0` and `q1`.

        None without a native kernel that has derivatives (see `ImpactKernel`), unless the costs have gradients. The
        derivatives of an edge without length are undefined; they are returned as 0.

        Args:
            q0: Starts of the edges.
            q1: Ends of the edges.
            step: Largest distance between samples [rad]; `edges` uses `COST_STEP`.
        """
        if self.kernel is None and not (self.impact_slopes.has_gradient and self.motion_slopes.has_gradient):
            return None
        found = self.impact_gradients(q0, q1, step) if self.kernel is None else self.kernel.edge_gradients(q0, q1, step)
        if found is None:
            return None
        cost, d_q0, d_q1 = found
        if not self.motion_is_length:
            _, m_q0, m_q1 = self._motion_gradients(self.samples(q0, q1, step))
            return cost, self.w * d_q0 + m_q0, self.w * d_q1 + m_q1
        length = cost[:, :1]
        along = np.divide(q1 - q0, length, out=np.zeros_like(d_q0), where=length > 0.0)
        return cost, self.w * d_q0 - along, self.w * d_q1 + along

    def impact_gradients(
        self, q0: Float[Array, "n nq"], q1: Float[Array, "n nq"], step: float = COST_STEP
    ) -> tuple[Float[Array, "n 2"], Float[Array, "n nq"], Float[Array, "n nq"]]:
        """Compute `edges`, and the derivatives of S alone, for costs without a kernel, in one batch of states."""
        samples = self.samples(q0, q1, step)
        motion = samples.length if self.motion_is_length else self._motion_gradients(samples)[0]
        if self.objective.exposure == "waypoints":
            value, d_q, _ = self.impact_slopes(q1, np.zeros_like(q1))
            return np.stack([motion, value], axis=1), np.zeros_like(d_q), d_q
        slopes = self.impact_slopes(samples.q, samples.direction * samples.speed[:, None])
        value, d_q0, d_q1 = samples.integral_slopes(slopes, by_length=self.objective.exposure == "length")
        return np.stack([motion, value], axis=1), d_q0, d_q1

    def _motion_gradients(self, samples: EdgeSamples) -> tuple[Array, Array, Array]:
        slopes = self.motion_slopes(samples.q, samples.direction * samples.speed[:, None])
        return samples.integral_slopes(slopes, by_length=True)

    def tangent_slopes(
        self, q: Float[Array, "n nq"], tangent: Float[Array, "n nq"]
    ) -> tuple[Float[Array, " n"], Float[Array, "n nq"], Float[Array, "n nq"]]:
        """Return the motion cost of states along a path, with derivatives with respect to q and to the tangents.

        The velocities are those of edges; see `EdgeSamples`.
        """
        length = np.linalg.norm(tangent, axis=1, keepdims=True)
        at_limit = np.max(np.abs(tangent) / self.scene.limits.velocity, axis=1, keepdims=True)
        rate = np.divide(self.pace, at_limit, out=np.zeros_like(at_limit), where=at_limit > 0.0)
        value, d_q, d_qd = self.motion_slopes(q, rate * tangent)
        # The length of the tangent does not matter: the joint that reaches its limit first sets the speed.
        along = np.divide(tangent, length, out=np.zeros_like(tangent), where=length > 0.0)
        d_tangent = rate * d_qd
        return value, d_q, d_tangent - np.sum(d_tangent * along, axis=1, keepdims=True) * along

    @cached_property
    def impact_slopes(self) -> CostSlopes:
        """The impact of states, with derivatives."""
        return CostSlopes(self.objective.impact, self.scene)

    @cached_property
    def motion_slopes(self) -> CostSlopes:
        """The motion cost of states, with derivatives."""
        return CostSlopes(self.objective.motion, self.scene)

    def descended(self) -> SceneObjective | None:
        """Return an equivalent objective that supports descents of whole motions; None if there is none.

        This is the objective itself, or the length alone if the impact has no weight. In scenes with moving entities,
        the impact has to be native: others neither know the times of a motion nor approximate well without them.
        """
        if self.w == 0.0 and self.motion_is_length:
            return Objective(impact=ImpactCost(model="box_overlap"), w=0.0).bind(self.scene, self.paces)
        native = self.kernel is not None and self.objective.exposure == "time"
        timed = self.timed_impact is not None
        return self if native or timed or not self.scene.moving else None

    def widened(self, metres: float) -> SceneObjective | None:
        """Return the objective with hits blurred by a standard deviation [m], None if its impact does not support it.

        A descent from a wide blur has gradients far from the entities; reported costs use the objective itself.

        Raises:
            SettingError: If the width is not a positive number.
        """
        positive("metres", metres, "a finite number > 0 [m]")
        impact = self.objective.impact
        wide = impact.widened(metres) if isinstance(impact, ImpactCost) else None
        return None if wide is None else replace(self.objective, impact=wide).bind(self.scene, self.paces)

    def breakdown(self, path: Path | Trajectory, start_time: float = 0.0) -> CostBreakdown:
        """Compute the cost of a whole path or trajectory, with its impact by entity and component."""
        motion, impact = self._motion(self._points(path)), self.objective.impact
        if isinstance(impact, ImpactCost) and not impact.harmed_entities(self.scene):
            nothing = dict.fromkeys(self.scene.components, 0.0)
            return CostBreakdown(
                motion=motion, impact=0.0, w=self.w, exposure=self.objective.exposure, impact_by_component=nothing
            )
        samples = self.cost_samples(path, start_time)
        return impact_breakdown(impact, samples, motion=motion, w=self.w, exposure=self.objective.exposure)

    def cost_samples(self, path: Path | Trajectory, start_time: float = 0.0) -> CostSamples:
        """Return the states at which a path or trajectory is evaluated, with weights: sums over them are integrals.

        Only a trajectory's states have times, whatever the exposure: those of its samples plus `start_time` [s].

        Raises:
            ShapeError: If the path does not fit the scene.
            SettingError: If it has more than `MOST_STATES` states.
        """
        points = self._points(path)
        vertices = np.arange(len(points), dtype=np.float64)
        if self.objective.exposure == "waypoints":
            times = start_time + path.t if isinstance(path, Trajectory) else None
            return CostSamples(StateBatch(self.scene, points.q, time=times), np.ones(len(points)), place=vertices)
        if isinstance(path, Trajectory):
            return timed_samples(self.scene, path, start_time, by_length=self.objective.exposure == "length")
        samples = self.samples(points.q[:-1], points.q[1:])
        measure = samples.length if self.objective.exposure == "length" else samples.duration
        batch = StateBatch(self.scene, samples.q, samples.direction, samples.speed)
        return CostSamples(batch, samples.weights(measure), place=samples.place)

    def _motion(self, path: Path) -> float:
        """Return V of a path."""
        if self.motion_is_length:
            return float(path.segment_lengths.sum())
        samples = self.samples(path.q[:-1], path.q[1:])
        batch = StateBatch(self.scene, samples.q, samples.direction, samples.speed)
        return float(samples.integral(checked_state(self.objective.motion, batch), samples.length).sum())

    def _points(self, path: Path | Trajectory) -> Path:
        points = path.path if isinstance(path, Trajectory) else path
        if points.q.shape[1] != len(self.scene.joints):
            raise ShapeError("path", points.q.shape, f"(n, {len(self.scene.joints)})")
        states = float(np.sum(points.segment_lengths)) / COST_STEP + len(points)
        if states > MOST_STATES:
            expected = f"at most {MOST_STATES}, every {COST_STEP} rad: evaluate it in parts"
            raise SettingError("states of the path", int(min(states, 1e18)), expected)
        return points

    def samples(self, q0: Float[Array, "n nq"], q1: Float[Array, "n nq"], step: float = COST_STEP) -> EdgeSamples:
        """Return samples of straight edges, no farther apart than `step` [rad]."""
        return EdgeSamples(q0, q1, self.scene.limits.velocity, self.paces, step)


def evaluate(
    path: Path | Trajectory | Array,
    scene: Scene,
    objective: Objective | None = None,
    *,
    start_time: float = 0.0,
    speed: float = 1.0,
) -> CostBreakdown:
    """Compute the cost of any path, from any planner.

    For a trajectory, moving entities are at their predicted positions at its times, whatever the exposure. For a path
    without times, they are anywhere along their predicted paths.

    Args:
        path: A path, a trajectory, or an array of configurations [n, nq].
        scene: The scene, with the carried object attached.
        objective: The objective to evaluate; the default `Objective()` if None.
        start_time: Offset from the trajectory's times to the clock of the scene's predictions [s].
        speed: Fraction of the velocity limits at which a path without times is travelled, in (0, 1].

    Raises:
        ShapeError: If the path does not fit the scene.
        CostError: If a cost breaks its contract.
        SettingError: If the start time is not finite, the speed is out of range, or the path needs more than
            `MOST_STATES` states.
    """
    finite("start_time", start_time, "a finite time [s]")
    positive_fraction("speed", speed, "a fraction in (0, 1]")
    points = path if isinstance(path, Path | Trajectory) else Path(path)
    if not isinstance(objective, Objective | None):
        raise SettingError("objective", objective, "an Objective")
    return (objective or Objective()).bind(scene, (speed, speed)).breakdown(points, start_time)
