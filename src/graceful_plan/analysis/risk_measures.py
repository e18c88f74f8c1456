r"""Risk: the distribution of the impact of a failure, and measures of its tail.

Given that the robot fails once, at a moment uniform over a motion, the impact is a random variable: the sum over
components and entities of the severities of the harm done. `risk` computes its distribution from an interaction model:

* The failure is of one kind (the gripper lets go, a motor dies): `InteractionModel.sources`, weighted by
  `fault_shares`. A model without weights has a single kind, whose sources are mutually exclusive.
* Given the state and the kind, entities are hit independently of one another. That is an assumption: an object that
  breaks the first glass may well break the next, or be stopped by it.
* Severities of several components that hit one entity add up, as in the planner's impact, which therefore is the mean
  of this distribution. Components with a common cause strike together, as a mug falls with its coffee:

  .. math:: P(L_e \ge s) = \max_{C:\ \sum_{c \in C} S_{ce} \ge s} \ \min_{c \in C} P_{ce}

* The impact at a state is the sum over entities, by convolution, mixed over kinds. The impact of the motion is the
  mixture over its states.

The distribution is exact for the evaluated states if there are few distinct sums of severities. Otherwise it is on a
grid: a value between two grid points is split between them, which keeps the mean and can only increase the spread.

CVaR at a level (say 0.9) is the mean over the worst 1 - level (a tenth) of failures; VaR is the least value that a
share `level` of failures does not exceed. Some authors call 1 - level the level.

References:
    R. T. Rockafellar, S. Uryasev, "Optimization of conditional value-at-risk", Journal of Risk 2 (2000).
"""

from __future__ import annotations

import numbers
from dataclasses import dataclass
from functools import cached_property
from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.analysis.harm_law import HarmLaw
from graceful_plan.array_types import Array, Float
from graceful_plan.core.kernels import COST_STEP
from graceful_plan.costs.cost import StateBatch
from graceful_plan.costs.cost_samples import trajectory_batch
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.objective import Objective
from graceful_plan.documents import table
from graceful_plan.exceptions import SettingError, UnknownNameError
from graceful_plan.path import Path, finite_array, plain_numbers, real_array
from graceful_plan.scene.scene import Scene
from graceful_plan.setting_checks import finite, positive_fraction
from graceful_plan.timing.trajectory import Trajectory

NEGLIGIBLE = 1e-3
"""Probability, given a failure, up to which an impact is ignored for the worst case."""
MEASURES = ("expectation", "cvar", "worst")
"""Names of the risk measures."""
_MOMENTS = (100, 4000)
"""Least and greatest number of sampled failure times of a trajectory."""


@final
@dataclass(frozen=True)
class RiskMeasure:
    """A risk measure: one number for a distribution of impact.

    Args:
        kind: "expectation"; "cvar", the mean of the worst 1 - level; or "worst", the greatest impact that is reached or
            exceeded with a probability of more than `NEGLIGIBLE`.
        level: Level of "cvar", in [0, 1); 0 gives the expectation.

    Raises:
        UnknownNameError: If there is no such measure.
        SettingError: If the level is out of range.
    """

    kind: str = "cvar"
    level: float = 0.9

    def __post_init__(self) -> None:
        plain_numbers(self)
        if self.kind not in MEASURES:
            raise UnknownNameError("risk measure", str(self.kind), MEASURES)
        check_level(self.level)

    def of(self, value: Float[Array, " atom"], probability: Float[Array, "*batch atom"]) -> Float[Array, "*batch"]:
        """Evaluate distributions over common increasing values; the probabilities of each sum to 1."""
        if self.kind == "expectation":
            return np.asarray(probability @ value)
        if self.kind == "worst":
            reached = np.cumsum(probability[..., ::-1], axis=-1)[..., ::-1] > NEGLIGIBLE
            return np.asarray(value[len(value) - 1 - np.argmax(reached[..., ::-1], axis=-1)])
        return conditional_value_at_risk(value, probability, self.level)


def conditional_value_at_risk(
    value: Float[Array, " atom"], probability: Float[Array, "*batch atom"], level: float
) -> Float[Array, "*batch"]:
    """Return the mean of the worst 1 - level of distributions over common increasing values."""
    tail = 1.0 - level
    above = np.minimum(np.cumsum(probability[..., ::-1], axis=-1), tail)
    above[..., -1] = tail  # the rounding error goes to the least value
    return np.asarray(np.diff(above, axis=-1, prepend=0.0) @ value[::-1] / tail)


