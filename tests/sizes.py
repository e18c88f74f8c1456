"""Division of tests between `make test` and `make test-long`, and into parts."""

from __future__ import annotations

import zlib
from argparse import ArgumentTypeError
from collections.abc import Iterable
from dataclasses import dataclass

import pytest
from _pytest.mark import ParameterSet


def first_quick(cases: Iterable[object]) -> list[ParameterSet]:
    """Mark all cases of a parameter but the first as long."""
    return [pytest.param(case, marks=[pytest.mark.long] if i else []) for i, case in enumerate(cases)]


@dataclass(frozen=True)
class Portion:
    """The k-th of n parts, counted from 1."""

    k: int
    n: int

    def __contains__(self, name: str) -> bool:
        return zlib.crc32(name.encode()) % self.n == self.k - 1


def with_long_part(items: Iterable[pytest.Item], part: Portion) -> list[pytest.Item]:
    """Return a part of the long tests and all quick ones.

    Long tests come first, so that none begins when the other processes have nothing left to do.
    """
    long, quick = [], []
    for item in items:
        (long if item.get_closest_marker("long") else quick).append(item)
    return [item for item in long if item.nodeid in part] + quick


def portion(text: str) -> Portion:
    """Read "K/N".

    Raises:
        ArgumentTypeError: Unless it has this form, with 1 <= K <= N.
    """
    k, _, n = text.partition("/")
    if not (k.isdecimal() and n.isdecimal() and 1 <= int(k) <= int(n)):
        raise ArgumentTypeError(f"{text!r} is not K/N with 1 <= K <= N")
    return Portion(int(k), int(n))
