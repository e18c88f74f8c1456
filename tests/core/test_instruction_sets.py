"""Available instruction sets. Separate from the kernel tests, which mutation testing runs at the baseline only."""

import re
from pathlib import Path

import pytest

from graceful_plan.core.kernels import instruction_sets


@pytest.mark.skipif(not Path("/proc/cpuinfo").exists(), reason="nothing says what the processor can do")
def test_the_best_instruction_set_of_the_processor_is_available():
    flags = set(re.search(r"^flags\s*:(.*)$|\Z", Path("/proc/cpuinfo").read_text(), re.MULTILINE)[0].split())
    names = instruction_sets()
    assert names[-1] == "baseline" and len(set(names)) == len(names)
    assert ("x86-64-v3" in names) == ({"avx2", "fma"} <= flags)
    assert ("x86-64-v4" in names) == ({f"avx512{part}" for part in ("f", "dq", "vl", "bw", "cd")} <= flags)
