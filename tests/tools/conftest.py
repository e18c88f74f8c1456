"""Fixtures for tests of commands."""

import pytest

from graceful_plan.tools import cli


@pytest.fixture
def run(capsys):
    """Run a command; return exit code, standard output and standard error."""

    def run(*argv: str) -> tuple[int, str, str]:
        code = cli.main(argv)
        return code, *capsys.readouterr()

    return run
