"""Ctrl-C ends a command with 130 at any moment, also inside an import that turns it into another error."""

import json
import os
import signal
import subprocess
import sys
import textwrap
import threading

import pytest

from graceful_plan.tools.ending import Interrupts, complain

_PROGRAM = """
    import importlib.abc, os, signal, sys

    class Interrupted(importlib.abc.MetaPathFinder):
        "As an extension module does that is interrupted: it raises what tells nothing of it."

        def find_spec(self, name, path, target=None):
            if name == {module!r}:
                try:
                    os.kill(os.getpid(), signal.SIGINT)
                    for _ in range(10**7):
                        pass
                except KeyboardInterrupt:
                    raise ImportError("initialization failed") from None

    sys.meta_path.insert(0, Interrupted())
    from {package} import main
    sys.exit(main({words!r}))
"""


@pytest.mark.parametrize("module", ["numpy", "mujoco"])
@pytest.mark.parametrize(
    ("package", "words"),
    [
        ("graceful_plan.tools.cli", ("plan", "--json")),
        ("failbench.cli", ("scenarios", "--json")),
    ],
)
def test_an_interrupted_import_ends_with_130(package, words, module):
    program = textwrap.dedent(_PROGRAM).format(module=module, package=package, words=words)
    done = subprocess.run([sys.executable, "-c", program], check=False, capture_output=True, text=True, timeout=120)
    assert done.returncode == 130, done.stderr
    assert done.stderr.endswith(": interrupted\n") and done.stderr.count("\n") == 1
    assert json.loads(done.stdout) | {"command": ""} == {
        "schema": "graceful_plan.error",
        "version": 1,
        "command": "",
        "error": "KeyboardInterrupt",
        "message": "interrupted",
        "exit_code": 130,
    }


def test_an_interrupt_is_noted_and_raised():
    with Interrupts() as interrupts:
        assert not interrupts.caused(ImportError())
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
            threading.Event().wait(10.0)
        assert interrupts.caused(ImportError()) and not interrupts.caused(SystemExit())
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_the_handler_of_another_program_is_kept():
    def other(*_):
        return None

    before = signal.signal(signal.SIGINT, other)
    try:
        with Interrupts() as interrupts:
            assert signal.getsignal(signal.SIGINT) is other
        assert interrupts.caused(KeyboardInterrupt())
    finally:
        signal.signal(signal.SIGINT, before)


def test_in_other_threads_nothing_is_changed():
    found = []

    def run():
        with Interrupts():
            found.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert found == [signal.getsignal(signal.SIGINT)]


def test_ending_needs_no_numpy():
    code = (
        "import sys, graceful_plan.tools.ending, graceful_plan.tools.cli, failbench.cli; print('numpy' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout == "False\n"


def test_errors_are_printed_as_text_and_document(capsys):
    assert complain("program plan", ValueError("broken"), 2, as_json=True, before="usage: ..") == 2
    out, err = capsys.readouterr()
    assert err == "usage: ..\nprogram plan: broken\n" and json.loads(out)["error"] == "ValueError"
    assert complain("program plan", ValueError("broken"), 1, as_json=False) == 1
    assert capsys.readouterr() == ("", "program plan: broken\n")
