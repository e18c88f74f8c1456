"""What all tests share: hypothesis without haste, checks of shapes, and the scene and task that most of them use."""

from __future__ import annotations

import functools
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import settings

import shape_checks
import sizes

if TYPE_CHECKING:
    import graceful_plan as gp

settings.register_profile("unhurried", deadline=None)  # no timed asserts: the machine may be busy
settings.load_profile("unhurried")

shape_checks.install()

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # What a shell starts in the background ignores interrupts, and so would every program that tests interrupt.
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Let a run do a part of the tests."""
    parser.addoption("--part", type=sizes.portion, metavar="K/N", help="run the k-th of n parts of the tests")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what is not in the part that was asked for."""
    if (part := config.getoption("--part")) is not None:
        left_out = [item for item in items if item.nodeid not in part]
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if item.nodeid in part]


def pytest_sessionstart() -> None:
    """Read each bundled scene once per process: scenes are immutable and keep their compiled arrays."""
    from graceful_plan.scene.loading import bundled  # here, after the shape checks are configured

    read = bundled.read_scene
    read_once = functools.cache(read)

    def read_scene(path: Path) -> gp.Scene:
        return (read_once if bundled._FOLDER in path.parents else read)(path)

    bundled.read_scene = read_scene


def pytest_runtest_logstart() -> None:
    """Check the first calls of every function, for each test anew."""
    shape_checks.begin_test()


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep what is kept between processes in a folder of the tests: the user's own is neither read nor written."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="session")
def scene() -> gp.Scene:
    """Load the scene `tabletop`, with empty hands; one for all tests, since a scene never changes."""
    import graceful_plan as gp  # here, since shapes are checked only in what is imported after the tests are configured

    return gp.load_scene("tabletop")


@pytest.fixture(scope="session")
def task(scene: gp.Scene) -> gp.Task:
    """Take its task `green_to_blue`; in the task's scene the object is in the gripper."""
    return scene.tasks["green_to_blue"]
