"""`graceful-plan view` from the shell: it prints the address, serves the page, and ends on interrupts."""

from __future__ import annotations

import importlib.util
import json
import signal
import subprocess
import sys
import urllib.request

import pytest

import graceful_plan as gp
from graceful_plan.documents import result_document, to_json
from graceful_plan.tools.cli import INTERRUPTED, MISUSE, main

_LONG = 60.0
"""Seconds after which a test fails."""

needs_viser = pytest.mark.skipif(importlib.util.find_spec("viser") is None, reason="viser is not installed")


def served(*arguments):
    """Open a page, fetch it and interrupt the program; return the page and the exit code."""
    command = [sys.executable, "-m", "graceful_plan.tools.cli", "view", *arguments, "--json", "--port", "8390"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            text = ""
            while not text.rstrip().endswith("}"):
                line = process.stdout.readline()
                assert line, process.stderr.read()
                text += line
            with urllib.request.urlopen(json.loads(text)["url"], timeout=_LONG) as answer:
                page = answer.read().decode()
        finally:
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=_LONG)
    return page, process.returncode


@pytest.mark.long
@needs_viser
def test_a_scene_is_served_until_interrupted():
    page, code = served("tabletop", "--w", "1", "--dark")
    assert "<html" in page and code == INTERRUPTED


@pytest.mark.long
@needs_viser
def test_the_output_of_plan_is_served(tmp_path):
    task = gp.load_scene("tabletop").tasks["lift_to_goal"]
    result = gp.plan(task.start, task.goal, task.scene, iterations=50)
    file = tmp_path / "result.json"
    file.write_text(to_json(result_document(result)))
    page, code = served(str(file), "--task", "lift_to_goal")
    assert "<html" in page and code == INTERRUPTED


@needs_viser
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nowhere"], "unknown scene 'nowhere'"),
        (["tabletop", "--task", "juggle"], "unknown task 'juggle'"),
        (["missing.json"], "missing.json"),
    ],
)
def test_misuse_has_its_exit_code(arguments, said, capsys):
    assert main(["view", *arguments]) == MISUSE
    assert said in capsys.readouterr().err


@pytest.mark.long
@needs_viser
def test_a_program_that_ends_without_closing_the_page_ends_quietly():
    code = """
import graceful_plan as gp
viewer = gp.view("tabletop", port=8395)
viewer._page.begin()
viewer._page.state.worker.wait(30.0)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=_LONG)
    assert (done.stdout, done.stderr, done.returncode) == ("", "", 0)
