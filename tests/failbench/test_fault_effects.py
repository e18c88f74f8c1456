"""The library's table of fault effects names the faults that FailBench has, without importing it."""

import pytest

from failbench.faults import DEGREES, faults
from graceful_plan import fault_prior
from graceful_plan.fault_prior import FaultPrior, presets, shipped_effects


def test_the_shipped_effects_are_those_of_the_faults_that_there_are():
    assert list(shipped_effects()) == list(faults())
    assert tuple(DEGREES) == fault_prior.DEGREES


@pytest.mark.parametrize("name", presets())
def test_presets_name_faults_that_there_are(name):
    assert set(FaultPrior.preset(name).rates) <= set(faults())
