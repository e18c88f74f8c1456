"""The page: what is asked there goes to the state, and what the state says is drawn."""

from __future__ import annotations

import atexit
import contextlib
import importlib
import io
import logging
import threading
import time
from collections.abc import Callable
from typing import Any, final

import numpy as np

from graceful_plan.exceptions import GracefulPlanError
from graceful_plan.viewer.browser import marks, words
from graceful_plan.viewer.browser.cameras import Cameras
from graceful_plan.viewer.browser.chart import ImpactChart
from graceful_plan.viewer.browser.controls import build
from graceful_plan.viewer.browser.drawn_scene import DrawnScene
from graceful_plan.viewer.browser.plans import DrawnPlans
from graceful_plan.viewer.failing import Failure, Replay, faults_of
from graceful_plan.viewer.poses import pose_of, poses_along, quaternion_of
from graceful_plan.viewer.question import PlanAnswer, Question
from graceful_plan.viewer.recorded import RecordedRollouts
from graceful_plan.viewer.shapes import parts
from graceful_plan.viewer.state import ViewerState

Array = np.ndarray

_RATE = 30.0
"""Frames per second while it plays."""
_WORDS_RATE = 6.0
"""Times per second that text and chart change meanwhile: they cost the browser more than poses."""
_PANEL = 360
"""Width of the panel [pixels]."""
_log = logging.getLogger(__name__)


