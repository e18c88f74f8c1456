"""Shapes are checked in tests: the first calls of a function per test, then one in many."""

import gc
import weakref
from collections.abc import Iterator

import jaxtyping
import numpy as np
import pytest
from beartype import beartype

import shape_checks
from graceful_plan.array_types import Float
from graceful_plan.costs.cost_samples import CostSamples
from graceful_plan.path import evenly

WRONG = jaxtyping.TypeCheckError


@shape_checks.jaxtyped(typechecker=beartype)
def product(a: Float[np.ndarray, "n m"], b: Float[np.ndarray, " m"]) -> Float[np.ndarray, " n"]:
    return a @ b if a.size else np.zeros((1, 1))


@pytest.mark.parametrize("test", [1, 2])
def test_the_first_calls_of_each_test_are_checked_and_one_in_many_later(test):
    checked = []
    for _ in range(3 * shape_checks.EVERY):
        try:
            product(np.zeros((0, 1)), np.zeros(1))  # the result has the wrong shape
            checked.append(False)
        except WRONG:
            checked.append(True)
    assert all(checked[: shape_checks.FIRST])
    assert sum(checked) == shape_checks.FIRST + 3


def test_arguments_have_to_fit_together():
    np.testing.assert_array_equal(product(np.eye(2), np.ones(2)), np.ones(2))
    with pytest.raises(WRONG):
        product(np.eye(2), np.ones(3))


def test_methods_and_properties_are_checked():
    @shape_checks.jaxtyped(typechecker=beartype)
    class Plain:
        @shape_checks.jaxtyped(typechecker=beartype)
        def method(self, x: Float[np.ndarray, " 1"]) -> Float[np.ndarray, " 1"]:
            return x

        @staticmethod
        @shape_checks.jaxtyped(typechecker=beartype)
        def static(x: Float[np.ndarray, " 2"]) -> Float[np.ndarray, " 2"]:
            return x

        @property
        @shape_checks.jaxtyped(typechecker=beartype)
        def wrong(self) -> Float[np.ndarray, " 3"]:
            return np.zeros(4)

    for call in (lambda: Plain().method(np.zeros(2)), lambda: Plain.static(np.zeros(1)), lambda: Plain().wrong):
        with pytest.raises(WRONG):
            call()
    assert len(Plain().method(np.zeros(1))) == 1 and len(Plain.static(np.zeros(2))) == 2


def test_dataclasses_are_checked():
    with pytest.raises(WRONG):
        CostSamples(None, np.zeros((2, 2)), np.zeros(2))  # pyright: ignore[reportArgumentType]


def test_functions_without_shapes_are_left_as_they_are():
    def plain(x: int) -> int:
        return x

    assert shape_checks.jaxtyped(typechecker=beartype)(plain) is plain


def test_closures_generators_and_unknown_names_are_checked():
    """The plain checker would keep closures alive, check generators too late, or miss unknown names."""
    kept = np.zeros(2)

    @shape_checks.jaxtyped(typechecker=beartype)
    def closure(x: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        return np.concatenate([x, kept])

    @shape_checks.jaxtyped(typechecker=beartype)
    def numbers(x: Float[np.ndarray, " n"]) -> Iterator[Float[np.ndarray, " n"]]:
        yield x
        yield kept  # yielded values are not checked

    @shape_checks.jaxtyped(typechecker=beartype)
    def unknown(x: Float[np.ndarray, " n"]) -> "Nobody":  # noqa: F821
        return x

    for call in (closure, numbers, unknown):
        with pytest.raises(WRONG):
            call(np.zeros((1, 1)))
    with pytest.raises(WRONG):
        closure(np.zeros(1))
    assert len(list(numbers(np.zeros(1)))) == 2


def test_checks_keep_no_closures_alive():
    class Held:
        pass

    def called() -> weakref.ref[Held]:
        held = Held()

        @shape_checks.jaxtyped(typechecker=beartype)
        def closure(x: Float[np.ndarray, " 1"]) -> Float[np.ndarray, " 1"]:
            assert held
            return x

        assert len(closure(np.zeros(1))) == 1
        return weakref.ref(held)

    found = called()
    gc.collect()
    assert found() is None


def test_the_library_is_checked():
    with pytest.raises(WRONG):
        evenly(np.zeros(3), 2)
