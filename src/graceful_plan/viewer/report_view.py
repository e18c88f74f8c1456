"""3-D view for a report: a motion with an ordinary one as a ghost, as a self-contained HTML document."""

from __future__ import annotations

import importlib.util

from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.objective import Objective, evaluate
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import Trajectory
from graceful_plan.viewer.question import CHOSEN, ORDINARY, PlanAnswer, Question
from graceful_plan.viewer.shown import ShownMotion, shown_motion

MOST = 12e6
"""Maximum number of characters of a document; large meshes would make reports too large to send."""


def report_view(
    motion: Trajectory, scene: Scene, ordinary: Trajectory | None = None, label: str = ORDINARY
) -> tuple[str, str]:
    """Return a document with a motion in 3-D and an empty text, or else an empty document and the reason.

    Args:
        motion: The motion.
        scene: Its scene, with the carried object attached.
        ordinary: Motion shown as a ghost.
        label: Label of the ghost.
    """
    if importlib.util.find_spec("viser") is None:
        return "", "the extra 'viz' shows it in 3-D: pip install 'graceful-plan[viz]'"
    from graceful_plan.viewer.browser.embedded import embedded

    question = Question(scene=scene, start=motion.q[0].copy(), goal=motion.q[-1].copy())
    plain = None if ordinary is None else _shown(label, ordinary, scene)
    answer = PlanAnswer(
        question=question, chosen=_shown(CHOSEN, motion, scene), ordinary=plain, said=("", "not planned")
    )
    document = embedded(answer)
    if len(document) > MOST:
        return "", f"in 3-D it would take {len(document) / 1e6:.0f} MB; `graceful-plan view` shows it"
    return document, ""


def _shown(label: str, motion: Trajectory, scene: Scene) -> ShownMotion:
    return shown_motion(label, motion, scene, ImpactCost(), evaluate(motion, scene, Objective()))
