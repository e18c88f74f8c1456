"""The page: what is asked there goes to the state, and what the state says is drawn."""

from __future__ import annotations

import contextlib
import importlib
import io
import logging
import threading
import time
from collections.abc import Callable
from typing import Any, final

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.exceptions import GracefulPlanError
from graceful_plan.scene.scene import Scene
from graceful_plan.viewer.browser import marks, words
from graceful_plan.viewer.browser.chart import ImpactChart
from graceful_plan.viewer.browser.controls import BESIDE, GHOST, HIDDEN, build
from graceful_plan.viewer.browser.drawn_scene import DrawnScene
from graceful_plan.viewer.failing import Failure, faults_of
from graceful_plan.viewer.poses import pose_of, poses_along, quaternion_of
from graceful_plan.viewer.question import PlanAnswer, Question
from graceful_plan.viewer.shapes import parts
from graceful_plan.viewer.state import ViewerState

Array = np.ndarray

_RATE = 30.0
"""Frames per second while it plays."""
_WORDS_RATE = 6.0
"""Times per second that text and chart change meanwhile: they cost the browser more than poses."""
_GAP = 0.4
"""Between two copies of the scene [m]."""
_ASIDE = 0.35
"""How far the camera stands beside the line from the robot to what it does, as an angle [rad]; also a distance [m]."""
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
    """

    def __init__(
        self, question: Question, answer: PlanAnswer | None, *, host: str, port: int, dark: bool = False
    ) -> None:
        viser: Any = importlib.import_module("viser")
        with contextlib.redirect_stdout(io.StringIO()):  # it greets on the terminal
            self.server: Any = viser.ViserServer(host=host, port=port, label="graceful_plan", verbose=False)
        self._lock = threading.RLock()
        self.state = ViewerState(question, self._answered, self._not_answered, answer)
        self._t, self._playing, self._closed, self._said_at = 0.0, False, threading.Event(), 0.0
        self._asked_first = False
        self._stage = self._other = self._chart = self._layer = self._entity_handle = None
        self._shifted = np.zeros(3)
        self._paths: list[Any] = []
        self._labels: list[Any] = []
        self._theme(dark)
        self.server.scene.configure_environment_map(None)
        self.server.scene.configure_default_lights(cast_shadow=False)
        self._look(question)
        self._controls = build(
            self.server,
            w=question.w,
            entities=tuple(question.scene.entities),
            faults=faults_of(question.scene),
            dark=dark,
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

    @property
    def url(self) -> str:
        """Where the page is."""
        host = self.server.get_host()
        return f"http://{'localhost' if host in ('0.0.0.0', '127.0.0.1') else host}:{self.server.get_port()}"

    def close(self) -> None:
        """Stop serving the page."""
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

    def _look(self, question: Question) -> None:
        """Put the camera where start, goal and what stands between them are seen."""
        ends = np.stack([question.handle_pose(question.start)[:3, 3], question.goal_pose()[:3, 3]])
        middle, way = ends.mean(axis=0), ends[1] - ends[0]
        length = float(np.linalg.norm(way))
        if question.scene.base is not None:  # from above the walls, the way from left to right
            yaw, out, up, far = float(np.arctan2(way[1], way[0])) - 0.5 * np.pi, 0.45, 0.9, 2.0 + 0.75 * length
        else:
            ahead = middle - _base(question)
            yaw = float(np.arctan2(ahead[1], ahead[0])) + _ASIDE if np.hypot(*ahead[:2]) > _ASIDE else -0.8
            out, up, far = 1.0, 0.7, max(1.2, 1.2 * length)
        camera = self.server.initial_camera
        camera.look_at, camera.up = middle, (0.0, 0.0, 1.0)
        camera.position = middle + far * np.array([out * np.cos(yaw), out * np.sin(yaw), up])
        self._right = np.array([-np.sin(yaw), np.cos(yaw), 0.0])
        self.server.gui.main_panel.dock_right()
        self.server.gui.main_panel.set_width(360)

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
            self._controls.heal.visible = False
            self._show_handles()
            self._draw_plans()
            self._new_chart()
            self._seek(min(self._t, self.state.duration))
            self._lay_map()
            self._say(busy=False)

    def _draw_plans(self) -> None:
        """Draw the paths, and the ordinary motion as it is to be shown."""
        answer, how = self.state.answer, self._controls.other.value
        for path in self._paths:
            path.remove()
        self._paths = []
        if self._other is not None:
            self._other.remove()
            self._other = None
        if answer is None:
            return
        shift = self._shift() if how == BESIDE else np.zeros(3)
        self._step_back(shift)
        greatest = marks.greatest_risk(answer.motions)
        if answer.chosen is not None:
            self._paths.append(marks.add_path(self.server, "/path", answer.chosen, greatest, thickness=0.012))
        if answer.ordinary is not None and how != HIDDEN and answer.chosen is not None:
            ghost = how == GHOST
            self._other = DrawnScene(
                self.server,
                "/other",
                answer.ordinary.scene,
                opacity=0.3 if ghost else 1.0,
                shift=shift,
                only_moving=ghost,
            )
            path = marks.add_path(self.server, "/other/path", answer.ordinary, greatest, thickness=0.006)
            middle = answer.ordinary.tool[len(answer.ordinary.tool) // 2]
            self._paths += [path, self.server.scene.add_label("/other/label", "w = 0", position=middle)]
        self._show(self._t)

    def _shift(self) -> Float[Array, " 3"]:
        """Where the second copy of the scene stands: along x or y, as seen first to the right."""
        axis = int(np.argmax(np.abs(self._right)))
        return (_extent(self.state.question.scene)[axis] + _GAP) * np.sign(self._right[axis]) * np.eye(3)[axis]

    def _step_back(self, shift: Float[Array, " 3"]) -> None:
        """Move all cameras so that a second copy of the scene is seen too, or back if there is none any more."""
        more, farther = shift - self._shifted, float(np.linalg.norm(shift) - np.linalg.norm(self._shifted))
        self._shifted = shift
        if not more.any():
            return
        for client in self.server.get_clients().values():
            camera = client.camera
            position, target = np.asarray(camera.position), np.asarray(camera.look_at)
            back = (position - target) / np.linalg.norm(position - target)
            camera.position = position + 0.5 * more + 0.6 * farther * back
            camera.look_at = target + 0.5 * more

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
        replay = self.state.fail(failure)
        c.heal.visible = True
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
            if self._other is not None and moment.beside is not None:
                self._other.put(*moment.beside)
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


def _base(question: Question) -> Float[Array, " 3"]:
    """Where the robot's first joint is at the start, in W [m]."""
    scene = question.scene
    return np.array(scene.data_at(question.start).joint(scene.joints[0]).xanchor)


def _extent(scene: Scene) -> Float[Array, " 2"]:
    """Extent along x and y of what stands around [m], planes left out."""
    model, data = scene.model, scene.data_at(scene.model.qpos0[scene.qpos_adr])
    geoms = np.flatnonzero((model.geom_rbound > 0.0) & (model.geom_group < 3))
    R = data.geom_xmat[geoms].reshape(-1, 3, 3)
    centre = data.geom_xpos[geoms] + np.einsum("nij,nj->ni", R, model.geom_aabb[geoms, :3])
    half = np.einsum("nij,nj->ni", np.abs(R), model.geom_aabb[geoms, 3:])
    return np.asarray((centre + half).max(axis=0) - (centre - half).min(axis=0))[:2]