@final
@dataclass(frozen=True, eq=False)
class Risk:
    """The distribution of the impact, given a failure.

    Args:
        value: Possible impacts, increasing from 0.
        probability: Probability of each value, given a failure; they sum to 1.
        level: Level of `var` and `cvar`, in [0, 1).
        conceivable: Greatest impact that the model does not rule out, however unlikely.
        exact: Whether the distribution is exact rather than on a grid.
    """

    value: Float[Array, " atom"]
    probability: Float[Array, " atom"]
    level: float
    conceivable: float
    exact: bool

    @cached_property
    def expected(self) -> float:
        """Mean impact, which is the planner's impact."""
        return float(self.value @ self.probability)

    @cached_property
    def var(self) -> float:
        """Value at risk: the least value that a share `level` of failures does not exceed."""
        index = int(np.searchsorted(np.cumsum(self.probability), self.level - 1e-12))
        return float(self.value[min(index, len(self.value) - 1)])

    @cached_property
    def cvar(self) -> float:
        """Mean impact of the worst 1 - level of failures."""
        return float(conditional_value_at_risk(self.value, self.probability, self.level))

    @cached_property
    def worst(self) -> float:
        """Greatest impact that is reached or exceeded with a probability of more than `NEGLIGIBLE`."""
        return min(float(RiskMeasure("worst").of(self.value, self.probability)), self.conceivable)

    @cached_property
    def no_harm(self) -> float:
        """Probability that a failure does no harm."""
        return float(self.probability[0])

    def exceeding(self, impact: float | ArrayLike) -> Float[Array, "*batch"]:
        """Compute the probability that the impact of a failure exceeds `impact`.

        Raises:
            SettingError: If it is NaN.
        """
        limit = real_array("impact", impact)
        if np.any(np.isnan(limit)):
            raise SettingError("impact", impact, "numbers")
        at_most = np.append(0.0, np.cumsum(self.probability))
        return np.asarray(np.clip(1.0 - at_most[np.searchsorted(self.value, limit, side="right")], 0.0, 1.0))

    def __str__(self) -> str:
        tail = f"{100.0 * (1.0 - self.level):.3g} %"
        rows: list[list[object]] = [
            ["expected impact of a failure", self.expected],
            [f"VaR {self.level:g}: exceeded by at most {tail}", self.var],
            [f"CVaR {self.level:g}: mean of the worst {tail}", self.cvar],
            [f"worst case of probability above {NEGLIGIBLE:g}", self.worst],
            ["worst conceivable", self.conceivable],
            ["probability of no harm", self.no_harm],
        ]
        return table(["", "value"], rows)

    def to_document(self) -> dict[str, Any]:
        """Return everything as a JSON document."""
        numbers = ("level", "expected", "var", "cvar", "worst", "conceivable", "no_harm", "exact")
        return {
            "schema": "graceful_plan.risk",
            "version": 1,
            **{name: getattr(self, name) for name in numbers},
            "distribution": {"impact": self.value.tolist(), "probability": self.probability.tolist()},
        }


def risk(
    motion: Trajectory | Path | ArrayLike,
    scene: Scene,
    impact: ImpactCost | None = None,
    *,
    level: float = 0.9,
    speed: float = 1.0,
    start_time: float = 0.0,
) -> Risk:
    """Compute the distribution of impact, given that the robot fails once along a motion.

    Args:
        motion: A trajectory, which fails at a time uniform over its duration, with the velocity at that time. Or a path
            or configurations [n, nq], which fail at a moment uniform over the time that the path will take.
        scene: The scene, with the carried object attached.
        impact: Interaction model and components; those of the default `Objective()` if None.
        level: Level of VaR and CVaR, in [0, 1): 0.9 is for the worst tenth.
        speed: Fraction of the velocity limits at which a path is travelled, in (0, 1]; see `evaluate`.
        start_time: Offset from a trajectory's times to the clock of the moving entities [s]; see `evaluate`.

    Raises:
        ShapeError: If the motion does not fit the scene.
        SettingError: If a setting is invalid, or `impact` has no interaction model.
    """
    check_level(level)
    finite("start_time", start_time, "a finite time [s]")
    positive_fraction("speed", speed, "a fraction in (0, 1]")
    cost = Objective().impact if impact is None else impact
    law = HarmLaw(cost, scene)
    objective = Objective(impact=cost).bind(scene, (speed, speed))
    points = motion if isinstance(motion, Path | Trajectory) else Path(finite_array("motion", motion, ndim=2))
    samples = objective.cost_samples(points)  # also rejects motions that do not fit the scene
    if isinstance(points, Trajectory):
        batch, weight = _moments(points, scene, start_time)
    elif samples.weight.sum() > 0.0:
        batch, weight = samples.batch, samples.weight
    else:  # a path without length
        batch, weight = StateBatch(scene, points.q[:1]), np.ones(1)
    mass, worst = law.mixture(batch, weight)
    kept = (mass > 0.0) | (law.value == 0.0)
    probability = mass[kept] / mass.sum()
    return Risk(law.value[kept], probability, level, float(worst.sum()), law.exact)


def check_level(level: object) -> None:
    """Raise SettingError unless `level` is a number in [0, 1)."""
    real = isinstance(level, numbers.Real) and not isinstance(level, bool)
    if not (real and 0.0 <= level < 1.0):  # type: ignore[operator]
        raise SettingError("level", level, "a share in [0, 1), such as 0.9 for the worst tenth")


def _moments(trajectory: Trajectory, scene: Scene, start_time: float) -> tuple[StateBatch, Float[Array, " n"]]:
    """Return states at the midpoints of equal time steps."""
    least, most = _MOMENTS
    n = int(np.clip(np.ceil(trajectory.path.length / COST_STEP), least, most))
    times = trajectory.t[0] + (np.arange(n) + 0.5) / n * trajectory.duration
    return trajectory_batch(scene, trajectory, times, start_time + times), np.full(n, 1.0 / n)
