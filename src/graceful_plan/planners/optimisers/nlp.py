"""Nonlinear programs in NumPy, solved by IPOPT through CasADi.

A `Program` computes cost, gradient, constraints and their Jacobian in one call, so that native kernels are called once
per point. It may also provide the Hessian of the Lagrangian; otherwise IPOPT approximates it from gradients.
"""

from __future__ import annotations

import signal
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum
from types import FrameType
from typing import Any, NamedTuple, final

import numpy as np

from graceful_plan.array_types import Array, Float, Int

_FEASIBLE = frozenset({"Solve_Succeeded", "Solved_To_Acceptable_Level"})
_STOPPED = frozenset({"User_Requested_Stop", "Maximum_Iterations_Exceeded", "Maximum_CpuTime_Exceeded"})
_INFEASIBLE = frozenset({"Infeasible_Problem_Detected", "Restoration_Failed"})


class Values(NamedTuple):
    """Values of a program at one point."""

    cost: float
    gradient: Float[Array, " variable"]
    constraints: Float[Array, " constraint"]
    jacobian: Float[Array, " nonzero"]
    """Derivatives of the constraints, in the order of `Program.jacobian_pattern`."""


class Pattern(NamedTuple):
    """Sparsity pattern of a matrix, without duplicates."""

    row: Int[Array, " nonzero"]
    column: Int[Array, " nonzero"]


class Program(ABC):
    """A nonlinear program: a cost to minimise, with bounds on variables and constraints."""

    lower: Float[Array, " variable"]
    upper: Float[Array, " variable"]
    least: Float[Array, " constraint"]
    most: Float[Array, " constraint"]
    jacobian_pattern: Pattern
    hessian_pattern: Pattern | None = None
    """Pattern of the Hessian's upper triangle; None if there is no Hessian."""

    @abstractmethod
    def evaluate(self, x: Float[Array, " variable"]) -> Values:
        """Compute everything but the Hessian at a point."""

    def hessian(
        self, x: Float[Array, " variable"], factor: float, multipliers: Float[Array, " constraint"]
    ) -> Float[Array, " nonzero"]:
        """Return the Hessian of factor * cost + multipliers @ constraints, or an approximation, in pattern order."""
        raise NotImplementedError


class SolveOutcome(Enum):
    """Outcome of a solve."""

    SOLVED = "a local optimum"
    STOPPED = "stopped before a local optimum was reached"
    INFEASIBLE = "no nearby point satisfies all constraints"
    FAILED = "the solver gave up"


@final
@dataclass(frozen=True, eq=False)
class Solution:
    """Result of a solve."""

    outcome: SolveOutcome
    x: Float[Array, " variable"]
    iterations: int
    word: str
    """IPOPT's return status."""


Watch = Callable[[Array, Values], bool]
"""Called with every iterate; returning True ends the solve."""


def minimise(
    program: Program,
    x: Float[Array, " variable"],
    watch: Watch | None = None,
    *,
    iterations: int = 500,
    tolerance: float = 1e-6,
    settings: dict[str, Any] | None = None,
) -> Solution:
    """Solve a program from an initial guess. Prints nothing.

    Args:
        program: The program.
        x: Initial guess.
        watch: Called with every iterate; may end the solve.
        iterations: Largest number of iterations.
        tolerance: IPOPT's `tol`.
        settings: Further settings of IPOPT.

    Raises:
        Exception: Any exception that the program or `watch` has raised.
    """
    import casadi

    calls = _Calls(program, watch)
    options = {
        "print_level": 0,
        "sb": "yes",
        "max_iter": iterations,
        "tol": tolerance,
        "bound_relax_factor": 0.0,
        **(settings or {}),
    }
    if program.hessian_pattern is None:
        options["hessian_approximation"] = "limited-memory"
    with calls.remembering_interrupts():
        functions = _functions(program, calls, casadi)
        solver = _solver(functions, options, program, casadi)
        found = solver(x0=x, lbx=program.lower, ubx=program.upper, lbg=program.least, ubg=program.most)
    if calls.error is not None:
        raise calls.error
    stats = solver.stats()
    word = str(stats["return_status"])
    return Solution(_outcome_of(word), np.asarray(found["x"]).ravel(), int(stats["iter_count"]), word)


def _outcome_of(word: str) -> SolveOutcome:
    """Return the outcome for a return status of IPOPT."""
    for names, outcome in (
        (_FEASIBLE, SolveOutcome.SOLVED),
        (_STOPPED, SolveOutcome.STOPPED),
        (_INFEASIBLE, SolveOutcome.INFEASIBLE),
    ):
        if word in names:
            return outcome
    return SolveOutcome.FAILED


