"""The 3-D view of reports: one self-contained document, or the reason why there is none."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.viewer import report_view as module
from graceful_plan.viewer.report_view import report_view

needs_viser = pytest.mark.skipif(importlib.util.find_spec("viser") is None, reason="viser is not installed")


@pytest.fixture(scope="module")
def motion():
    """A task, and a short motion of its robot."""
    task = gp.load_scene("tabletop").tasks["lift_to_goal"]
    q = np.linspace(task.start, task.start + 0.1, 3)
    return task, gp.retime(gp.Path(q), task.scene.limits, task.scene.joints)


@needs_viser
def test_the_view_is_one_document_with_both_motions(motion):
    task, trajectory = motion
    alone, why = report_view(trajectory, task.scene)
    assert why == "" and "__VISER_EMBED_DATA__" in alone and alone.count("{darkMode:false}") == 1
    both, _ = report_view(trajectory, task.scene, trajectory)
    assert len(alone) < len(both) < 1.5e6
    assert '<script src="' not in alone and '<link rel="stylesheet" href="http' not in alone


@needs_viser
def test_scenes_that_are_too_large_are_left_out(motion, monkeypatch):
    monkeypatch.setattr(module, "MOST", 1e5)
    assert report_view(motion[1], motion[0].scene) == ("", "in 3-D it would take 1 MB; `graceful-plan view` shows it")


def test_without_viser_the_extra_is_named(motion, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    document, why = report_view(motion[1], motion[0].scene)
    assert document == "" and ".[viz]" in why
