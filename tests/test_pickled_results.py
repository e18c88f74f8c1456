"""Results of every kind reach the caller from another process; what refers to a scene says that it cannot."""

import pickle
from enum import Enum

import numpy as np
import pytest

import failbench
import graceful_plan as gp
from graceful_plan.annotation.annotations import Annotation, Annotations

_ROW = Annotation(category="human", fragility=2.0, significance=1.0, severity={"arm": 5.0})


@pytest.fixture(scope="module")
def task():
    return gp.load_scene("tabletop").tasks["lift_to_goal"]


@pytest.fixture(scope="module")
def result(task):
    return gp.plan(task.start, task.goal, task.scene, w=0.0, iterations=30)


@pytest.fixture(scope="module")
def roadmap(task):
    return gp.Roadmap.build(task.scene, nodes=40, motions=[(task.start, task.goal)])


_RESULTS = {
    "plan": lambda task, result, roadmap: result,
    "cost": lambda task, result, roadmap: gp.evaluate(result.unwrap(), task.scene),
    "verdict": lambda task, result, roadmap: gp.verify(result.unwrap(), task.scene),
    "certificate": lambda task, result, roadmap: gp.certify(result.unwrap(), task.scene),
    "explanation": lambda task, result, roadmap: gp.explain(result.unwrap(), task.scene),
    "risk": lambda task, result, roadmap: gp.risk(result.unwrap(), task.scene),
    "front": lambda task, result, roadmap: gp.pareto(task.start, task.goal, task.scene, points=2, iterations=5),
    "map": lambda task, result, roadmap: gp.impact_map(task.scene, height=0.2, resolution=0.2),
    "query": lambda task, result, roadmap: roadmap.query(task.start, task.goal),
    "paths": lambda task, result, roadmap: roadmap.front(task.start, task.goal),
    "limits": lambda task, result, roadmap: task.scene.limits,
    "report": lambda task, result, roadmap: failbench.validate(result, task.scene, n=2, horizon=0.1),
    "annotations": lambda *_: Annotations(scene="a", model="b", endpoint="c", pictures=False, rows={"mug": _ROW}),
    "severity": lambda task, result, roadmap: task.scene.notes.severity,
}


def plain(value):
    """Return nested fields as lists, so that arrays compare."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if hasattr(value, "__dict__") and not isinstance(value, Enum):
        return type(value), plain(vars(value))
    if isinstance(value, dict) or hasattr(value, "keys"):
        return {key: plain(item) for key, item in value.items()}
    return [plain(item) for item in value] if isinstance(value, list | tuple) else value


@pytest.mark.parametrize("kind", _RESULTS)
def test_results_survive_pickling(kind, task, result, roadmap):
    there = _RESULTS[kind](task, result, roadmap)
    again = pickle.loads(pickle.dumps(there))
    assert type(again) is type(there)
    assert str(plain(again)) == str(plain(there))


def test_a_roadmap_says_why_it_cannot_be_pickled(roadmap):
    with pytest.raises(TypeError, match=r"Roadmap.*'tabletop'.*build.*in each process"):
        pickle.dumps(roadmap)