@final
class _Calls:
    """Implements CasADi's callbacks; caches the last point and stores the first exception, which CasADi would print."""

    def __init__(self, program: Program, watch: Watch | None) -> None:
        self._program, self._watch = program, watch
        self._last: tuple[bytes, Values] | None = None
        self.error: BaseException | None = None

    def values(self, x: Array) -> Values:
        key = x.tobytes()
        if self._last is None or self._last[0] != key:
            self._last = key, self._program.evaluate(x)
        return self._last[1]

    def guarded(self, answer: Callable[..., list[Any]], nothing: list[Any]) -> Callable[..., list[Any]]:
        """Return a callback that stores exceptions and returns `nothing` after one."""

        def ask(*inputs: Any) -> list[Any]:
            if self.error is not None:
                return nothing
            try:
                return answer(*(np.asarray(value, dtype=np.float64).ravel() for value in inputs))
            except BaseException as error:
                self.error = error
                return nothing

        return ask

    @contextmanager
    def remembering_interrupts(self) -> Generator[None]:
        """Store an exception raised by Ctrl-C, too.

        CasADi checks for Ctrl-C between callbacks and would swallow it, or turn it into a RuntimeError if it comes
        while CasADi queries the shapes of the functions.
        """
        before = signal.getsignal(signal.SIGINT)
        if threading.current_thread() is not threading.main_thread() or not callable(before):
            yield
            return

        def remember(number: int, frame: FrameType | None) -> None:
            try:
                before(number, frame)
            except BaseException as error:
                self.error = self.error or error

        signal.signal(signal.SIGINT, remember)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)

    def stop(self, x: Array) -> bool:
        return self._watch is not None and self._watch(x, self.values(x))


def _functions(program: Program, calls: _Calls, casadi: Any) -> dict[str, Any]:
    """Return callbacks that replace the derivatives that `nlpsol` would generate."""
    n, m = len(program.lower), len(program.least)
    x, p, g, one = (casadi.Sparsity.dense(*shape) for shape in ((n, 1), (0, 1), (m, 1), (1, 1)))
    jacobian, order = _sparsity(program.jacobian_pattern, (m, n), casadi)
    callback = callback_class(casadi)

    def function(name: str, answer: Callable[..., list[Any]], inputs: list[Any], outputs: list[Any]) -> Any:
        nothing = [casadi.DM(sparsity, np.full(sparsity.nnz(), np.nan)) for sparsity in outputs]
        return callback(name, calls.guarded(answer, nothing), inputs, outputs)

    def gradient(x: Array, _: Array) -> list[Any]:
        return [calls.values(x).cost, calls.values(x).gradient]

    def slopes(x: Array, _: Array) -> list[Any]:
        values = calls.values(x)
        return [values.constraints, casadi.DM(jacobian, values.jacobian[order])]

    made = {
        "f": function("f", lambda x: [calls.values(x).cost], [x], [one]),
        "g": function("g", lambda x: [calls.values(x).constraints], [x], [g]),
        "grad_f": function("grad_f", gradient, [x, p], [one, x]),
        "jac_g": function("jac_g", slopes, [x, p], [g, jacobian]),
        "iteration_callback": _iteration(callback, calls, {"x": x, "f": one, "g": g, "lam_x": x, "lam_g": g}, casadi),
    }
    if program.hessian_pattern is not None:
        hessian, places = _sparsity(program.hessian_pattern, (n, n), casadi)

        def curvature(x: Array, _: Array, factor: Array, multipliers: Array) -> list[Any]:
            return [casadi.DM(hessian, program.hessian(x, float(factor[0]), multipliers)[places])]

        made["hess_lag"] = function("hess_lag", curvature, [x, p, one, g], [hessian])
    return made


def _iteration(callback: Any, calls: _Calls, sparsities: dict[str, Any], casadi: Any) -> Any:
    """Return the callback with which CasADi checks after every iteration whether to stop."""
    names = [casadi.nlpsol_out(i) for i in range(casadi.nlpsol_n_out())]
    at = names.index("x")
    stop = calls.guarded(lambda *values: [float(calls.stop(values[at]))], [1.0])
    inputs = [sparsities.get(name, casadi.Sparsity(0, 0)) for name in names]
    return callback("iteration", stop, inputs, [casadi.Sparsity.dense(1, 1)], names)


def _solver(functions: dict[str, Any], options: dict[str, Any], program: Program, casadi: Any) -> Any:
    x = casadi.MX.sym("x", len(program.lower))
    made = {"x": x, "f": functions["f"](x), "g": functions["g"](x)}
    given = {name: f for name, f in functions.items() if name not in ("f", "g")}
    quiet = {"print_time": False, "show_eval_warnings": False, "calc_lam_p": False, "no_nlp_grad": True}
    return casadi.nlpsol("program", "ipopt", made, {**given, **quiet, "ipopt": options})


def _sparsity(pattern: Pattern, shape: tuple[int, int], casadi: Any) -> tuple[Any, Int[Array, " nonzero"]]:
    """Return a pattern as a CasADi sparsity, and the column-major order of the entries."""
    order = np.lexsort((pattern.row, pattern.column))
    rows, columns = pattern.row[order].tolist(), pattern.column[order].tolist()
    return casadi.Sparsity.triplet(*shape, rows, columns), order


def callback_class(casadi: Any) -> Any:
    """Return a callback class; it is defined here because CasADi, its base, is imported only when needed."""

    class Callback(casadi.Callback):
        def __init__(self, name: str, answer: Any, inputs: Any, outputs: Any, names: Any = None) -> None:
            casadi.Callback.__init__(self)
            self.answer, self.inputs, self.outputs, self.names = answer, inputs, outputs, names
            self.construct(name, {})

        def get_n_in(self) -> int:
            return len(self.inputs)

        def get_n_out(self) -> int:
            return len(self.outputs)

        def get_name_in(self, i: int) -> str:
            return f"i{i}" if self.names is None else self.names[i]

        def get_sparsity_in(self, i: int) -> Any:
            return self.inputs[i]

        def get_sparsity_out(self, i: int) -> Any:
            return self.outputs[i]

        def eval(self, arguments: Any) -> Any:
            return self.answer(*arguments)

    return Callback
