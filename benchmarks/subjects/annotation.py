"""Severities that a model estimates, beside those that the bundled scenes have."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Generator

import graceful_plan as gp
from benchmarks import report, suite
from benchmarks.model_server import ModelServer, guesses
from graceful_plan.annotation.agreement import Agreement, compared
from graceful_plan.exceptions import AnnotationError, EndpointError

TITLE = "Severities from language models"
MEASURED = """\
`gp.annotate` on the bundled scenes: class, fragility and severities of every entity, beside the classes and
severities that the scene has. The model is asked at the endpoint of `ANNOTATE_ENDPOINT`, by the name in
`ANNOTATE_MODEL`; it is not told the rows of the shipped table. Without these variables there is no model: a stand-in
answers on this machine, which takes the first class with a word of its list in the entity's name, and the shipped row
of that class. Its rows are therefore exact whenever its class is and the scene has no numbers of its own, which no
model's are, and whoever wrote the list knew these scenes; its figures say that the way there and back works, and
nothing about any model.
"""
STAND_IN = "no model: names looked up in a list of words"


def run(options: suite.Options) -> str:
    """Ask about all scenes, and return Markdown."""
    names = ("desk",) if options.quick else (*gp.scenes(), *gp.mobile_scenes())
    with _asked() as (url, model, key):
        rows = [_row(name, url, model, key) for name in names]
    asked = STAND_IN if model == STAND_IN else f"`{model}`"
    return f"{MEASURED}\nAsked: {asked}.\n\n{report.table(_HEAD, rows)}"


_HEAD = (
    "scene",
    "pictures",
    "entities",
    "same class",
    "same row",
    "severities within a factor of 2",
    "rank correlation of severities",
)


@contextlib.contextmanager
def _asked() -> Generator[tuple[str, str, str | None]]:
    """Give endpoint, model and the name of the variable with its key; a stand-in if none is named."""
    url = os.environ.get("ANNOTATE_ENDPOINT")
    if url:
        yield url, os.environ.get("ANNOTATE_MODEL", ""), os.environ.get("ANNOTATE_KEY_VARIABLE")
        return
    with ModelServer(guesses) as server:
        yield server.url, STAND_IN, None


def _row(name: str, url: str, model: str, key: str | None) -> tuple[str, ...]:
    scene = suite.scene(name)
    try:
        said = gp.annotate(scene, model, endpoint=url, key_variable=key, timeout=300.0)
    except (AnnotationError, EndpointError) as error:
        return name, "", str(len(scene.entities)), f"no answer: {error}", "", "", ""
    found: Agreement = compared(said, scene)
    ranks = "" if found.rank_correlation is None else f"{found.rank_correlation:.2f}"
    return (
        name,
        "yes" if said.pictures else "no",
        str(found.entities),
        f"{found.same_class:.0%}",
        f"{found.same_row:.0%}",
        f"{found.within_two:.0%}",
        ranks,
    )
