"""Parts of the tests: each test is in exactly one."""

from __future__ import annotations

from argparse import ArgumentTypeError
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sizes import Portion, portion, with_long_part


@given(st.text(), st.integers(1, 20))
def test_each_name_is_in_exactly_one_part(name: str, n: int) -> None:
    assert sum(name in Portion(k, n) for k in range(1, n + 1)) == 1


def test_parts_are_of_like_size() -> None:
    names = [f"tests/test_{i % 7}.py::test_{i}" for i in range(3000)]
    assert all(900 < sum(name in Portion(k, 3) for name in names) < 1100 for k in (1, 2, 3))


def test_a_part_is_read() -> None:
    assert portion("2/3") == Portion(2, 3)


@pytest.mark.parametrize("text", ["", "3", "0/3", "4/3", "1/0", "-1/3", "a/b", "1/3/5"])
def test_invalid_parts_are_refused(text: str) -> None:
    with pytest.raises(ArgumentTypeError, match="K/N"):
        portion(text)


def test_of_long_tests_one_part_is_run_before_all_quick_ones() -> None:
    items: Any = [
        SimpleNamespace(nodeid=f"test_{i}", get_closest_marker=lambda name, i=i: name == "long" and i % 3 == 0)
        for i in range(60)
    ]
    long = {item.nodeid for item in items[::3]}
    runs = [[item.nodeid for item in with_long_part(items, Portion(k, 4))] for k in (1, 2, 3, 4)]
    quick = [item.nodeid for item in items if item.nodeid not in long]
    assert all(run[-len(quick) :] == quick for run in runs)
    assert sorted(name for run in runs for name in run[: -len(quick)]) == sorted(long)
