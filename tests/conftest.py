"""Configuration of all tests: hypothesis without deadlines, shape checks, and the scene and task of most tests."""

from __future__ import annotations

import atexit
import functools
import gc
import os
import signal
from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest
from hypothesis import settings

import shape_checks
import sizes

if TYPE_CHECKING:
    import graceful_plan as gp

# No timed asserts, since the machine may be busy. Examples differ from run to run, so few per run suffice.
settings.register_profile("unhurried", deadline=None, max_examples=20)
settings.load_profile("unhurried")

shape_checks.install()

gc.disable()  # until all tests are collected, which makes little garbage: it took a fifth of the time

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # Background jobs of a shell ignore interrupts, and so would every program that tests interrupt.
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add options to run a part of the tests."""
    parser.addoption("--part", type=sizes.portion, metavar="K/N", help="run the k-th of n parts of the tests")
    parser.addoption("--long-part", type=sizes.portion, metavar="K/N", help="run quick tests and a part of the long")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Deselect tests outside the requested parts."""
    if (part := config.getoption("--part")) is not None:
        _keep(config, items, [item for item in items if item.nodeid in part])
    if (part := config.getoption("--long-part")) is not None:
        _keep(config, items, sizes.with_long_part(items, part))


def _keep(config: pytest.Config, items: list[pytest.Item], kept: list[pytest.Item]) -> None:
    """Deselect all other tests."""
    names = {item.nodeid for item in kept}
    config.hook.pytest_deselected(items=[item for item in items if item.nodeid not in names])
    items[:] = kept


def pytest_collection_finish() -> None:
    """Collect garbage from now on, without a look at the modules and tests, and more rarely than by default."""
    gc.freeze()
    # Python frees the modules at its exit; otherwise nanobind reports their objects as leaks.
    # pytest collects garbage five times before that, without looking at them.
    atexit.register(gc.unfreeze)
    gc.set_threshold(10_000)
    gc.enable()


def pytest_sessionstart() -> None:
    """Read each bundled scene once per process: scenes are immutable and keep their compiled arrays."""
    from graceful_plan.scene.loading import bundled  # here, after the shape checks are configured

    bundled.read_bundled = functools.cache(bundled.read_bundled)


def pytest_runtest_logstart() -> None:
    """Check the first calls of every function again in each test."""
    shape_checks.begin_test()


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Use a cache folder of the tests instead of the user's; all processes of a run share it."""
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(folder / "cache"))
        yield


@pytest.fixture(scope="session")
def scene() -> gp.Scene:
    """The scene `tabletop` without a carried object; shared, since scenes are immutable."""
    import graceful_plan as gp  # here, since shapes are checked only in modules imported after the tests are configured

    return gp.load_scene("tabletop")


@pytest.fixture(scope="session")
def task(scene: gp.Scene) -> gp.Task:
    """The task `green_to_blue`; in its scene the object is in the gripper."""
    return scene.tasks["green_to_blue"]
