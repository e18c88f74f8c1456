"""Each value that once broke a reader, at each place of each document: read as a number, or refused by name."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jaxtyping import TypeCheckError

import graceful_plan as gp
from failbench.sweeps.definition import Sweep, SweepMotion
from graceful_plan import documents
from graceful_plan.compare.runs.records import Run
from graceful_plan.compare.runs.runner import RAISED
from graceful_plan.exceptions import FormatError
from graceful_plan.result import Check, CostBreakdown, PlanStatus, Verdict
from graceful_plan.tuning.points import ParetoPoint

Document = dict[str, Any]

_Q = np.array([[0.0, 0.0], [1.0, 1.0]])
_MOTION = gp.Trajectory(np.array([0.0, 1.0]), _Q, 0.0 * _Q, 0.0 * _Q, ("a", "b"))
_COST = CostBreakdown(motion=1.0, impact=2.0, impact_by_entity={"vase": 2.0}, impact_by_component={"carried": 2.0})
_VERDICT = Verdict(checks={"collision": Check(passed=True, worst=0.1, limit=0.0, first=0.5, detail="none")})
_FRONT = gp.ParetoFront(
    status=PlanStatus.SOLVED,
    scene="nowhere",
    stats={"seconds": 1.0},
    points=(
        ParetoPoint(
            path=gp.Path(_Q), trajectory=_MOTION, cost=_COST, verdict=_VERDICT, made_by="weight", made_with=1.0
        ),
    ),
)
_SWEEP = Sweep(
    motions=(SweepMotion(name="a", scene="tabletop", task="right_to_left", trajectory=_MOTION),),
    faults=({"fault": "gripper_failure"},),
    rollouts=2,
)
_RUN = Run(
    problem="a", planner="b", seed=0, status=RAISED, early=(1.0, 2.0), path=((0.0, 1.0),), times=(0.0,),
    velocities=((0.0, 0.0),),
)  # fmt: skip


def _run(file: Path) -> Run:
    return Run.from_document(json.loads(file.read_text()), str(file))


def _front(file: Path) -> list[Any]:
    found = gp.ParetoFront.load(file)
    return [x for p in found.points for x in (p.path.q, p.trajectory.t, p.trajectory.q, p.cost.motion, p.cost.impact)]


_READERS: dict[str, tuple[Document, Callable[[Path], Any]]] = {
    "trajectory": (json.loads(_MOTION.to_json()), lambda file: gp.Trajectory.from_json(file).q),
    "trajectory as a motion": (json.loads(_MOTION.to_json()), lambda file: documents.read_motion(file).q),
    "path": (documents.path_document(gp.Path(_Q)), lambda file: documents.read_motion(file).q),
    "front": (json.loads(_FRONT.to_json()), _front),
    "sweep": (_SWEEP.to_document(), lambda file: Sweep.from_json(file).horizon),
    "run": (json.loads(_RUN.to_json()), _run),
    "ROS": (_MOTION.to_ros(), lambda file: gp.Trajectory.from_ros(file).q),
}
_VALUES = {
    "a number of 400 digits": 10**400,
    "less than any double": -(10**400),
    "2^70": 2**70,
    "almost infinite": 1e308,
    "not a number": float("nan"),
    "infinity": float("inf"),
    "480 lists": json.loads("[" * 480 + "]" * 480),
    "480 objects": json.loads('{"a":' * 480 + "1" + "}" * 480),
    "a lone surrogate": "\ud800",
    "a null byte": "a\0b",
    "nothing": None,
    "true": True,
    "an empty list": [],
    "an empty object": {},
    "lists in a list": [[[1.0]]],
}


def _places(document: Any, place: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield every place of a document; only the first item of a list."""
    yield place
    if isinstance(document, dict):
        for key in document:
            yield from _places(document[key], (*place, key))
    elif isinstance(document, list) and document:
        yield from _places(document[0], (*place, 0))


def _with(document: Any, place: tuple[Any, ...], value: Any) -> Any:
    """Return a document with another value at a place."""
    if not place:
        return value
    inside = dict(document) if isinstance(document, dict) else list(document)
    inside[place[0]] = _with(inside[place[0]], place[1:], value)
    return inside


@pytest.mark.long
@pytest.mark.parametrize("name", _READERS)
def test_values_that_broke_a_reader_break_none(name: str, tmp_path: Path) -> None:
    document, read = _READERS[name]
    file = tmp_path / ("motion.yaml" if name == "ROS" else "document.json")
    file.write_text(json.dumps(document))
    read(file)  # unchanged, it can be read
    refused = 0
    for place in _places(document):
        for value in _VALUES.values():
            file.write_text(json.dumps(_with(document, place, value)))
            try:
                found = read(file)
            except (gp.GracefulPlanError, TypeCheckError) as error:  # type errors occur only in tests
                assert str(error)
                refused += 1
                continue
            if name != "run":  # NaN stands for missing measurements of a run
                assert all(np.isfinite(numbers).all() for numbers in (found if name == "front" else [found]))
    assert refused > 30


@pytest.mark.parametrize("text", ["[" * 480 + "]" * 480, "[" * 100_000, '{"a":' * 480, "- " * 480, "\0", "\ud800", ""])
def test_texts_that_are_nothing(text: str, tmp_path: Path) -> None:
    for name, (_, read) in _READERS.items():
        file = tmp_path / ("motion.yaml" if name == "ROS" else "document.json")
        file.write_bytes(text.encode("utf-8", errors="surrogatepass"))
        if name == "run":
            continue
        with pytest.raises(gp.GracefulPlanError) as caught:
            read(file)
        assert not isinstance(caught.value, FormatError) or str(file) in str(caught.value)
