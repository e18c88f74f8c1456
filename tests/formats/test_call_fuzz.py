"""Public functions with random numbers, arrays, texts and names raise only errors of the library."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from places import ROOT


@pytest.mark.long
def test_public_functions_refuse_invalid_arguments(tmp_path: Path) -> None:
    """Run it in a separate process, without the type checks that tests add."""
    command = [sys.executable, str(ROOT / ".ci" / "fuzz_calls.py")]
    run = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False, cwd=tmp_path)
    assert run.returncode == 0 and run.stdout.endswith(" calls, 0 wrong\n"), run.stdout[-3000:] + run.stderr[-2000:]
