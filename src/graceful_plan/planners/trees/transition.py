"""The transition test of T-RRT, in its two published variants, and the refinement control.

"T-RRT" names two algorithms. Jaillet et al. accept an uphill step with a probability that falls with its slope, and
raise the temperature after a number of failures. Devaurs et al. accept deterministically and adapt it at every step.

References:
    [Jaillet2010] Sampling-based path planning on configuration-space costmaps. Differs in: the constant K is the
    range of the cost, not the mean at start and goal, which is 0 where the impact is local and changes with an
    added constant.
    [Devaurs2013] Enhancing the transition-based RRT to deal with complex cost spaces. Differs in: T0 is a multiple
    of the range of the cost, since 100 accepts all steps if costs are of order 1; the range is estimated once.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, log
from typing import Literal, final

import numpy as np

from graceful_plan.exceptions import SettingError
from graceful_plan.path import plain_numbers
from graceful_plan.planners.interruptible import InterruptibleProblem
from graceful_plan.setting_checks import count, positive_or_none

Variant = Literal["jaillet", "devaurs"]

_PROBES = 100
_LOG_LIMIT = log(1e12)
_NEGLIGIBLE = 1e-4  # climbs below this share of the range are accepted without heating or cooling [Devaurs2013]


@final
@dataclass(frozen=True, kw_only=True)
class TransitionSettings:
    """Constants of the transition test."""

    variant: Variant = "jaillet"
    """Published variant of the test."""
    initial_temperature: float | None = None
    """T0 as a multiple of the range of the cost; by default 1e-6 (jaillet), 0.1 (devaurs)."""
    temperature_factor: float = 2.0
    """jaillet: T is divided by this factor after an accepted climb, and multiplied by it after too many failures."""
    most_failures: int = 10
    """jaillet: number of failures before T rises; 10 is greedy, 100 is slow and finds paths of lower peak cost."""
    temperature_rate: float = 0.1
    """devaurs: T grows by exp(rate) with each rejection."""

    def __post_init__(self) -> None:
        plain_numbers(self)
        if self.variant not in ("jaillet", "devaurs"):
            raise SettingError("variant", self.variant, "'jaillet' or 'devaurs'")
        positive_or_none("initial_temperature", self.initial_temperature)
        positive_or_none("temperature_rate", self.temperature_rate)
        count("most_failures", self.most_failures, 0)
        if not 1.0 < self.temperature_factor < np.inf:
            raise SettingError("temperature_factor", self.temperature_factor, "a finite number > 1")


@final
class TransitionTest:
    """Accepts or rejects steps by their increase of the state cost. Temperatures stay within [1e-12, 1e12].

    Args:
        settings: Variant and constants.
        cost_range: Difference between high and low state costs; with 0, all steps are accepted.
        rng: Random numbers of the probabilistic variant.
    """

    def __init__(self, settings: TransitionSettings, cost_range: float, rng: np.random.Generator) -> None:
        self._settings, self._range, self._rng = settings, cost_range, rng
        default = 1e-6 if settings.variant == "jaillet" else 0.1
        self._log_t = log(settings.initial_temperature or default)
        self._failures = 0

    @property
    def temperature(self) -> float:
        """Current temperature, as a multiple of the range of the cost."""
        return exp(self._log_t)

    def accepts(self, cost_from: float, cost_to: float, distance: float) -> bool:
        """Return whether to accept a step of `distance` [rad] between two state costs, and adapt the temperature."""
        climb = cost_to - cost_from
        if climb <= 0.0 or self._range <= 0.0:
            return True
        if self._settings.variant == "jaillet":
            return self._jaillet(climb / self._range / distance)
        return self._devaurs(climb / self._range)

    def _jaillet(self, slope: float) -> bool:
        # exp may underflow to 0; the exponent is finite since T is bounded
        if self._rng.uniform() < exp(-slope / self.temperature):
            self._heat(-log(self._settings.temperature_factor))
            self._failures = 0
            return True
        if self._failures > self._settings.most_failures:
            self._heat(log(self._settings.temperature_factor))
            self._failures = 0
        else:
            self._failures += 1
        return False

    def _devaurs(self, climb: float) -> bool:
        if climb < _NEGLIGIBLE:
            return True
        if exp(-climb / self.temperature) > 0.5:
            self._heat(-climb / self._settings.temperature_rate)
            return True
        self._heat(self._settings.temperature_rate)
        return False

    def _heat(self, log_factor: float) -> None:
        self._log_t = min(_LOG_LIMIT, max(-_LOG_LIMIT, self._log_t + log_factor))


@final
class RefinementControl:
    """Refinement control: limits short steps, so that a tree does not only become denser where it already is.

    Args:
        ratio: Largest number of refining nodes per exploring node; infinite turns the control off.
        reach: Length below which a step counts as refining [rad].
    """

    def __init__(self, ratio: float, reach: float) -> None:
        self._ratio, self._reach = ratio, reach * (1.0 - 1e-9)
        self._refining, self._exploring = 0, 1

    def allows(self, distance: float) -> bool:
        """Return whether a step of this length may be added."""
        return distance >= self._reach or self._refining < self._ratio * self._exploring

    def added(self, distance: float) -> None:
        """Count a step that was added."""
        if distance >= self._reach:
            self._exploring += 1
        else:
            self._refining += 1


def estimate_cost_range(questions: InterruptibleProblem, rng: np.random.Generator) -> float:
    """Return the difference between the highest and the lowest cost of start, goals and random configurations."""
    problem = questions.problem
    random = rng.uniform(problem.lower, problem.upper, (_PROBES, len(problem.start)))
    costs = questions.state_costs(np.concatenate([problem.start[None], problem.goals, random]))
    return float(np.ptp(costs))