@final
class Page:
    """A page that shows one state, to as many browsers as like to look.

    Args:
        question: What is asked first.
        answer: What is known already; planned if None.
        host: Address to listen at.
        port: Port to listen at; the next free one if it is taken.
        dark: Whether the page is dark.
        rollouts: Of a dataset, to choose from.
    """

    def __init__(
        self,
        question: Question,
        answer: PlanAnswer | None,
        *,
        host: str,
        port: int,
        dark: bool = False,
        rollouts: RecordedRollouts | None = None,
    ) -> None:
        viser: Any = importlib.import_module("viser")
        with contextlib.redirect_stdout(io.StringIO()):  # it greets on the terminal
            self.server: Any = viser.ViserServer(host=host, port=port, label="graceful_plan", verbose=False)
        self._lock = threading.RLock()
        self.state = ViewerState(question, self._answered, self._not_answered, answer)
        self._t, self._playing, self._closed, self._said_at = 0.0, False, threading.Event(), 0.0
        self._asked_first = False
        self._stage = self._chart = self._layer = self._entity_handle = None
        self._labels: list[Any] = []
        self._theme(dark)
        self.server.scene.configure_environment_map(None)
        self.server.scene.configure_default_lights(cast_shadow=False)
        self._plans = DrawnPlans(self.server, Cameras(self.server, question))
        self.server.gui.main_panel.dock_right()
        self.server.gui.main_panel.set_width(_PANEL)
        self._controls = build(
            self.server,
            w=question.w,
            entities=tuple(question.scene.entities),
            faults=faults_of(question.scene),
            dark=dark,
            rollouts=rollouts,
        )
        self._footprints = marks.Footprints(self.server)
        self._start, self._goal = (self._handle(name) for name in ("start", "goal"))
        with self._lock:
            self._draw_scene()
            self._place_handles()
            self._connect()
            if answer is not None:
                self._answered()
            self._show(0.0)
        self.server.on_client_connect(lambda _: self._begin())
        self._player = threading.Thread(target=self._play, name="viewer-player", daemon=True)
        self._player.start()
        atexit.register(self.close)

    @property
    def url(self) -> str:
        """Where the page is."""
        host = self.server.get_host()
        return f"http://{'localhost' if host in ('0.0.0.0', '127.0.0.1') else host}:{self.server.get_port()}"

    def close(self) -> None:
        """Stop serving the page; done at the end of the program, too."""
        atexit.unregister(self.close)
        self._closed.set()
        self.state.close()
        self._player.join(timeout=5.0)
        with contextlib.redirect_stdout(io.StringIO()):
            self.server.stop()

    def _begin(self) -> None:
        """Plan once somebody looks: until then the processor is for the first picture."""
        with self._lock:
            if not self._asked_first:
                self._asked_first = True
                self._ask(self.state.question)

    # --- the first picture --------------------------------------------------------------------------------------------

    def _theme(self, dark: bool) -> None:
        # The button to share would send the scene to a server of others.
        self.server.gui.configure_theme(dark_mode=dark, show_share_button=False, show_logo=False)

    def _handle(self, name: str) -> Any:
        drives = self.state.question.scene.base is not None
        return self.server.scene.add_transform_controls(
            f"/{name}",
            scale=0.6 if drives else 0.13,
            line_width=3.0,
            active_axes=(True, True, not drives),
            depth_test=False,
        )

    def _draw_scene(self) -> None:
        """Draw the scene of the question from scratch, where its robot is at the start."""
        if self._stage is not None:
            self._stage.remove()
        question = self.state.question
        self._stage = DrawnScene(self.server, "/scene", question.scene)
        poses, _ = poses_along(question.scene, parts(question.scene), question.start[None], np.zeros(1))
        self._stage.put(poses.position[0], poses.quaternion[0])
        self._drawn = question.scene
        self._controls.offer(tuple(question.scene.entities), faults_of(question.scene))
        self._name_things()

    def _name_things(self) -> None:
        for label in self._labels:
            label.remove()
        self._labels = []
        if not self._controls.names.value:
            return
        scene = self.state.question.scene
        data = scene.data_at(self.state.question.start)
        for name, entity in scene.entities.items():
            top = max(data.geom_xpos[list(entity.geoms)], key=lambda place: float(place[2]), default=np.zeros(3))
            worst = max(entity.severity.values(), default=0.0)
            self._labels.append(self.server.scene.add_label(f"/names/{name}", f"{name}: {worst:g}", position=top))

    # --- what somebody does -------------------------------------------------------------------------------------------

    def _connect(self) -> None:
        c = self._controls
        self._on(c.time, lambda: self._seek(c.time.value))
        self._on(c.w, lambda: self._ask(self.state.question.weighted(c.w.value)))
        self._on(c.other, self._draw_plans)
        self._on(c.handles, self._show_handles)
        self._on(c.start, lambda: self._typed(c.start.value, self._start, Question.starting_at))
        self._on(c.goal, lambda: self._typed(c.goal.value, self._goal, Question.going_to))
        self._on(c.entity, self._pick)
        self._on(c.severity, self._set_severity)
        self._on(c.move, self._offer_move)
        self._on(c.names, self._name_things)
        self._on(c.footprint, lambda: self._show(self._t))
        self._on(c.risk_map, self._lay_map)
        self._on(c.dark, lambda: self._theme(c.dark.value))
        c.play.on_click(lambda _: self._guarded(self._toggle))
        c.fail.on_click(lambda _: self._guarded(self._fail))
        c.heal.on_click(lambda _: self._guarded(self._heal))
        c.renew.on_click(lambda _: self._guarded(self._lay_map))
        if c.recorded is not None:
            c.recorded.on_chosen(lambda number: self._guarded(lambda: self._happen_again(number)))
        self._dragged(self._start, Question.starting_at)
        self._dragged(self._goal, Question.going_to)
        self._pick()

    def _on(self, handle: Any, act: Callable[[], None]) -> None:
        """Act on changes that come from a browser; those that the page itself makes are no wishes."""

        def react(event: Any) -> None:
            if event.client is not None:
                self._guarded(act)

        handle.on_update(react)

    def _dragged(self, handle: Any, change: Callable[[Question, Array], Question]) -> None:
        def react(event: Any) -> None:
            if event.phase == "end":
                pose = pose_of(np.asarray(handle.position), np.asarray(handle.wxyz))
                self._guarded(lambda: self._changed(change(self.state.question, pose)))

        handle.on_update(react)

    def _typed(self, position: Any, handle: Any, change: Callable[[Question, Array], Question]) -> None:
        pose = pose_of(np.asarray(position), np.asarray(handle.wxyz))
        self._changed(change(self.state.question, pose))

    def _guarded(self, act: Callable[[], None]) -> None:
        """Do what somebody asked for; if it cannot be, say why and show again what is."""
        try:
            with self._lock:
                act()
        except GracefulPlanError as error:
            self._complain(error)
            with self._lock:
                self._place_handles()

    def _complain(self, error: Exception) -> None:
        if not isinstance(error, GracefulPlanError):
            _log.error("the viewer failed", exc_info=error)
        for client in self.server.get_clients().values():
            client.add_notification("This cannot be done", str(error), color="red", auto_close_seconds=12.0)

    def _not_answered(self, error: Exception) -> None:
        self._complain(error)
        self._say(busy=False)

    def _ask(self, question: Question) -> None:
        self._asked_first = True
        self.state.ask(question)
        self._say(busy=True)

    def _changed(self, question: Question) -> None:
        """Ask something with other ends or among other things."""
        moved = question.scene is not self.state.question.scene
        self._ask(question)
        if moved:
            self._draw_scene()
        self._place_handles()

    def _place_handles(self) -> None:
        question, c = self.state.question, self._controls
        for handle, X, field in (
            (self._start, question.handle_pose(question.start), c.start),
            (self._goal, question.goal_pose(), c.goal),
        ):
            handle.position, handle.wxyz = X[:3, 3], quaternion_of(X[:3, :3])
            field.value = tuple(round(x, 4) for x in X[:3, 3].tolist())
        self._show_handles()

    def _show_handles(self) -> None:
        """Show the handles if they are wanted; not before the first answer, so that the first picture comes sooner."""
        for handle in (self._start, self._goal):
            handle.visible = bool(self._controls.handles.value) and self.state.answer is not None

    # --- things -------------------------------------------------------------------------------------------------------

    def _pick(self) -> None:
        scene, c = self.state.question.scene, self._controls
        if c.entity.value in scene.entities:
            c.severity.value = float(max(scene.entities[c.entity.value].severity.values(), default=0.0))
            self._offer_move()

    def _set_severity(self) -> None:
        c = self._controls
        self._ask(self.state.question.with_severity(c.entity.value, float(c.severity.value)))
        self._name_things()

    def _offer_move(self) -> None:
        if self._entity_handle is not None:
            self._entity_handle.remove()
            self._entity_handle = None
        c = self._controls
        if not c.move.value:
            return
        name = c.entity.value
        X = self.state.question.entity_pose(name)
        self._entity_handle = self.server.scene.add_transform_controls(
            "/entity", scale=0.2, line_width=3.0, depth_test=False, position=X[:3, 3], wxyz=quaternion_of(X[:3, :3])
        )
        self._dragged(self._entity_handle, lambda question, pose: question.with_moved(name, pose))

    # --- answers ------------------------------------------------------------------------------------------------------

    def _answered(self) -> None:
        with self._lock:
            if self.state.answer is not None and self.state.answer.question.scene is not self._drawn:
                self._draw_scene()
            self._controls.heal.visible = self.state.replay is not None
            self._show_handles()
            self._draw_plans()
            self._new_chart()
            self._seek(min(self._t, self.state.duration))
            self._lay_map()
            self._say(busy=False)

    def _draw_plans(self) -> None:
        """Draw the paths, and the ordinary motion as it is to be shown."""
        self._plans.draw(self.state.answer, self._controls.other.value)
        self._show(self._t)

    def _new_chart(self) -> None:
        if self._chart is not None:
            self._chart.handle.remove()
            self._chart = None
        if self.state.motion is not None:
            with self._controls.chart_folder:
                self._chart = ImpactChart(self.server, self.state.motion)

    def _lay_map(self) -> None:
        c = self._controls
        if self._layer is not None:
            self._layer.remove()
            self._layer = None
        c.renew.disabled = not c.risk_map.value
        if c.risk_map.value:
            layer = self.state.layer(self._t)
            self._layer = None if layer is None else marks.add_layer(self.server, layer)

    # --- failures -----------------------------------------------------------------------------------------------------

    def _fail(self) -> None:
        c = self._controls
        failure = Failure(fault=c.fault.value, degree=c.degree.value, moment=c.moment.value / 100.0)
        self._watch(self.state.fail(failure))

    def _happen_again(self, number: int) -> None:
        """Show a rollout of the dataset, on its own motion."""
        recorded, before = self._controls.recorded, self.state.question
        if recorded is None:
            return
        replay = self.state.happen_again(recorded.rollouts, number)
        if self.state.question is not before:
            self._draw_scene()
            self._place_handles()
            self._controls.w.value = self.state.question.w
            self._draw_plans()
            self._new_chart()
        self._watch(replay)

    def _watch(self, replay: Replay) -> None:
        self._controls.heal.visible = True
        self._seek(max(0.0, replay.onset - 0.3))
        self._say(busy=not self.state.worker.idle)
        self._toggle(True)

    def _heal(self) -> None:
        self.state.forget()
        self._controls.heal.visible = False
        self._seek(min(self._t, self.state.duration))
        self._say(busy=not self.state.worker.idle)

    # --- time ---------------------------------------------------------------------------------------------------------

    def _toggle(self, playing: bool | None = None) -> None:
        self._playing = not self._playing if playing is None else playing
        self._controls.play.label = "Pause" if self._playing else "Play"

    def _seek(self, t: float) -> None:
        c = self._controls
        c.time.max = max(0.01, round(self.state.duration, 2))
        self._t = min(max(t, 0.0), self.state.duration)
        c.time.value = min(round(self._t, 2), c.time.max)
        self._show(self._t)

    def _show(self, t: float, *, words_too: bool = True) -> None:
        """Show one moment."""
        moment = self.state.at(t)
        if moment is None or self._stage is None:
            return
        with self.server.atomic():
            self._stage.put(moment.position, moment.turned)
            if moment.beside is not None:
                self._plans.put(*moment.beside)
            shown = self._controls.footprint.value
            self._footprints.show(moment.fall if shown else None, moment.going_on if shown else None)
            replay = self.state.replay
            if replay is not None:
                self._stage.strike({name for _, name, after, _ in replay.hits if t >= replay.onset + after})
            else:
                self._stage.strike(())
        if words_too:
            self._controls.now_text.content = words.now_words(moment.impact, failed=moment.failed)
            if self._chart is not None:
                self._chart.show(t)

    def _say(self, *, busy: bool) -> None:
        c = self._controls
        c.plan_text.content = words.plan_words(self.state.answer, busy=busy)
        c.failure_text.content = words.failure_words(self.state.replay, self.state.motion)

    def _play(self) -> None:
        last = time.perf_counter()
        while not self._closed.wait(max(0.0, last + 1.0 / _RATE - time.perf_counter())):
            now = time.perf_counter()
            passed, last = now - last, now
            if not self._playing:
                continue
            with self._lock:
                self._step(passed, now)

    def _step(self, passed: float, now: float) -> None:
        duration, c = self.state.duration, self._controls
        self._t += passed * float(c.speed.value)
        if self._t > duration:
            # A failure stops where it ends, a motion begins again.
            self._t = duration if self.state.replay is not None else 0.0
            if self.state.replay is not None:
                self._toggle(False)
        due = now - self._said_at >= 1.0 / _WORDS_RATE or not self._playing
        if due:
            self._said_at = now
            c.time.value = min(round(self._t, 2), c.time.max)
        self._show(self._t, words_too=due)
