r"""Direct collocation of optimal control problems: trapezoid and Hermite-Simpson, solved by IPOPT.

.. math:: \min \int_0^T L(x, u)\, dt \qquad \dot x = f(x, u), \quad x(0), x(T), \text{ limits of } x, u, T

States and controls at evenly spaced times are the variables. The trapezoid rule takes controls to be linear and states
quadratic in between, with an error of h^2; Hermite-Simpson, with a control at each middle, quadratic and cubic, h^4.
Dynamics and cost are written in CasADi. A robot's own trajectories are optimised by `optimise_trajectory`.

References:
    [Kelly2017] An introduction to trajectory optimization, SIAM Review 59(4), Eqs. 3.6 (trapezoid), 4.8 to 4.10.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Float
from graceful_plan.exceptions import SettingError, UnknownNameError
from graceful_plan.path import finite_array
from graceful_plan.planners.optimisers.nlp import Outcome, outcome_of

Array = np.ndarray
Expression = Any
"""A CasADi SX; CasADi comes without types and is imported on demand."""

METHODS = ("hermite_simpson", "trapezoid")


@dataclass(frozen=True, kw_only=True, eq=False)
class ControlProblem:
    """What is to be controlled, from where to where, at what cost.

    Args:
        dynamics: Derivative of the state with respect to time, a CasADi column, of columns x and u.
        cost: What a second costs, of the same; 1 for the least time.
        start: State at the beginning.
        end: State at the end; NaN where it is free.
        least_control: Lower limits of the controls, -inf for none.
        most_control: Upper limits of the controls.
        duration: Time from start to end [s], or the least and the greatest.
        least_state: Lower limits of the state, none by default.
        most_state: Upper limits of the state.
    """

    dynamics: Callable[[Expression, Expression], Expression]
    cost: Callable[[Expression, Expression], Expression]
    start: Float[Array, " state"]
    end: Float[Array, " state"]
    least_control: Float[Array, " control"]
    most_control: Float[Array, " control"]
    duration: float | tuple[float, float]
    least_state: Float[Array, " state"] | None = None
    most_state: Float[Array, " state"] | None = None

    def __post_init__(self) -> None:
        start = finite_array("start", self.start, ndim=1)
        object.__setattr__(self, "start", start)
        for name, n in (("end", len(start)), ("least_control", None), ("most_control", None)):
            value = np.asarray(getattr(self, name), dtype=np.float64)
            if value.ndim != 1 or (n is not None and len(value) != n):
                raise SettingError(name, getattr(self, name), "a vector" if n is None else f"{n} numbers")
            object.__setattr__(self, name, value)
        if not np.all(self.least_control <= self.most_control):
            raise SettingError("least_control", self.least_control, f"at most most_control = {self.most_control}")
        for name, none in (("least_state", -np.inf), ("most_state", np.inf)):
            given = getattr(self, name)
            value = np.full(len(start), none) if given is None else np.asarray(given, dtype=np.float64)
            if value.shape != start.shape:
                raise SettingError(name, given, f"{len(start)} numbers")
            object.__setattr__(self, name, value)
        shortest, longest = self.durations
        if not 0.0 < shortest <= longest < np.inf:
            raise SettingError("duration", self.duration, "a finite time > 0 s, or the least and the greatest")

    @property
    def durations(self) -> tuple[float, float]:
        """Least and greatest duration [s]."""
        return self.duration if isinstance(self.duration, tuple) else (float(self.duration), float(self.duration))


@dataclass(frozen=True, kw_only=True, eq=False)
class ControlResult:
    """States and controls that were found.

    | field   | meaning                                                                | unit | shape         |
    |---------|------------------------------------------------------------------------|------|---------------|
    | outcome | how the solve ended                                                    |      |               |
    | t       | times of the nodes                                                     | s    | node          |
    | x       | states at the nodes                                                    |      | node state    |
    | u       | controls at the nodes                                                  |      | node control  |
    | middle  | controls halfway between them; by the trapezoid rule, the means        |      | piece control |
    | cost    | integral of the cost, by the rule that was used                        |      |               |
    | defect  | how far the rule's equations are from being met, at most               |      |               |
    """

    outcome: Outcome
    t: Float[Array, " node"]
    x: Float[Array, "node state"]
    u: Float[Array, "node control"]
    middle: Float[Array, "piece control"]
    cost: float
    defect: float

    def control(self, t: float | ArrayLike) -> Float[Array, "*time control"]:
        """Control at times [s]: the parabola through both nodes and the middle of each piece."""
        times = np.clip(finite_array("t", np.asarray(t)), self.t[0], self.t[-1])
        i = np.clip(np.searchsorted(self.t, times, side="right") - 1, 0, len(self.t) - 2)
        s = ((times - self.t[i]) / (self.t[i + 1] - self.t[i]))[..., None]
        first, middle, last = self.u[i], self.middle[i], self.u[i + 1]
        return first * (1.0 - s) * (1.0 - 2.0 * s) + middle * 4.0 * s * (1.0 - s) + last * s * (2.0 * s - 1.0)


def collocate(
    problem: ControlProblem,
    intervals: int,
    method: str = "hermite_simpson",
    *,
    guess: tuple[ArrayLike, ArrayLike, float] | None = None,
    iterations: int = 500,
    tolerance: float = 1e-10,
) -> ControlResult:
    """Solve a control problem on evenly spaced nodes.

    Args:
        problem: What to solve.
        intervals: Pieces that the time is divided into.
        method: "hermite_simpson" or "trapezoid".
        guess: States and controls at the nodes and the duration [s] to begin with; by default straight from start to
            end, without control, halfway between the least and the greatest duration.
        iterations: Of IPOPT, at most.
        tolerance: IPOPT's `tol`.

    Raises:
        UnknownNameError: If there is no such method.
        SettingError: If a setting is outside of its range.
    """
    import casadi

    if method not in METHODS:
        raise UnknownNameError("method", method, METHODS)
    if isinstance(intervals, bool) or not isinstance(intervals, int) or intervals < 1:
        raise SettingError("intervals", intervals, "an integer >= 1")
    nx, nu = len(problem.start), len(problem.least_control)
    x, u = casadi.SX.sym("x", nx, intervals + 1), casadi.SX.sym("u", nu, intervals + 1)
    inner = intervals if method == "hermite_simpson" else 0
    middle, duration = casadi.SX.sym("m", nu, inner), casadi.SX.sym("T")
    cost, defects = _transcribed(problem, x, u, middle, duration)
    variables = [casadi.vec(x), casadi.vec(u), casadi.vec(middle), duration]
    lower, upper = _bounds(problem, intervals, inner)
    options = {
        "print_time": False,
        "show_eval_warnings": False,
        "ipopt": {"print_level": 0, "sb": "yes", "max_iter": iterations, "tol": tolerance, "bound_relax_factor": 0.0},
    }
    program = {"x": casadi.vertcat(*variables), "f": cost, "g": defects}
    solver = casadi.nlpsol("collocation", "ipopt", program, options)
    found = solver(x0=_first(problem, intervals, inner, guess), lbx=lower, ubx=upper, lbg=0.0, ubg=0.0)
    split = np.cumsum([nx * (intervals + 1), nu * (intervals + 1), nu * inner])
    states, controls, halves, time = np.split(np.asarray(found["x"]).ravel(), split)
    u_found = controls.reshape(-1, nu)
    return ControlResult(
        outcome=outcome_of(str(solver.stats()["return_status"])),
        t=np.linspace(0.0, float(time[0]), intervals + 1),
        x=states.reshape(-1, nx),
        u=u_found,
        middle=halves.reshape(-1, nu) if inner else 0.5 * (u_found[:-1] + u_found[1:]),
        cost=float(found["f"]),
        defect=float(np.abs(np.asarray(found["g"])).max(initial=0.0)),
    )


def _transcribed(
    problem: ControlProblem, x: Expression, u: Expression, middle: Expression, duration: Expression
) -> tuple[Expression, Expression]:
    """Return the integral of the cost, and what has to be zero for the dynamics to hold."""
    import casadi

    n = x.shape[1] - 1
    h = duration / n
    slopes = [problem.dynamics(x[:, k], u[:, k]) for k in range(n + 1)]
    costs = [problem.cost(x[:, k], u[:, k]) for k in range(n + 1)]
    total, defects = casadi.SX(0), []
    for k in range(n):
        step, ends = x[:, k + 1] - x[:, k], slopes[k] + slopes[k + 1]
        if middle.shape[1] == 0:
            total += h / 2.0 * (costs[k] + costs[k + 1])
            defects.append(step - h / 2.0 * ends)
        else:
            x_m = (x[:, k] + x[:, k + 1]) / 2.0 + h / 8.0 * (slopes[k] - slopes[k + 1])
            total += h / 6.0 * (costs[k] + 4.0 * problem.cost(x_m, middle[:, k]) + costs[k + 1])
            defects.append(step - h / 6.0 * (ends + 4.0 * problem.dynamics(x_m, middle[:, k])))
    return total, casadi.vertcat(*defects)


def _bounds(problem: ControlProblem, intervals: int, inner: int) -> tuple[Array, Array]:
    free = np.isnan(problem.end)
    found = []
    for states, controls, duration in (
        (problem.least_state, problem.least_control, problem.durations[0]),
        (problem.most_state, problem.most_control, problem.durations[1]),
    ):
        assert states is not None
        last = np.where(free, states, problem.end)
        nodes = np.concatenate([problem.start[None], np.tile(states, (intervals - 1, 1)), last[None]])
        found.append(np.concatenate([nodes.ravel(), np.tile(controls, intervals + 1 + inner), [duration]]))
    return found[0], found[1]


def _first(problem: ControlProblem, intervals: int, inner: int, guess: Any) -> Array:
    nu, share = len(problem.least_control), np.linspace(0.0, 1.0, intervals + 1)[:, None]
    if guess is None:
        end = np.where(np.isnan(problem.end), problem.start, problem.end)
        rest = np.clip(0.0, problem.least_control, problem.most_control)
        guess = (
            (1.0 - share) * problem.start + share * end,
            np.tile(rest, (intervals + 1, 1)),
            np.mean(problem.durations),
        )
    states = finite_array("guess states", guess[0], ndim=2, last=len(problem.start))
    controls = finite_array("guess controls", guess[1], ndim=2, last=nu)
    if len(states) != intervals + 1 or len(controls) != intervals + 1:
        raise SettingError("guess", (len(states), len(controls)), f"{intervals + 1} states and controls")
    halves = 0.5 * (controls[:-1] + controls[1:])[:inner]
    return np.concatenate([states.ravel(), controls.ravel(), halves.ravel(), [float(guess[2])]])
