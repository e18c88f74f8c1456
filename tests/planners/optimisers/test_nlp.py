"""Nonlinear programs: derivatives reach IPOPT in the right places, and exceptions of callbacks are raised."""

from __future__ import annotations

import signal
from typing import Any

import numpy as np
import pytest

from graceful_plan.planners.optimisers import nlp
from graceful_plan.planners.optimisers.nlp import Pattern, Program, SolveOutcome, Values, minimise

Array = np.ndarray


class Quartic(Program):
    """Minimise the sum of (x - 1)^4 with |x|^2 within bounds; the Jacobian's entries are listed in reverse order."""

    def __init__(self, n: int, most: float, curved: bool, least: float = -np.inf) -> None:
        self.lower, self.upper = np.full(n, -np.inf), np.full(n, np.inf)
        self.least, self.most = np.array([least]), np.array([most])
        self.jacobian_pattern = Pattern(np.zeros(n, dtype=int), np.arange(n)[::-1])
        self.hessian_pattern = Pattern(np.arange(n), np.arange(n)) if curved else None
        self.asked = 0

    def evaluate(self, x: Array) -> Values:
        self.asked += 1
        return Values(float(((x - 1.0) ** 4).sum()), 4.0 * (x - 1.0) ** 3, np.array([x @ x]), 2.0 * x[::-1])

    def hessian(self, x: Array, factor: float, multipliers: Array) -> Array:
        return factor * 12.0 * (x - 1.0) ** 2 + 2.0 * multipliers[0]


class Raising(Quartic):
    def evaluate(self, x: Array) -> Values:
        if x @ x > 0.5:
            raise KeyError("inside")
        return super().evaluate(x)


@pytest.mark.parametrize("curved", [True, False])
def test_constrained_optimum(curved: bool) -> None:
    solution = minimise(Quartic(20, 5.0, curved), np.linspace(0.0, 0.3, 20))
    assert solution.outcome is SolveOutcome.SOLVED
    np.testing.assert_allclose(solution.x, np.full(20, 0.5), atol=1e-5)


def test_every_point_is_evaluated_once() -> None:
    program = Quartic(5, 1.0, curved=True)
    seen = []
    solution = minimise(program, np.zeros(5), lambda x, values: seen.append(x.tobytes()) is not None)
    assert len(seen) == solution.iterations + 1 == len(set(seen))
    assert program.asked <= 2 * len(seen)


def test_watch_ends_a_solve() -> None:
    costs: list[float] = []

    def watch(x: Array, values: Values) -> bool:
        costs.append(values.cost)
        return values.cost < 4.0

    solution = minimise(Quartic(8, 6.0, curved=True), np.zeros(8), watch)
    assert solution.outcome is SolveOutcome.STOPPED
    assert costs[-1] < 4.0 <= min(costs[:-1])
    assert ((solution.x - 1.0) ** 4).sum() == pytest.approx(costs[-1])


def test_iterations_end_a_solve() -> None:
    solution = minimise(Quartic(8, 6.0, curved=False), np.zeros(8), iterations=2)
    assert (solution.outcome, solution.iterations) == (SolveOutcome.STOPPED, 2)


def test_contradictory_bounds_are_infeasible() -> None:
    assert minimise(Quartic(3, -0.5, curved=True, least=-1.0), np.ones(3)).outcome is SolveOutcome.INFEASIBLE


@pytest.mark.parametrize("curved", [True, False])
def test_exceptions_are_raised_without_output(curved: bool, capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(KeyError, match="inside"):
        minimise(Raising(3, 10.0, curved), np.zeros(3))
    assert capfd.readouterr() == ("", "")


def test_interrupts_are_raised() -> None:
    def watch(x: Array, values: Values) -> bool:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        minimise(Quartic(3, 1.0, curved=True), np.zeros(3), watch)


def test_swallowed_interrupts_are_raised_too() -> None:
    """CasADi swallows Ctrl-C when it arrives outside of a callback."""

    class Swallowing(Quartic):
        def evaluate(self, x: Array) -> Values:
            try:
                signal.raise_signal(signal.SIGINT)
                list(range(1000))
            except KeyboardInterrupt:
                pass
            return super().evaluate(x)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        program = Swallowing(20, 5.0, curved=False)
        with pytest.raises(KeyboardInterrupt):
            minimise(program, np.linspace(0.0, 0.3, 20))
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
        assert program.asked == 1
    finally:
        signal.signal(signal.SIGINT, before)


def test_interrupts_during_shape_queries_are_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    made = nlp.callback_class

    def interrupted(casadi: Any) -> Any:
        class Interrupted(made(casadi)):
            def get_n_in(self) -> int:
                signal.raise_signal(signal.SIGINT)
                return super().get_n_in()

        return Interrupted

    monkeypatch.setattr(nlp, "callback_class", interrupted)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            minimise(Quartic(3, 1.0, curved=True), np.zeros(3))
    finally:
        signal.signal(signal.SIGINT, before)


def test_nothing_is_printed(capfd: pytest.CaptureFixture[str]) -> None:
    minimise(Quartic(3, 1.0, curved=True), np.zeros(3))
    assert capfd.readouterr() == ("", "")
