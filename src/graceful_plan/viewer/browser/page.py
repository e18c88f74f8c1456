"""The page: passes input from browsers to the state, and draws the state."""

from __future__ import annotations

import atexit
import contextlib
import io
import logging
from collections.abc import Callable
from typing import Any, final

from graceful_plan.array_types import Array
from graceful_plan.exceptions import GracefulPlanError
from graceful_plan.viewer.browser import words
from graceful_plan.viewer.browser.controls import build
from graceful_plan.viewer.browser.first_picture import when_drawn
from graceful_plan.viewer.browser.guarded_server import guarded_server
from graceful_plan.viewer.browser.handles import Change, Handles
from graceful_plan.viewer.browser.player import Player
from graceful_plan.viewer.browser.stage import DrawnStage
from graceful_plan.viewer.failing import Failure, Replay, faults_of
from graceful_plan.viewer.question import PlanAnswer, Question
from graceful_plan.viewer.recorded import RecordedRollouts
from graceful_plan.viewer.state import ViewerState

_PANEL = 360
"""Width of the panel [pixels]."""
_log = logging.getLogger(__name__)


@final
class Page:
    """A page that shows one state to any number of browsers.

    Args:
        question: Initial request.
        answer: Known answer; planned if None.
        host: Address to listen at.
        port: Port to listen at; the next free one if it is taken.
        dark: Whether the page is dark.
        rollouts: Rollouts of a dataset to choose from.
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
        self.server: Any = guarded_server(host=host, port=port, label="graceful_plan")
        self.state = ViewerState(question, self._answered, self._not_answered, answer)
        # Also held while drawing, so that a drawing shows a single answer.
        self.lock = self.state.lock
        self._asked_first = False
        self._theme(dark)
        self.server.scene.configure_environment_map(None)
        self.server.scene.configure_default_lights(cast_shadow=False)
        self.server.gui.main_panel.dock_right()
        self.server.gui.main_panel.set_width(_PANEL)
        entities, faults = tuple(question.scene.entities), faults_of(question.scene)
        self.controls = build(self.server, w=question.w, entities=entities, faults=faults, dark=dark, rollouts=rollouts)
        self.player = Player(self.state, self.controls, self._show, self.lock)
        drives = question.scene.base is not None
        self.handles = Handles(self.server, self.controls, drives, lambda *all: self._guarded(self._changed, *all))
        with self.lock:
            self.stage = DrawnStage(self.server, self.controls, question)
            self._place_handles()
            self._connect()
            self._draw()
            self._say(busy=False)
        self.server.on_client_connect(lambda client: when_drawn(client, self.begin))
        self.player.start()
        atexit.register(self.close)

    @property
    def url(self) -> str:
        """Address of the page."""
        host = self.server.get_host()
        return f"http://{'localhost' if host in ('0.0.0.0', '127.0.0.1') else host}:{self.server.get_port()}"

    def close(self) -> None:
        """Stop serving the page; also called at the end of the program."""
        atexit.unregister(self.close)
        self.handles.close()
        self.state.close()
        self.player.close()
        with contextlib.redirect_stdout(io.StringIO()):
            self.server.stop()

    def begin(self) -> None:
        """Start the first planning request, after the first picture is drawn."""
        with self.lock:
            if not self._asked_first:
                self._ask(self.state.question)

    def _theme(self, dark: bool) -> None:
        # The share button would send the scene to an external server.
        self.server.gui.configure_theme(dark_mode=dark, show_share_button=False, show_logo=False)

    # --- input --------------------------------------------------------------------------------------------------------

    def _connect(self) -> None:
        c = self.controls
        self._on(c.time, lambda: self.player.seek(c.time.value))
        self._on(c.w, lambda: self._ask(self.state.question.weighted(c.w.value)))
        self._on(c.other, self.draw_plans)
        self._on(c.handles, self._show_handles)
        self._on(c.start, lambda: self.handles.typed("start"))
        self._on(c.goal, lambda: self.handles.typed("goal"))
        self._on(c.entity, self._pick)
        self._on(c.severity, self._set_severity)
        self._on(c.move, self._offer_move)
        self._on(c.names, lambda: self.stage.name_things(self.state.question))
        self._on(c.footprint, lambda: self._show(self.player.t))
        self._on(c.risk_map, self._lay_map)
        self._on(c.dark, lambda: self._theme(c.dark.value))
        c.play.on_click(lambda _: self._guarded(self.player.toggle))
        c.keep.on_click(lambda _: self._guarded(self._keep))
        c.let_go.on_click(lambda _: self._guarded(self._let_go))
        c.fail.on_click(lambda _: self._guarded(self._fail))
        c.heal.on_click(lambda _: self._guarded(self._heal))
        c.renew.on_click(lambda _: self._guarded(self._lay_map))
        if c.recorded is not None:
            c.recorded.connect(self._guarded, self._happen_again)
        self._pick()

    def _on(self, handle: Any, act: Callable[[], None]) -> None:
        """Act on changes from a browser, not on those made by the page itself."""

        def react(event: Any) -> None:
            if event.client is not None:
                self._guarded(act)

        handle.on_update(react)

    def _guarded(self, act: Callable[..., None], *given: Any) -> None:
        """Execute a user action; on an error, show it and restore the controls."""
        try:
            with self.lock:
                act(*given)
        except GracefulPlanError as error:
            self._complain(error)
            with self.lock:
                self._place_handles()
                self._offer_move()

    def _complain(self, error: Exception) -> None:
        if not isinstance(error, GracefulPlanError):
            _log.error("the viewer failed", exc_info=error)
        for client in self.server.get_clients().values():
            client.add_notification("This cannot be done", str(error), color="red", auto_close_seconds=12.0)

    def _ask(self, question: Question) -> None:
        self._asked_first = True
        self.state.ask(question)
        if question.scene is not self.stage.drawn:
            self._draw()
        self._say(busy=True)

    def _changed(self, change: Change, X_W: Array) -> None:
        """Apply a change of start, goal or entity pose."""
        self._ask(change(self.state.question, X_W))
        self._place_handles()

    def _place_handles(self) -> None:
        self.handles.place(self.state.question, self._handles_wanted)

    def _show_handles(self) -> None:
        self.handles.show(self._handles_wanted)

    @property
    def _handles_wanted(self) -> bool:
        """Whether to show handles; not before the first answer, so that the first picture appears sooner."""
        return bool(self.controls.handles.value) and self.state.answer is not None

    # --- entities -----------------------------------------------------------------------------------------------------

    def _set_scene(self) -> None:
        scene = self.state.question.scene
        self.stage.set_scene(self.state.question)
        self.controls.offer(tuple(scene.entities), faults_of(scene))
        self._pick()

    def _pick(self) -> None:
        scene, c = self.state.question.scene, self.controls
        if c.entity.value in scene.entities:
            c.severity.value = float(max(scene.entities[c.entity.value].severity.values(), default=0.0))
        self._offer_move()

    def _set_severity(self) -> None:
        c = self.controls
        self._ask(self.state.question.with_severity(c.entity.value, float(c.severity.value)))

    def _offer_move(self) -> None:
        name, question = self.controls.entity.value, self.state.question
        wanted = self.controls.move.value and name in question.scene.entities
        self.handles.offer(name, question.entity_pose(name) if wanted else None)

    # --- answers ------------------------------------------------------------------------------------------------------

    def _answered(self) -> None:
        self._draw()
        self._say(busy=False)

    def _draw(self) -> None:
        """Redraw everything that depends on the answer or the scene."""
        if self.state.question.scene is not self.stage.drawn:
            self._set_scene()
        self.controls.heal.visible = self.state.replay is not None
        self._show_handles()
        self.stage.set_chart(self.state.motion)
        self.draw_plans()
        self.player.seek(self.player.t)
        self._lay_map()

    def _not_answered(self, error: Exception) -> None:
        self._complain(error)
        with self.lock:
            self._say(busy=False)

    def draw_plans(self) -> None:
        """Draw the motions in the selected display mode."""
        self.stage.set_plans(self.state)
        self._show(self.player.t)

    def _keep(self) -> None:
        self.state.keep()
        self._kept_others()

    def _let_go(self) -> None:
        self.state.let_go()
        self._kept_others()

    def _kept_others(self) -> None:
        """Update the display of kept motions."""
        self.controls.let_go.visible = bool(self.state.kept)
        self.draw_plans()
        self._say(busy=not self.state.worker.idle)

    def _lay_map(self) -> None:
        wanted = self.controls.risk_map.value
        self.controls.renew.disabled = not wanted
        self.stage.lay(self.state.layer(self.player.t) if wanted else None)

    def _show(self, t: float, words_too: bool = True) -> None:
        self.stage.show(self.state, t, words_too)

    def _say(self, *, busy: bool) -> None:
        c, failure = self.controls, words.failure_words(self.state.replay, self.state.motion)
        c.plan_text.content = words.plan_words(self.state.answer, self.state.kept, busy=busy)
        c.failure_text.content = failure
        if c.recorded is not None:
            c.recorded.tell(failure if self.state.replay is not None else "")

    # --- failures -----------------------------------------------------------------------------------------------------

    def _fail(self) -> None:
        c = self.controls
        failure = Failure(fault=c.fault.value, degree=c.degree.value, moment=c.moment.value / 100.0)
        self._watch(self.state.fail(failure))

    def _happen_again(self, number: int) -> None:
        """Simulate and show a rollout of the dataset on its motion."""
        recorded, before, c = self.controls.recorded, self.state.question, self.controls
        if recorded is None:
            return
        replay = self.state.happen_again(recorded.rollouts, number)
        if self.state.question is not before:
            self._draw()
            self._place_handles()
            c.w.max, c.w.value = max(c.w.max, self.state.question.w), self.state.question.w
        self._watch(replay)

    def _watch(self, replay: Replay) -> None:
        self.controls.heal.visible = True
        self.player.seek(max(0.0, replay.onset - 0.3))
        self._say(busy=not self.state.worker.idle)
        self.player.toggle(True)

    def _heal(self) -> None:
        self.state.forget()
        self.controls.heal.visible = False
        self.player.seek(self.player.t)
        self._say(busy=not self.state.worker.idle)
