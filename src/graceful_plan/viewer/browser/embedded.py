"""3-D view of a motion as a self-contained HTML document for reports."""

from __future__ import annotations

import contextlib
import io
from typing import Any

import numpy as np

from graceful_plan.viewer.browser.cameras import Cameras
from graceful_plan.viewer.browser.controls import GHOST
from graceful_plan.viewer.browser.drawn_scene import DrawnScene
from graceful_plan.viewer.browser.guarded_server import guarded_server
from graceful_plan.viewer.browser.plans import DrawnPlans
from graceful_plan.viewer.question import PlanAnswer

_RATE = 20.0
"""Frames per second."""
_REST = 1.0
"""Pause at the goal before the motion restarts [s]."""
_NEARER = 0.65
"""Camera distance relative to that of the page, because a report has less space."""
_HOST, _PORT = "127.0.0.1", 8480
"""Address of a temporary server, which viser needs for drawing; the document does not use it."""


def embedded(answer: PlanAnswer) -> str:
    """Return a document that plays the motions of an answer: the chosen one, and the ordinary one as a ghost.

    It contains viser's client, 0.8 MB; a scene without meshes adds some 0.1 MB. The text `{darkMode:false}` in it may
    be replaced by `{darkMode:true}`.
    """
    server = guarded_server(host=_HOST, port=_PORT)
    try:
        return _recorded(server, answer)
    finally:
        with contextlib.redirect_stdout(io.StringIO()):  # suppresses viser's message on the terminal
            server.stop()


def _recorded(server: Any, answer: PlanAnswer) -> str:
    server.scene.configure_environment_map(None)
    server.scene.configure_default_lights(cast_shadow=False)
    plans = DrawnPlans(server, Cameras(server, answer.question))
    camera = server.initial_camera
    camera.position = camera.look_at + _NEARER * (camera.position - camera.look_at)
    shown, others = answer.motions[0], answer.motions[1:]
    plans.draw(shown, others, GHOST)
    stage = DrawnScene(server, "/scene", shown.scene)
    recording = server.get_scene_serializer()
    duration = max(motion.duration for motion in answer.motions)
    for t in np.arange(0.0, duration + 1.0 / _RATE, 1.0 / _RATE).tolist():
        frame = shown.frame(t)
        stage.put(shown.poses.position[frame], shown.poses.quaternion[frame])
        there = [(other.poses, other.frame(t)) for other in others]
        plans.put([(poses.position[k], poses.quaternion[k]) for poses, k in there])
        recording.insert_sleep(1.0 / _RATE)
    recording.insert_sleep(_REST)
    return str(recording.as_html())
