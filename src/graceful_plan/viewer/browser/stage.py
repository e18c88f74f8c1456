"""3-D content of the page (scene, motions, names, footprint, risk map), and the chart of impact."""

from __future__ import annotations

from typing import Any, final

import numpy as np

from graceful_plan.scene.scene import Scene
from graceful_plan.viewer.browser import marks, words
from graceful_plan.viewer.browser.cameras import Cameras
from graceful_plan.viewer.browser.chart import ImpactChart
from graceful_plan.viewer.browser.controls import Controls
from graceful_plan.viewer.browser.drawn_scene import DrawnScene
from graceful_plan.viewer.browser.plans import DrawnPlans
from graceful_plan.viewer.poses import poses_along
from graceful_plan.viewer.question import Question
from graceful_plan.viewer.risk_layer import RiskLayer
from graceful_plan.viewer.shapes import parts
from graceful_plan.viewer.shown import ShownMotion
from graceful_plan.viewer.state import ViewerState


@final
class DrawnStage:
    """Drawing of given states.

    Args:
        server: viser's server.
        controls: Display options, and elements for text and chart.
        question: Initial request.
    """

    def __init__(self, server: Any, controls: Controls, question: Question) -> None:
        self._server, self._controls = server, controls
        self._plans = DrawnPlans(server, Cameras(server, question))
        self._footprints = marks.Footprints(server)
        self.layer: Any = None
        with controls.chart_folder:
            self._chart = ImpactChart(server)
        self._labels: list[Any] = []
        self._draw_scene(question)

    def set_scene(self, question: Question) -> None:
        """Redraw the scene of a request, with its robot at the start."""
        self._scene.remove()
        self._draw_scene(question)

    def _draw_scene(self, question: Question) -> None:
        self.drawn: Scene = question.scene
        self._scene = DrawnScene(self._server, "/scene", question.scene)
        self._begin(question)
        self.name_things(question)

    def _begin(self, question: Question) -> None:
        poses, _ = poses_along(question.scene, parts(question.scene), question.start[None], np.zeros(1))
        self._scene.put(poses.position[0], poses.quaternion[0])

    def name_things(self, question: Question) -> None:
        """Show names and severities of entities, if enabled."""
        for label in self._labels:
            label.remove()
        self._labels = []
        if not self._controls.names.value:
            return
        data = question.scene.data_at(question.start)
        for name, entity in question.scene.entities.items():
            top = max(data.geom_xpos[list(entity.geoms)], key=lambda place: float(place[2]), default=np.zeros(3))
            worst = max(entity.severity.values(), default=0.0)
            self._labels.append(self._server.scene.add_label(f"/names/{name}", f"{name}: {worst:g}", position=top))

    def set_plans(self, state: ViewerState) -> None:
        """Draw the paths, and the other motions in their display mode."""
        self._plans.draw(state.motion, state.others, self._controls.other.value)

    def set_chart(self, motion: ShownMotion | None) -> None:
        """Draw the chart of a motion; hide it for None."""
        self._chart.draw(motion)

    def lay(self, layer: RiskLayer | None) -> None:
        """Replace the risk map in the scene; None removes it."""
        if self.layer is not None:
            self.layer.remove()
        self.layer = None if layer is None else marks.add_layer(self._server, layer)

    def show(self, state: ViewerState, t: float, words_too: bool = True) -> None:
        """Show a time [s]; without a motion, only the robot at the start."""
        moment, replay = state.at(t), state.replay
        if moment is None:
            if words_too:
                self._begin(state.question)
                self._scene.strike(())
                self._footprints.show(None, None)
                self._controls.now_text.content = ""
            return
        with self._server.atomic():
            self._scene.put(moment.position, moment.turned)
            self._plans.put(moment.beside)
            wanted = self._controls.footprint.value
            self._footprints.show(moment.fall if wanted else None, moment.going_on if wanted else None)
            hits = () if replay is None else replay.hits
            self._scene.strike({name for _, name, after, _ in hits if replay and t >= replay.onset + after})
        if words_too:
            self._controls.now_text.content = words.now_words(moment.impact, failed=moment.failed)
            self._chart.show(t)
