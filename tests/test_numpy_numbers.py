"""NumPy numbers are as good as Python numbers everywhere; complex numbers and texts are refused."""

import dataclasses
import importlib
import inspect
import json
import pkgutil

import numpy as np
import pytest

import failbench
import graceful_plan as gp
import shape_checks
from failbench.recording.records import RolloutRequest
from graceful_plan import documents
from graceful_plan.annotation.annotations import Annotation
from graceful_plan.annotation.endpoint import Endpoint
from graceful_plan.compare.runs.comparison import settle
from graceful_plan.exceptions import FormatError, GracefulPlanError, ShapeError
from graceful_plan.formats.npz_file import read_arrays
from graceful_plan.path import finite_array, plain_numbers, real_array
from graceful_plan.planners import PLANNERS


@pytest.fixture(autouse=True)
def unchecked():
    """Call functions as users do, who do not run with checks of annotations."""
    with shape_checks.paused():
        yield


_NARROW = {float: np.float32, int: np.int64, bool: np.bool_}
_GIVEN = {
    "AxisWithin": {"axis": (0.0, 0.0, 1.0), "angle": 0.5},
    "KeepDistance": {"first": "arm", "second": "mug", "metres": 0.25},
    "ToolSpeed": {"limit": 0.5, "within": 0.25},
    "BasePose": {"x": 1.0, "y": 2, "yaw": 0.5},
    "AtTime": {"time": 0.5},
    "AtFraction": {"fraction": 0.5},
    "EntityAnnotation": {"category": "human", "severity": {"arm": 5.0, "hand": 2}},
    "Liquid": {"volume": 2e-4, "temperature": 60.0},
    "Granular": {"volume": 2e-4},
    "Annotation": {"category": "human", "fragility": 2.0, "significance": 1.0, "severity": {"arm": 5.0}},
    "Endpoint": {"url": "https://a/v1", "model": "b", "timeout": 2.0},
}
"""Arguments of settings that have no defaults for all of their numbers."""


def narrow(value):
    """Return a value with NumPy numbers in place of Python's."""
    if isinstance(value, tuple):
        items = tuple(narrow(item) for item in value)
        return value if all(a is b for a, b in zip(items, value, strict=True)) else items
    if isinstance(value, dict):
        return {key: narrow(item) for key, item in value.items()}
    return _NARROW[type(value)](value) if type(value) in _NARROW else value


def settings_classes():
    """Return the public settings, and all dataclasses of the packages that can be made without arguments."""
    found = {Annotation, Endpoint}
    for package in (gp, failbench):
        found |= {value for name in package.__all__ if inspect.isclass(value := getattr(package, name))}
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if not module.name.endswith("__main__"):
                try:
                    there = importlib.import_module(module.name)
                except ImportError:  # of an extra
                    continue
                found |= {value for value in vars(there).values() if inspect.isclass(value)}
    settings = (kind for kind in found if dataclasses.is_dataclass(kind) and hasattr(kind, "__post_init__"))
    return sorted(settings, key=lambda kind: kind.__qualname__)


def arguments(kind):
    """Return the numbers among the defaults and given arguments of settings; None if they need other arguments."""
    given = dict(_GIVEN.get(kind.__name__, {}))
    for field in dataclasses.fields(kind):
        default = field.default if field.default is not dataclasses.MISSING else None
        if field.init and narrow(default) is not default:
            given.setdefault(field.name, default)
    try:
        kind(**given)
    except (TypeError, GracefulPlanError):
        return None
    return given


def test_settings_hold_python_numbers():
    tried = 0
    for kind in settings_classes():
        given = arguments(kind)
        if not given:
            continue
        here, there = kind(**narrow(given)), kind(**given)
        for name in given:
            value, plain = getattr(here, name), getattr(there, name)
            assert type(value) is type(plain), f"{kind.__name__}.{name}"
            assert json.dumps(value, default=dict).count("[") == json.dumps(plain, default=dict).count("[")
        tried += 1
    assert tried > 70
    assert all(arguments(type(PLANNERS[name]())) for name in PLANNERS)


def test_plain_numbers_leaves_other_fields_alone():
    @dataclasses.dataclass(frozen=True)
    class Some:
        number: object
        nested: object
        array: object

        def __post_init__(self):
            plain_numbers(self)

    array = np.ones(2, np.float32)
    some = Some(np.float64(0.5), ("a", {"b": np.int32(3)}, True), array)
    assert type(some.number) is float and some.nested == ("a", {"b": 3}, True) and some.array is array
    assert type(some.nested[1]["b"]) is int


@pytest.fixture(scope="module")
def task():
    return gp.load_scene("tabletop").tasks["lift_to_goal"]


