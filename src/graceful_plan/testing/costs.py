"""Contract check of costs."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.costs.cost import Cost, StateBatch, checked_state
from graceful_plan.exceptions import GracefulPlanError
from graceful_plan.scene.scene import Scene
from graceful_plan.testing.contract import ContractError

Findings = Iterator[str]

_DIFFERENCES = (1e-5, 1e-3)
"""Half steps of the central differences [rad]. Poses and clearances are in single precision, whose rounding of 1e-7 m
hides a small difference; a wide one steps over kinks."""
_GRADIENT_TOLERANCE = 1e-3
"""Tolerance relative to the largest derivative; central differences of a smooth cost are accurate to about 1e-6."""
_SAME = 1e-9
"""Relative difference that the order of a summation may cause."""


def check_cost(cost: object, scene: Scene, *, samples: int = 64, seed: int = 0) -> None:
    """Evaluate a cost on random states of a scene and report everything that breaks the contract of `Cost`.

    Args:
        cost: The `Cost` to check.
        scene: A scene in which it can be evaluated.
        samples: Number of random states.
        seed: Seed of the random states.

    Raises:
        ContractError: With all findings, if there are any.
    """
    findings: list[str] = []
    if not isinstance(cost, Cost):
        raise ContractError(cost, ("is not a graceful_plan.Cost",))
    states = _RandomStates(scene, samples, np.random.default_rng(seed))
    for check in (_check_values, _check_purity, _check_batches, _check_gradient):
        try:
            findings += check(cost, states)
        except GracefulPlanError as error:
            findings.append(str(error).removeprefix(f"{type(cost).__name__}: "))
        except Exception as error:
            findings.append(f"raised {type(error).__name__}: {error}")
    if findings:
        raise ContractError(cost, tuple(dict.fromkeys(findings)))


class _RandomStates:
    """Random moving states within the limits of a scene, all arrays read-only."""

    def __init__(self, scene: Scene, n: int, rng: np.random.Generator) -> None:
        lower, upper = scene.limits.position.T
        direction = rng.normal(size=(n, len(lower)))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        self.scene = scene
        self.q = rng.uniform(lower, upper, direction.shape)
        self.direction, self.speed = direction, rng.uniform(0.1, 1.0, n)

    def batch(self, pick: Array | slice = slice(None), offset: Array | float = 0.0) -> StateBatch:
        """Return a new batch of the selected states, with q moved by `offset`."""
        arrays = (self.q[pick] + offset, self.direction[pick].copy(), self.speed[pick].copy())
        for array in arrays:
            array.flags.writeable = False
        return StateBatch(self.scene, *arrays)

    def at_rest(self) -> StateBatch:
        return StateBatch(self.scene, self.q)


def _check_values(cost: Cost, states: _RandomStates) -> Findings:
    for batch in (states.batch(), states.at_rest(), states.batch(slice(0, 1)), states.batch(slice(0, 0))):
        checked_state(cost, batch)
    yield from ()


def _check_purity(cost: Cost, states: _RandomStates) -> Findings:
    first, second = cost.state(states.batch()), cost.state(states.batch())
    if not np.array_equal(first, second, equal_nan=True):
        yield "state() gave different numbers for the same states"


def _check_batches(cost: Cost, states: _RandomStates) -> Findings:
    whole = np.asarray(cost.state(states.batch()))
    if whole.shape != (len(states.q),):
        return  # reported by _check_values
    order = np.arange(len(whole))[::-1]
    scale = max(float(np.abs(whole).max(initial=0.0)), 1e-300)
    if np.abs(np.asarray(cost.state(states.batch(order)))[order] - whole).max(initial=0.0) > _SAME * scale:
        yield "state() of a state depends on the order of the batch"
    single = np.array([np.asarray(cost.state(states.batch(slice(i, i + 1))))[0] for i in range(min(8, len(whole)))])
    if np.abs(single - whole[: len(single)]).max(initial=0.0) > _SAME * scale:
        yield "state() of a state depends on which other states are in the batch"


def _check_gradient(cost: Cost, states: _RandomStates) -> Findings:
    gradient = cost.gradient(states.batch())
    if gradient is None:
        return
    if gradient.shape != states.q.shape:
        yield f"gradient() returned shape {gradient.shape}, expected {states.q.shape}"
        return
    if not np.all(np.isfinite(gradient)):
        yield "gradient() is not finite everywhere"
        return
    small, wide = (
        _central_differences(lambda offset: np.asarray(cost.state(states.batch(offset=offset))), states.q, step)
        for step in _DIFFERENCES
    )
    expected = np.where(np.abs(gradient - small) <= np.abs(gradient - wide), small, wide)
    error = np.abs(gradient - expected)
    allowed = _GRADIENT_TOLERANCE * max(float(np.abs(wide).max()), float(np.abs(gradient).max()))
    # A cost may have kinks: a few states next to one may differ.
    wrong = np.atleast_1d((error > allowed).any(axis=1))
    if wrong.mean() > 0.05:
        state, joint = np.unravel_index(int(np.argmax(error)), error.shape)
        yield (
            f"gradient() differs from central differences of state() at {wrong.sum()} of {len(wrong)} states: "
            f"d/dq[{joint}] = {gradient[state, joint]:.6g}, expected {expected[state, joint]:.6g} "
            f"at q = {np.round(states.q[state], 4).tolist()}"
        )


def _central_differences(
    state: Callable[[Array], Array], q: Float[Array, "n nq"], difference: float
) -> Float[Array, "n nq"]:
    steps = difference * np.eye(q.shape[1])
    return np.stack([(state(step) - state(-step)) / (2.0 * difference) for step in steps], axis=1)
