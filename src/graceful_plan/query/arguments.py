"""Early checks of the arguments of `plan`."""

from __future__ import annotations

import numbers
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from graceful_plan.analysis.risk_measures import MEASURES, RiskMeasure
from graceful_plan.costs.objective import Objective
from graceful_plan.exceptions import SettingError, UnknownNameError, UnsupportedError
from graceful_plan.judge.verification import VerificationSettings
from graceful_plan.path import is_real, is_whole
from graceful_plan.planners import PLANNERS, Auto, Planner
from graceful_plan.query.base_planning import base_planning, planners_by_name
from graceful_plan.query.candidates.search import Callback
from graceful_plan.query.request import STOPS, Stop
from graceful_plan.scene.scene import Scene
from graceful_plan.setting_checks import not_negative, positive_fraction

DEFAULT_TIME_LIMIT = 1.0
"""Time limit of a call without a time limit and without a number of iterations [s]."""

MOST_OUTSIDE = 0.1
"""Largest tolerance of a start [rad or m]: a joint that is farther out has been moved there by force."""

MOST_CANDIDATES = 64
"""Largest number of distinct motions that a call returns: each one is verified within the time limit."""


def checked_planner(planner: object) -> Planner:
    """Return a planner; strings are looked up by name."""
    if isinstance(planner, Planner):
        return planner
    if isinstance(planner, type) and issubclass(planner, Planner):
        raise SettingError("planner", planner.__name__, f"an instance: {planner.__name__}()")
    if not isinstance(planner, str):
        raise SettingError("planner", planner, "a name or a Planner")
    if planner in PLANNERS:
        return PLANNERS[planner]()
    known = planners_by_name()
    if planner not in known:
        raise UnknownNameError("planner", planner, {**PLANNERS, **known})
    return known[planner]()


def driving_planner(planner: Planner, scene: Scene) -> Planner:
    """Return the planner to use: for a robot with a mobile base, the default planner is replaced by one for bases.

    Raises:
        SettingError: If the robot has a base and the planner is for arms, or the other way round.
        UnsupportedError: If the robot has a base, and `graceful_plan.mobile` is not installed.
    """
    driving = base_planning(scene)
    if planner.drives and driving is None:
        raise SettingError("planner", planner.name, "a planner for arms: this robot has no DiffDrive")
    if driving is None or planner.drives:
        return planner
    if planner != Auto():
        names = ", ".join(sorted(driving.planners))
        raise SettingError("planner", planner.name, f"'auto' or a planner for mobile bases: {names}")
    return driving.default_planner()


def check_no_base(scene: Scene, what: str) -> None:
    """Refuse robots with a mobile base, for functions that do not model how a base moves.

    Raises:
        UnsupportedError: If the robot has a base.
    """
    if scene.base is not None:
        raise UnsupportedError(f"{what} does not support mobile bases; plan() does")


def checked_speed(speed: object) -> float:
    """Return the fraction of the velocity limits to use."""
    return positive_fraction("speed", speed, "a fraction in (0, 1]")


def checked_risk(risk: object) -> RiskMeasure:
    """Return a risk measure; strings are looked up by name."""
    if isinstance(risk, RiskMeasure):
        return risk
    if not isinstance(risk, str):
        raise SettingError("risk", risk, f"a RiskMeasure or one of {', '.join(MEASURES)}")
    return RiskMeasure(risk)


def checked_objective(objective: object, w: object) -> Objective:
    """Return the objective to minimise, with the weight `w` unless that is None."""
    if w is not None and not is_real(w):
        raise SettingError("w", w, "a finite number, at least 0")
    if objective is None:
        return Objective() if w is None else Objective(w=float(w))  # type: ignore[arg-type]
    if not isinstance(objective, Objective):
        raise SettingError("objective", objective, "an Objective, such as Objective(motion=..., impact=...)")
    return objective if w is None else objective.with_weight(float(w))  # type: ignore[arg-type]


