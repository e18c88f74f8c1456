"""Path: lengths, resampling, refused arguments."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from graceful_plan.exceptions import NonFiniteError, SettingError, ShapeError
from graceful_plan.path import Path, finite_array


def _random(seed: int, n: int = 6) -> Path:
    return Path(np.random.default_rng(seed).normal(size=(n, 3)))


@given(st.integers(0, 1000), st.floats(0.01, 2.0))
def test_resampling_keeps_length_and_vertices_and_obeys_the_step(seed: int, step: float) -> None:
    path = _random(seed)
    fine = path.resampled(step)
    assert fine.length == pytest.approx(path.length)
    assert fine.segment_lengths.max() <= step * (1 + 1e-9)
    assert all(np.any(np.all(fine.q == q, axis=1)) for q in path.q)


@given(st.integers(0, 1000))
def test_backwards_is_as_long(seed: int) -> None:
    path = _random(seed)
    assert path.reversed().length == pytest.approx(path.length)
    np.testing.assert_array_equal(path.reversed().reversed().q, path.q)


def test_duplicates_are_dropped() -> None:
    assert Path(np.array([[0.0], [0.0], [1.0], [1.0], [0.0]])).without_duplicates().q.tolist() == [[0.0], [1.0], [0.0]]


def test_a_single_vertex_is_a_path() -> None:
    path = Path(np.array([[1.0, 2.0]]))
    assert len(path) == 1 and path.length == 0.0
    assert path.resampled(0.1).q.tolist() == path.without_duplicates().q.tolist() == [[1.0, 2.0]]


def test_vertices_are_a_read_only_copy() -> None:
    q = np.zeros((2, 2))
    path = Path(q)
    q[:] = 1.0
    assert path.length == 0.0
    with pytest.raises(ValueError, match="read-only"):
        path.q[0] = 1.0


@pytest.mark.parametrize(
    ("q", "error", "message"),
    [
        ([1.0, 2.0], ShapeError, "path has shape"),
        ([[1.0], [1.0, 2.0]], ShapeError, "rectangular"),
        ([["a"]], ShapeError, "numbers"),
        ([[0.0], [np.inf]], NonFiniteError, r"path is not finite at index \(1, 0\)"),
    ],
)
def test_refused(q: ArrayLike, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        finite_array("path", q, ndim=2)


def test_a_path_needs_a_vertex_and_finite_numbers() -> None:
    with pytest.raises(ShapeError, match="n >= 1"):
        Path(np.zeros((0, 3)))
    with pytest.raises(NonFiniteError, match=r"path.*finite"):
        Path(np.full((2, 2), np.nan))


def test_finite_array_names_what_it_expected() -> None:
    with pytest.raises(ShapeError, match=r"start.*\(2,\).*7"):
        finite_array("start", [0.0, 1.0], last=7)


def test_masked_values_are_refused() -> None:
    """Masked values are unknown; the numbers below a mask used to be read."""
    q = np.ma.array([[0.0, 1.0], [2.0, 3.0]], mask=[[0, 0], [1, 0]])
    with pytest.raises(NonFiniteError, match=r"path.*\(1, 0\)"):
        Path(q)
    whole = np.ma.array([[0, 1], [2, 3]])
    np.testing.assert_array_equal(finite_array("whole", whole), [[0.0, 1.0], [2.0, 3.0]])


@pytest.mark.parametrize("step", [0.0, -1.0, np.nan, 1e-12, 1e-320])
def test_a_step_gives_a_number_of_vertices_that_can_be_held(step: float) -> None:
    with pytest.raises(SettingError, match=r"step = .*10000000"):
        Path(np.array([[0.0], [1.0]])).resampled(step)
    assert len(Path(np.array([[0.0], [0.0]])).resampled(1.0)) == 2
