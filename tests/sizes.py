"""What of a test is done by `make test`, and what by `make test-long`."""

from __future__ import annotations

from collections.abc import Iterable

import pytest
from _pytest.mark import ParameterSet


def first_quick(cases: Iterable[object]) -> list[ParameterSet]:
    """Mark all cases of a parameter but the first as long."""
    return [pytest.param(case, marks=[pytest.mark.long] if i else []) for i, case in enumerate(cases)]
