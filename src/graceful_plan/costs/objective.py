r"""The objective J = V + w S, and how a path is charged for it.

.. math:: J = V + w\, S \qquad V = \int m(q)\, ds, \quad S = \int I(q, \dot q)\, dt

ds is joint-space length. Failures come with time, so that S is what a failure at any moment does, summed over the
moments of the motion: times the rate of failures it is the expected harm of executing the motion. A trajectory has its
times and velocities. A path has none: its edges are charged as if each were travelled with one joint at its velocity
limit, a lower bound of the time that stays additive over edges. Searches charge edges at the paces of real motions
(`search_paces`). Integrals are trapezoid sums with sub-steps of at most `COST_STEP`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.core import _native
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import COST_STEP, ImpactKernel
from graceful_plan.costs.blocks.native_cost import native_kernel
from graceful_plan.costs.cost import AHEAD, Cost, StateBatch, checked_state, moving_batch
from graceful_plan.costs.edge_samples import EdgeSamples
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.motion import JointLength
from graceful_plan.costs.slopes import CostSlopes
from graceful_plan.exceptions import SettingError, ShapeError
from graceful_plan.path import Path, is_real
from graceful_plan.result import CostBreakdown
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import Trajectory

Array = np.ndarray


MAX_WEIGHT = 1e9
"""Greatest safety weight; beyond, the motion drowns in the rounding of the impact."""
DEFAULT_WEIGHT = 0.3
"""Safety weight by default. Over the bundled tasks, predicted harm per executed task falls by a median of 4.2 for 11 %
more duration; at 0.1 it is 2.9 for 4 %, at 1 4.4 for 14 %. See `benchmarks/`, prevention, for what was observed."""
MEAN_PACE = 0.7
"""Mean share of the velocity limits over the time of a motion that is retimed at full speed: 0.71 on the bundled tasks,
0.36 at half speed."""
AT_LIMITS = (1.0, 1.0)
"""Paces of a path of which nothing is known: the slowest joint of each edge at its limit."""
EXPOSURES = ("time", "length", "waypoints")
"""Words for what the impact is integrated over."""
FARTHEST = 1000.0
"""What positions and velocities of joints may be; the core refuses more. Cubics between odd samples overshoot."""
MOST_STATES = 150_000
"""States that one path is charged at."""
_AT_A_TIME = 20_000
"""States whose probabilities are in memory at a time."""
PACE_SPREAD = 0.42
"""Standard deviation of that share, relative to its mean."""


def search_paces(speed: float = 1.0) -> tuple[float, float]:
    """Return two paces that stand for the spread of velocities along a motion at a share of the velocity limits.

    With one alone, paths are found along which an object that flies on at just that velocity lands in a gap.
    """
    return speed * MEAN_PACE * (1.0 - PACE_SPREAD), speed * MEAN_PACE * (1.0 + PACE_SPREAD)


@final
@dataclass(frozen=True, kw_only=True)
class Objective:
    """What to minimise.

    Args:
        motion: Cost of moving, a density over length.
        impact: Cost of failing, a density over the exposure.
        w: Safety weight, at least 0; 0 is an ordinary planner. How many radians of joint motion it is worth to spare
            one second in which a failure would do harm of severity 1.
        exposure: What the impact is integrated over: "time" [s], of a trajectory as it is timed; or, to reproduce
            others, "length" [rad] and "waypoints", the paper's plain sum over vertices (of a trajectory, over its
            samples), start included.
    """

    motion: Cost = JointLength()
    impact: Cost = ImpactCost()
    w: float = DEFAULT_WEIGHT
    exposure: str = "time"

    def __post_init__(self) -> None:
        if not (is_real(self.w) and 0.0 <= self.w <= MAX_WEIGHT):
            raise SettingError("w", self.w, f"a number from 0 to {MAX_WEIGHT:g}")
        if self.exposure not in EXPOSURES:
            raise SettingError("exposure", self.exposure, f"one of {', '.join(EXPOSURES)}")
        for name, cost in (("motion", self.motion), ("impact", self.impact)):
            if not isinstance(cost, Cost):
                raise SettingError(name, cost, "a graceful_plan.Cost")

    def with_weight(self, w: float) -> Objective:
        """The same objective with another safety weight."""
        return replace(self, w=w)

    def bind(self, scene: Scene, paces: tuple[float, float] = AT_LIMITS) -> SceneObjective:
        """Make it ready to evaluate edges in a scene.

        Args:
            scene: The scene.
            paces: Shares of the velocity at which one joint is at its limit, by turns those of an edge's samples.
        """
        return SceneObjective(self, scene, paces)


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
@dataclass(frozen=True, eq=False)
class AmongMoving:
    """Native impact of states at times: of what stands still, and of entities that move, exactly and roughly."""

    still: ImpactKernel
    moving: _native.MovingImpact
    rough: _native.MovingImpact


@final
class SceneObjective:
    """An objective in a scene: what planners see (`BoundObjective`), and the breakdown of whole paths."""

    def __init__(self, objective: Objective, scene: Scene, paces: tuple[float, float] = AT_LIMITS) -> None:
        self.objective, self.scene, self.paces = objective, scene, paces
        self.kernels = compile_scene(scene).kernels

    @property
    def w(self) -> float:
        """Safety weight."""
        return self.objective.w

    @property
    def motion_is_length(self) -> bool:
        """Whether V is the joint-space length, so that distances bound J from below."""
        return self.objective.motion == JointLength()

    @property
    def pace(self) -> float:
        """Mean share of the velocity limits at which edges are travelled."""
        return 0.5 * sum(self.paces)

    @cached_property
    def kernel(self) -> ImpactKernel | None:
        """The native kernel that computes the edge costs, None if there is none."""
        exposure = self.objective.exposure
        if not self.motion_is_length or exposure == "waypoints":
            return None
        kernel = native_kernel(self.objective.impact, self.scene, self.paces)
        if kernel is None or exposure == "length":
            return kernel
        return kernel.timed(self.pace * self.scene.limits.velocity)

    @cached_property
    def among_moving(self) -> AmongMoving | None:
        """What motions are charged at their times where entities move; None if nothing moves or Python computes it."""
        impact = self.objective.impact
        if not (self.scene.moving and isinstance(impact, ImpactCost) and self.objective.exposure != "waypoints"):
            return None
        still = impact.still_kernel(self.scene, self.paces)
        if still is None:
            return None
        return AmongMoving(still, *(impact.moving_impact(self.scene, rough=rough) for rough in (False, True)))

    def states(self, q: Float[Array, "n nq"], qd: Float[Array, "n nq"] | None = None) -> Float[Array, " n"]:
        """Impact given a failure at each state, at rest without joint velocities [rad/s or m/s]."""
        if qd is None and self.kernel is not None:
            return self.kernel.states(q)
        return checked_state(self.objective.impact, moving_batch(self.scene, q, qd))

    def quick_states(self, q: Float[Array, "n nq"], qd: Float[Array, "n nq"]) -> Float[Array, " n"]:
        """Impact of states that move, by the kernel if there is one: close where somebody walks, else the same."""
        return self.states(q, qd) if self.kernel is None else self.kernel.moving_states(q, qd)

    def edges(self, q0: Float[Array, "n nq"], q1: Float[Array, "n nq"]) -> Float[Array, "n 2"]:
        """V and S of straight edges from `q0` to `q1`."""
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
        """`edges`, and the derivatives of V + w S of each edge with respect to `q0` and `q1`; see `ImpactKernel`.

        None without a native kernel that has derivatives, unless the costs have gradients of their own. An edge without
        length has none; they are given as 0.

        Args:
            q0: Where the edges begin.
            q1: Where they end.
            step: Largest distance between samples [rad]; `edges` takes `COST_STEP`.
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
        """`edges`, and the derivatives of S alone, for costs without a kernel: slopes of all states in one batch."""
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

        They are travelled as edges are; see `EdgeSamples`.
        """
        length = np.linalg.norm(tangent, axis=1, keepdims=True)
        at_limit = np.max(np.abs(tangent) / self.scene.limits.velocity, axis=1, keepdims=True)
        rate = np.divide(self.pace, at_limit, out=np.zeros_like(at_limit), where=at_limit > 0.0)
        value, d_q, d_qd = self.motion_slopes(q, rate * tangent)
        # Along the tangent nothing changes: the speed is what the slowest joint allows.
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
        """Return the objective in a form along which whole motions can descend; None if there is none.

        It is itself, and length alone where no impact counts. Where something moves, only native impacts know the times
        of a motion, or are close enough without them.
        """
        if self.w == 0.0 and self.motion_is_length:
            return Objective(impact=ImpactCost(model="aabb"), w=0.0).bind(self.scene, self.paces)
        native = self.kernel is not None and self.objective.exposure == "time"
        timed = self.among_moving is not None
        return self if native or timed or not self.scene.moving else None

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
        return None if wide is None else replace(self.objective, impact=wide).bind(self.scene, self.paces)

    def breakdown(self, path: Path | Trajectory, start_time: float = 0.0) -> CostBreakdown:
        """Cost of a whole path, or of a trajectory, with where its impact comes from; see `charged_states`."""
        motion, impact = self._motion(self._points(path)), self.objective.impact
        if isinstance(impact, ImpactCost) and not impact.hazards(self.scene):
            nothing = dict.fromkeys(self.scene.components, 0.0)
            return CostBreakdown(motion=motion, impact=0.0, w=self.w, impact_by_component=nothing)
        charged = self.charged_states(path, start_time)
        return self._breakdown(motion, charged.batch, charged.weight)

    def charged_states(self, path: Path | Trajectory, start_time: float = 0.0) -> ChargedStates:
        """Return the states at which a path, or a trajectory, is charged for its impact: sums over them are integrals.

        Only a trajectory's states have times, whatever the exposure: those of its samples plus `start_time` [s].

        Raises:
            ShapeError: If the path does not fit the scene.
            SettingError: If it has more than `MOST_STATES` states.
        """
        points = self._points(path)
        vertices = np.arange(len(points), dtype=np.float64)
        if self.objective.exposure == "waypoints":
            times = start_time + path.t if isinstance(path, Trajectory) else None
            return ChargedStates(StateBatch(self.scene, points.q, time=times), np.ones(len(points)), place=vertices)
        if isinstance(path, Trajectory):
            return _timed_states(self.scene, path, start_time, by_length=self.objective.exposure == "length")
        samples = self.samples(points.q[:-1], points.q[1:])
        measure = samples.length if self.objective.exposure == "length" else samples.duration
        batch = StateBatch(self.scene, samples.q, samples.direction, samples.speed)
        return ChargedStates(batch, samples.weights(measure), place=samples.place)

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
            expected = f"at most {MOST_STATES}, every {COST_STEP} rad: charge it in parts"
            raise SettingError("states of the path", int(min(states, 1e18)), expected)
        return points

    def samples(self, q0: Float[Array, "n nq"], q1: Float[Array, "n nq"], step: float = COST_STEP) -> EdgeSamples:
        """Return samples of straight edges, no farther apart than `step` [rad]."""
        return EdgeSamples(q0, q1, self.scene.limits.velocity, self.paces, step)

    def _breakdown(self, motion: float, batch: StateBatch, weight: Float[Array, " n"]) -> CostBreakdown:
        impact = self.objective.impact
        if not isinstance(impact, ImpactCost):
            total = float(weight @ checked_state(impact, batch))
            return CostBreakdown(motion=motion, impact=total, w=self.w)
        exposure = sum(
            np.tensordot(weight[k : k + _AT_A_TIME], impact.probability(batch[k : k + _AT_A_TIME]), axes=1)
            for k in range(0, len(batch), _AT_A_TIME)
        )
        parts = exposure * impact.hazard_severity(self.scene)
        return CostBreakdown(
            motion=motion,
            impact=float(parts.sum()),
            w=self.w,
            impact_by_entity=dict(zip(impact.hazards(self.scene), parts.sum(axis=0).tolist(), strict=True)),
            impact_by_component=dict(zip(self.scene.components, parts.sum(axis=1).tolist(), strict=True)),
        )


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

    def ahead() -> Float[Array, "n step nq"]:
        later = trajectory.positions((t[:, None] + AHEAD).ravel()).reshape(len(t), len(AHEAD), -1)
        _check_size(later)
        return later

    return StateBatch(scene, found.q, found.direction, found.speed, times, ahead)


def _check_size(*parts: Float[Array, "..."]) -> None:
    farthest = max(float(np.abs(part).max()) for part in parts)
    if farthest > FARTHEST:
        expected = f"positions and velocities of at most {FARTHEST:g}, between samples too"
        raise SettingError("trajectory", farthest, expected)


def _timed_states(scene: Scene, trajectory: Trajectory, start_time: float, *, by_length: bool) -> ChargedStates:
    """Return states no farther apart than `COST_STEP` at their own velocities, with trapezoid weights [s, or rad]."""
    pieces = np.maximum(1, np.ceil(trajectory.path.segment_lengths / COST_STEP)).astype(int)
    piece = np.repeat(np.arange(len(pieces)), pieces)
    first = np.cumsum(pieces) - pieces
    place = np.append(piece + (np.arange(len(piece)) - first[piece]) / pieces[piece], len(pieces))
    t = np.interp(place, np.arange(len(trajectory)), trajectory.t)
    done = np.append(0.0, np.cumsum(trajectory.path.segment_lengths))
    gaps = np.diff(np.interp(place, np.arange(len(trajectory)), done) if by_length else t)
    weight = np.zeros(len(t))
    weight[:-1] += 0.5 * gaps
    weight[1:] += 0.5 * gaps
    batch = trajectory_batch(scene, trajectory, t, start_time + t)
    _check_size(batch.q, batch.qd)
    return ChargedStates(batch, weight, place)


def evaluate(
    path: Path | Trajectory | Array,
    scene: Scene,
    objective: Objective | None = None,
    *,
    start_time: float = 0.0,
    speed: float = 1.0,
) -> CostBreakdown:
    """Compute the cost of any path, from any planner.

    Entities that move are met where they are at the times of a trajectory, whatever the exposure; a path without times
    meets them anywhere along their predicted paths.

    Args:
        path: A path, a trajectory, or an array of configurations [n, nq].
        scene: The scene, with what is carried attached.
        objective: What to compute; the default `Objective()` if None.
        start_time: What to add to a trajectory's times to have those of the scene's predictions [s].
        speed: In (0, 1]: at what fraction of the velocity limits a path without times is travelled.

    Raises:
        ShapeError: If the path does not fit the scene.
        CostError: If a cost breaks its contract.
        SettingError: If the start time is not finite, the speed not in its range, or the path so long that it has more
            than `MOST_STATES` states.
    """
    if not (is_real(start_time) and np.isfinite(start_time)):
        raise SettingError("start_time", start_time, "a finite time [s]")
    if not (is_real(speed) and 0.0 < speed <= 1.0):
        raise SettingError("speed", speed, "a fraction in (0, 1]")
    points = path if isinstance(path, Path | Trajectory) else Path(path)
    if not isinstance(objective, Objective | None):
        raise SettingError("objective", objective, "an Objective")
    return (objective or Objective()).bind(scene, (speed, speed)).breakdown(points, start_time)
