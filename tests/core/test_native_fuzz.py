"""The core refuses invalid arguments: a short run of the fuzzer that `.ci/run` repeats with sanitizers."""

from __future__ import annotations

import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.core import _native
from graceful_plan.core.compile import compile_scene

FUZZER = Path(__file__).parents[2] / ".ci" / "fuzz_native.py"


@pytest.mark.long
def test_broken_arguments_are_refused_or_do_no_harm() -> None:
    """Run the fuzzer in a separate process, which would contain a crash."""
    command = [sys.executable, str(FUZZER), "--calls", "600"]
    run = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert run.returncode == 0, run.stdout[-2000:] + run.stderr[-2000:]
    assert "0 wrong" in run.stdout


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e30])
def test_nan_is_never_free(value: float) -> None:
    core = compile_scene(gp.load_scene("tabletop")).kernels.core
    q = np.zeros((3, 7))
    bad = q.copy()
    bad[1, 2] = value
    for name, more in (("free_states", (0.0,)), ("clearance", ()), ("link_poses", ())):
        with pytest.raises(ValueError, match="configurations are"):
            getattr(core, name)(bad, *more)
    for step in (np.nan, 0.0, -1.0, 1e-300):
        with pytest.raises(ValueError, match="edge"):
            core.free_edges(q, q + 1.0, step, 0.0)
    with pytest.raises(ValueError, match="margin"):
        core.free_states(q, value)
    assert core.free_states(q, 0.0).shape == (3,)


def test_ends_of_a_search_have_the_width_of_its_space() -> None:
    space = _native.CallbackSpace(
        edges_free=lambda q0, q1: np.ones(len(q0), dtype=bool),
        edge_costs=lambda q0, q1: np.ones((len(q0), 2)),
        state_costs=lambda q: np.ones(len(q)),
        lower=np.zeros(2),
        upper=np.ones(2),
        w=0.0,
        motion_is_length=True,
    )
    given = {"range": 1.0, "max_nodes": 100, "seed": 0}
    for start, goals in (
        (np.zeros(0), np.zeros((1, 2))),
        (np.zeros(2), np.zeros((0, 2))),
        (np.zeros(2), np.zeros((1, 3))),
        (np.full(2, np.nan), np.zeros((1, 2))),
    ):
        with pytest.raises(ValueError, match="invalid argument"):
            _native.Connect(space, start=start, goals=goals, **given)


def test_a_search_refuses_a_second_thread() -> None:
    """A second thread is refused while the first one is inside a Python callback of the search."""
    inside, over = threading.Event(), threading.Event()

    def edges_free(q0: np.ndarray, q1: np.ndarray) -> np.ndarray:
        inside.set()
        over.wait(10.0)
        return np.zeros(len(q0), dtype=bool)

    space = _native.CallbackSpace(
        edges_free=edges_free,
        edge_costs=lambda q0, q1: np.ones((len(q0), 2)),
        state_costs=lambda q: np.ones(len(q)),
        lower=np.zeros(2),
        upper=np.ones(2),
        w=0.0,
        motion_is_length=True,
    )
    search = _native.Connect(space, start=np.zeros(2), goals=np.ones((1, 2)), range=1.0, max_nodes=100, seed=0)
    first = threading.Thread(target=search.run, args=(1, 10.0))
    first.start()
    assert inside.wait(10.0)
    with pytest.raises(RuntimeError, match="thread"):
        search.run(1, 1.0)
    over.set()
    first.join()
