"""Opening of the viewer: converts its arguments to a request and, for a given motion, an answer."""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Sequence
from pathlib import Path as FilePath
from types import TracebackType
from typing import TYPE_CHECKING, cast, final

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.objective import DEFAULT_WEIGHT, Objective, evaluate
from graceful_plan.exceptions import GracefulPlanError, SettingError, UnknownNameError
from graceful_plan.path import Path, finite_array
from graceful_plan.query.endpoints.configurations import Configuration, configurations_of
from graceful_plan.query.endpoints.goals import Goal, has_poses
from graceful_plan.result import PlanResult
from graceful_plan.scene.loading.bundled import load_scene, mobile_scenes, scenes
from graceful_plan.scene.mobile.base_pose import BasePose
from graceful_plan.scene.scene import Scene, Task
from graceful_plan.setting_checks import positive
from graceful_plan.timing.retiming import retime
from graceful_plan.timing.trajectory import Trajectory
from graceful_plan.viewer.question import CHOSEN, DRIVING_LIMIT, TIME_LIMIT, PlanAnswer, Question
from graceful_plan.viewer.recorded import RecordedRollouts
from graceful_plan.viewer.shown import shown_motion

if TYPE_CHECKING:
    from graceful_plan.viewer.browser.page import Page

PORT = 8080
HOST = "127.0.0.1"


class ViewerMissing(GracefulPlanError, ImportError):
    """viser is not installed."""

    def __init__(self) -> None:
        super().__init__("the viewer needs viser, which the extra 'viz' installs: pip install '.[viz]'")


@final
class Viewer:
    """A page, served until it is closed or the program ends."""

    def __init__(self, page: Page) -> None:
        self._page = page

    @property
    def url(self) -> str:
        """Address of the page."""
        return self._page.url

    def wait(self) -> None:
        """Serve the page until interrupted."""
        while True:
            time.sleep(1.0)

    def close(self) -> None:
        """Stop serving the page."""
        self._page.close()

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()


def view(
    what: str | FilePath | Scene | Task | PlanResult | Trajectory | Path = "tabletop",
    scene: Scene | Task | None = None,
    *,
    task: str | None = None,
    start: ArrayLike | str | None = None,
    goal: Goal | None = None,
    w: float = DEFAULT_WEIGHT,
    objective: Objective | None = None,
    time_limit: float | None = None,
    host: str = HOST,
    port: int = PORT,
    dark: bool = False,
) -> Viewer:
    """Open a page with a scene and its motions: impact along them, interactive replanning, failures.

    Args:
        what: A scene, its name or file, a task; a motion, such as the result of `plan`; or the folder of a FailBench
            dataset, whose rollouts are selected on the page. All settings but `time_limit` then come from the dataset.
        scene: Scene of a motion.
        task: Task of the scene; its first one by default.
        start: Start configuration or keyframe; that of the task by default.
        goal: Goal, as in `plan`; that of the task by default.
        w: Initial safety weight. The motion for w = 0 is always shown, too.
        objective: Objective with the impact cost, if not the default one; its `w` and motion cost are not used.
        time_limit: Time limit for each motion [s]; 1 by default, 5 for robots that drive.
        host: Address to listen at; by default, only this machine can open the page.
        port: Port to listen at; the next free one if it is taken.
        dark: Whether the page is dark.

    Returns:
        The viewer, with the address of the page as `url`. It runs until `close()` or the end of the program.

    Raises:
        ViewerMissing: If viser is not installed; it is in the extra "viz".
        UnknownNameError: If the scene, task or keyframe does not exist.
        SettingError: If there is neither a task nor start and goal, or a motion comes without its scene.
        PlanningFailed: If `what` is the result of a failed plan.
        FormatError: If a dataset is unfinished or damaged.
    """
    if importlib.util.find_spec("viser") is None:
        raise ViewerMissing
    rollouts = None
    if isinstance(what, str | FilePath) and what not in (*scenes(), *mobile_scenes()) and FilePath(what).is_dir():
        rollouts = RecordedRollouts(FilePath(what), TIME_LIMIT if time_limit is None else time_limit)
        question, answer = rollouts.shown(int(rollouts.worst_first()[0]))
    else:
        question, answer = asked(
            what, scene, task=task, start=start, goal=goal, w=w, objective=objective, time_limit=time_limit
        )
    from graceful_plan.viewer.browser.page import Page

    return Viewer(Page(question, answer, host=host, port=port, dark=dark, rollouts=rollouts))