F, N = np.float32, np.int64
_CALLS = {
    "plan": lambda t: gp.plan(
        t.start, t.goal, t.scene, w=F(0.3), speed=F(0.5), iterations=N(5), time_limit=F(9), seed=N(1), max_wait=F(0)
    ),
    "evaluate": lambda t: gp.evaluate(gp.Path(np.float32([t.start, t.start])), t.scene, gp.Objective(w=N(1))),
    "front": lambda t: gp.pareto(t.start, t.goal, t.scene, points=N(2), iterations=N(3), seed=N(0)),
    "roadmap": lambda t: gp.Roadmap.build(t.scene, nodes=N(20), neighbours=N(4), motions=[], seed=N(0)),
    "resampled": lambda t: gp.Path(np.float32([t.start, t.start + 0.1])).resampled(F(0.1)),
    "sample": lambda t: _motion(t).sample(F(0.5)),
    "delayed": lambda t: _motion(t).delayed(N(1)),
    "verify": lambda t: gp.verify(_motion(t), t.scene, step=F(0.5)),
    "retime": lambda t: gp.retime(gp.Path([t.start, t.start + 0.1]), t.scene.limits, t.scene.joints, speed=F(0.5)),
    "severity": lambda t: t.scene.with_severity({"adult": F(5), "blue": {"carried": N(2)}}),
    "map": lambda t: gp.impact_map(t.scene, height=F(0.2), resolution=F(0.25), speed=N(0)),
    "risk": lambda t: gp.risk(_motion(t), t.scene, level=F(0.5)),
    "prior": lambda t: gp.FaultPrior({"weak_grip": F(0.5), "power_loss": N(1)}).weights(),
    "cloud": lambda t: gp.PointCloud(name="cloud", points=np.zeros((2, 3), np.float32), resolution=F(0.1)),
    "box": lambda t: t.scene.add_box("box", np.float32([0.1, 0.1, 0.1]), np.float32([0.0, 1.0, 1.0])),
    "ball": lambda t: t.scene.add_sphere("ball", F(0.1), np.eye(4, dtype=F)),
    "moving": lambda t: t.scene.with_moving(
        gp.MovingEntity(
            "walker", "adult", size=np.float32([0.2, 0.9]), t=[N(0)], position=[[F(3), F(0), F(1)]],
            spread=F(0.1), severity={"carried": F(3)},
        )
    ),
    "validate": lambda t: failbench.validate(
        _motion(t), t.scene, n=N(1), horizon=F(0.05), seed=N(0), rate=F(1e-3), confidence=F(0.9), threads=N(1)
    ),
    "job": lambda t: RolloutRequest(fault=failbench.faults()["weak_grip"](), onset=F(0.5), seed=N(3), weight=F(1)),
    "bench": lambda t: settle(seeds=N(2), seconds=F(2), w=F(0.5), processes=N(1)),
}  # fmt: skip


def _motion(task):
    return gp.retime(gp.Path([task.start, task.start + 0.1]), task.scene.limits, task.scene.joints)


@pytest.mark.parametrize("call", _CALLS)
def test_keyword_arguments_accept_numpy_numbers(call, task):
    _CALLS[call](task)


def test_documents_of_results_are_json(task):
    result = gp.plan(task.start, task.goal, task.scene, w=np.float32(0.3), iterations=np.int64(5))
    document = json.loads(json.dumps(documents.finite(documents.result_document(result))))
    assert document["cost"]["w"] == float(np.float32(0.3))


@pytest.mark.parametrize(
    "value",
    [
        np.ones(3, complex),
        np.ma.masked_array(np.ones(3, complex)),
        [1.0, 2.0 + 0j, 3.0],
        ["1", "2", "3"],
        np.array([b"1", b"2"]),
        np.array(["2020-01-01"], "datetime64[D]"),
        np.array([1], "timedelta64[s]"),
    ],
    ids=lambda value: str(getattr(value, "dtype", type(value).__name__)),
)
def test_arrays_of_other_values_are_refused(value):
    with pytest.raises(ShapeError, match="numbers in a rectangular array"):
        real_array("q", value)
    with pytest.raises(ShapeError):
        gp.Path([value])


def test_arrays_of_single_precision_are_accepted():
    np.testing.assert_array_equal(finite_array("q", np.float32([1, 2])), [1.0, 2.0])
    assert finite_array("q", np.float16([1, 2])).dtype == np.float64
    assert finite_array("q", [True, 2]).tolist() == [1.0, 2.0]


def test_complex_results_of_costs_are_refused(task):
    class Odd(gp.Cost):
        def state(self, batch):
            return np.ones(len(batch), complex)

    with pytest.raises(GracefulPlanError, match="complex128"):
        gp.evaluate(_motion(task), task.scene, gp.Objective(impact=Odd()))


def test_complex_arrays_in_files_are_refused(tmp_path):
    np.savez(tmp_path / "a.npz", w0=np.ones((2, 2), complex))
    with pytest.raises(FormatError, match=r"a\.npz.*complex128"):
        read_arrays(tmp_path / "a.npz")
