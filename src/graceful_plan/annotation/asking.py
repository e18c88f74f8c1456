"""The front door: ask a model about the entities of a scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from graceful_plan.annotation.annotations import Annotation, Annotations
from graceful_plan.annotation.answers import read_answer
from graceful_plan.annotation.endpoint import Endpoint
from graceful_plan.annotation.questions import complaint, question
from graceful_plan.exceptions import AnnotationError, SceneError, SettingError
from graceful_plan.scene.scene import Scene
from graceful_plan.viz.entity_views import entity_views

_REPEATED = 20_000
"""Characters of an answer that cannot be used that are sent back with what is wrong with it."""


def annotate(
    scene: Scene,
    model: str,
    *,
    endpoint: str,
    key_variable: str | None = None,
    pictures: bool = True,
    timeout: float = 60.0,
    together: int = 8,
) -> Annotations:
    """Ask a language or vision-language model how bad it is if the entities of a scene are reached.

    Names, sizes and pictures of the entities, and the description of the scene, go to the endpoint, and nothing goes
    anywhere unless this is called. What comes back is an estimate: save it, read it, change it, then apply it.

    Args:
        scene: Whose entities; those that move, and what is in the gripper, are not asked about.
        model: Name of the model at the endpoint.
        endpoint: Base URL of an OpenAI-compatible server, such as "http://localhost:8000/v1".
        key_variable: Name of the environment variable with the API key, if the server asks for one.
        pictures: Whether the model is shown pictures; where OpenGL does not work off-screen it is not, and
            `Annotations.pictures` says so.
        timeout: How long to wait for each answer [s].
        together: How many entities are asked about at once.

    Returns:
        Class, fragility, significance and severities of every entity, with reasons.

    Raises:
        EndpointError: If the model cannot be asked.
        AnnotationError: If an answer is not what was asked for, and the second one, after the complaint, neither.
        SettingError: If a setting makes no sense.
        SceneError: If the scene has no entities.
    """
    server = Endpoint(url=endpoint, model=model, key_variable=key_variable, timeout=timeout)
    if isinstance(together, bool) or not isinstance(together, int) or together < 1:
        raise SettingError("together", together, "a whole number of at least 1")
    names = list(scene.entities)
    if not names:
        raise SceneError(f"the scene {scene.name!r} has no entities to ask about")
    views = entity_views(scene, names) if pictures else None
    rows: dict[str, Annotation] = {}
    for first in range(0, len(names), together):
        rows |= _asked(server, scene, names[first : first + together], views)
    return Annotations(scene=scene.name, model=model, endpoint=server.name, pictures=views is not None, rows=rows)


def _asked(
    server: Endpoint, scene: Scene, names: Sequence[str], views: Mapping[str, Sequence[bytes]] | None
) -> dict[str, Annotation]:
    """Ask about some entities, and once again if the answer cannot be used."""
    messages = question(scene, names, views)
    answer = server.ask(messages)
    try:
        return read_answer(answer, names, scene.notes.severity)
    except AnnotationError as error:
        again = complaint(answer[:_REPEATED], error.problems)
    return read_answer(server.ask([*messages, *again]), names, scene.notes.severity)
