"""Entry point: ask a model about the entities of a scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from graceful_plan.annotation.annotations import Annotation, Annotations
from graceful_plan.annotation.answers import read_answer
from graceful_plan.annotation.endpoint import Endpoint
from graceful_plan.annotation.questions import complaint, question
from graceful_plan.exceptions import AnnotationError, SceneError, SettingError
from graceful_plan.path import is_whole
from graceful_plan.scene.scene import Scene
from graceful_plan.viz.entity_views import entity_views

_REPEATED = 20_000
"""Maximum number of characters of an unusable answer that are sent back with its problems."""


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
    """Ask a language or vision-language model for the severities of the entities of a scene.

    Names, sizes and pictures of the entities, and the description of the scene, are sent to the endpoint. Nothing is
    sent unless this function is called. The answer is an estimate: save it, review it, correct it, then apply it.

    Args:
        scene: Scene with the entities. Moving entities and the carried object are left out.
        model: Name of the model at the endpoint.
        endpoint: Base URL of an OpenAI-compatible server, such as "http://localhost:8000/v1".
        key_variable: Name of the environment variable with the API key, if the server needs one.
        pictures: Whether to send pictures. Without off-screen OpenGL none are sent, and `Annotations.pictures` is
            False.
        timeout: Time limit for each answer [s].
        together: Number of entities per request.

    Returns:
        Class, fragility, significance and severities of every entity, with reasons.

    Raises:
        EndpointError: If a request fails.
        AnnotationError: If an answer is unusable, and so is the second one after a list of its problems.
        SettingError: If a setting is invalid.
        SceneError: If the scene has no entities.
    """
    server = Endpoint(url=endpoint, model=model, key_variable=key_variable, timeout=timeout)
    if not is_whole(together) or together < 1:
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
    """Ask about some entities, and repeat the question once if the answer is unusable."""
    messages = question(scene, names, views)
    answer = server.ask(messages)
    try:
        return _read(server, answer, names, scene)
    except AnnotationError as error:
        again = complaint(answer[:_REPEATED], error.problems)
    return _read(server, server.ask([*messages, *again]), names, scene)


def _read(server: Endpoint, answer: str, names: Sequence[str], scene: Scene) -> dict[str, Annotation]:
    """Read an answer; no text that is kept or shown contains the key."""
    try:
        rows = read_answer(answer, names, scene.notes.severity)
    except AnnotationError as error:
        raise AnnotationError(map(server.without_key, error.problems)) from None
    return {name: replace(row, reason=server.without_key(row.reason)) for name, row in rows.items()}