def checked_stop(stop: object, *, limited: bool) -> Stop:
    """Return the condition that ends a call; by default the limits, if any is given, else convergence."""
    if stop is None:
        return "time_limit" if limited else "converged"
    if stop not in STOPS:
        raise UnknownNameError("stop", str(stop), STOPS)
    return stop  # type: ignore[return-value]


def checked_flag(name: str, value: object) -> bool:
    """Return a setting that is True or False."""
    if not isinstance(value, bool | np.bool_):
        raise SettingError(name, value, "True or False")
    return bool(value)


def checked_start_tolerance(tolerance: object) -> float:
    """Return the distance outside of its limits at which a joint may start [rad or m]."""
    if not (is_real(tolerance) and 0.0 <= tolerance <= MOST_OUTSIDE):
        raise SettingError("start_tolerance", tolerance, f"from 0 to {MOST_OUTSIDE:g} rad or m")
    return float(tolerance)


def checked_wait(max_wait: object, scene: Scene) -> float:
    """Return the longest wait before the motion [s]; it must be 0 in a scene without moving entities."""
    wait = not_negative("max_wait", max_wait, "a finite time of at least 0 s")
    if wait > 0.0 and not scene.moving:
        raise SettingError("max_wait", max_wait, "0 in a scene where nothing moves; see Scene.with_moving")
    return wait


def checked_verification(verification: object) -> VerificationSettings | None:
    """Return the resolution of the judge; None for its default."""
    if verification is not None and not isinstance(verification, VerificationSettings):
        raise SettingError("verification", verification, "settings such as VerificationSettings(step=0.001)")
    return verification


def checked_candidates(candidates: object, *, via: bool) -> int:
    """Return the largest number of distinct motions to return."""
    if not (is_whole(candidates) and 1 <= candidates <= MOST_CANDIDATES):
        raise SettingError("candidates", candidates, f"a whole number from 1 to {MOST_CANDIDATES}")
    if via and candidates > 1:
        raise SettingError("candidates", candidates, "1 with `via`")
    return int(candidates)


def checked_seed(seed: object) -> np.random.Generator:
    """Return the random number generator of a call."""
    if isinstance(seed, bool) or not isinstance(seed, numbers.Integral) or int(seed) < 0:
        raise SettingError("seed", seed, "a whole number, at least 0")
    return np.random.default_rng(int(seed))


@dataclass
class Cancelled:
    """The caller's test for cancellation; it is not called again once it has returned True."""

    ask: Callable[[], object]
    said: bool = False

    def __call__(self) -> bool:
        """Return whether the call is cancelled."""
        self.said = self.said or bool(self.ask())
        return self.said


def checked_cancelled(cancelled: object) -> Cancelled:
    """Return the test for cancellation; without a function it is never cancelled."""
    if cancelled is None:
        return Cancelled(lambda: False)
    if not callable(cancelled):
        raise SettingError("cancelled", cancelled, "a function without arguments, such as threading.Event().is_set")
    return Cancelled(cancelled)


def checked_callback(callback: Callback | None) -> Callback | None:
    """Return the callback for improvements, if there is one."""
    if callback is not None and not callable(callback):
        raise SettingError("callback", callback, "a function of one argument, the improvement")
    return callback


def checked_time_limit(time_limit: object, iterations: object) -> float:
    """Return the time limit of the call [s]; infinite if only iterations limit it."""
    whole = isinstance(iterations, numbers.Integral) and not isinstance(iterations, bool)
    if iterations is not None and not (whole and 0 <= int(iterations) < 2**63):  # type: ignore[call-overload]
        raise SettingError("iterations", iterations, "a whole number from 0 to 2**63 - 1")
    if time_limit is not None and not (is_real(time_limit) and time_limit >= 0.0):
        raise SettingError("time_limit", time_limit, "a number of seconds, at least 0")
    if time_limit is None:
        return DEFAULT_TIME_LIMIT if iterations is None else np.inf
    return float(time_limit)  # type: ignore[arg-type]