def asked(
    what: str | FilePath | Scene | Task | PlanResult | Trajectory | Path,
    scene: Scene | Task | None = None,
    *,
    task: str | None = None,
    start: ArrayLike | str | None = None,
    goal: Goal | None = None,
    w: float = DEFAULT_WEIGHT,
    objective: Objective | None = None,
    time_limit: float | None = None,
) -> tuple[Question, PlanAnswer | None]:
    """Return the initial request of `view`, and the answer if a motion is given."""
    objective = (objective or Objective()).with_weight(w)
    if not isinstance(objective.impact, ImpactCost):
        raise SettingError("objective.impact", objective.impact, "an ImpactCost: other costs name no entities")
    if isinstance(what, PlanResult | Trajectory | Path):
        if scene is None:
            raise SettingError("scene", None, "the scene of the motion")
        place = scene.scene if isinstance(scene, Task) else scene
        if not isinstance(place, Scene):
            raise SettingError("scene", scene, "the Scene or Task of the motion")
        motion = _timed(what, place)
        question = Question(
            scene=place,
            start=np.array(motion.q[0]),
            goal=np.array(motion.q[-1]),
            w=w,
            impact=objective.impact,
            time_limit=_limit(time_limit, place),
        )
        cost = evaluate(motion, place, objective)
        shown = shown_motion(CHOSEN, motion, place, question.impact, cost)
        return question, PlanAnswer(question=question, chosen=shown, ordinary=None, said=("", "not planned yet"))
    place, begin, end = _ends(what, task, start, goal)
    question = Question(
        scene=place, start=begin, goal=end, w=w, impact=objective.impact, time_limit=_limit(time_limit, place)
    )
    return question, None


def _timed(what: PlanResult | Trajectory | Path, scene: Scene) -> Trajectory:
    if isinstance(what, PlanResult):
        return what.unwrap()
    return what if isinstance(what, Trajectory) else retime(what, scene.limits, scene.joints)


def _limit(given: float | None, scene: Scene) -> float:
    if given is not None:
        positive("time_limit", given, "a finite time above 0 s")
        return given
    return TIME_LIMIT if scene.base is None else DRIVING_LIMIT


def _ends(
    what: str | FilePath | Scene | Task, task: str | None, start: ArrayLike | str | None, goal: Goal | None
) -> tuple[Scene, np.ndarray, Goal]:
    """Return the scene with the carried object, a start and a goal."""
    chosen = what if isinstance(what, Task) else None
    scene = chosen.scene if chosen is not None else what if isinstance(what, Scene) else load_scene(str(what))
    if chosen is None and scene.tasks and (task is not None or start is None or goal is None):
        name = next(iter(scene.tasks)) if task is None else task
        if name not in scene.tasks:
            raise UnknownNameError("task", name, scene.tasks)
        chosen = scene.tasks[name]
        scene = chosen.scene
    if chosen is not None:
        start, goal = chosen.start if start is None else start, chosen.goal if goal is None else goal
    if start is None or goal is None:
        missing = "start" if start is None else "goal"
        raise SettingError(missing, None, "a configuration or the name of a keyframe: the scene has no tasks")
    if isinstance(start, str):
        if start not in scene.keyframes:
            raise UnknownNameError("keyframe", start, scene.keyframes)
        start = scene.keyframes[start]
    if not isinstance(goal, BasePose) and not has_poses(goal):
        configurations_of(cast("Configuration | Sequence[Configuration]", goal), scene)
    return scene, finite_array("start", start, ndim=1, last=len(scene.joints)), goal
