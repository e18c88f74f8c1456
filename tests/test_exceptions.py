"""Every exception of the packages survives pickling, so that a failure in another process reaches the caller."""

import importlib
import inspect
import pickle
import pkgutil
import typing
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import pytest

import failbench
import graceful_plan as gp
from failbench.recording.healthy import HealthyHarm
from graceful_plan.exceptions import (
    CostError,
    FormatError,
    GracefulPlanError,
    SettingError,
    UnknownNameError,
    names_file,
    naming,
)
from graceful_plan.job.job_result import JobResult, JobStatus
from graceful_plan.result import PlanningFailed, PlanResult, PlanStatus

_OPTIONAL = {"gymnasium", "matplotlib", "pyarrow", "ray", "selenium", "viser"}
"""Packages of extras: modules that need them are skipped without them."""
_EXAMPLES: dict[object, object] = {
    str: "some text",
    float: 0.5,
    int: 2,
    object: ("a", 1),
    Path: Path("a") / "b",
    PlanResult: PlanResult(status=PlanStatus.INFEASIBLE, detail="no way"),
    JobResult: JobResult(status=JobStatus.INFEASIBLE, detail="no grasp"),
    HealthyHarm: HealthyHarm(carried="mug", spilled=0.2, by_entity={"mug": 1.0}),
    tuple[str, ...]: ("b", "a"),
    tuple[int, ...]: (2, 3),
    Iterable[str]: ("b", "a"),
    Sequence[str]: ("b", "a"),
    str | None: "some text",
    int | None: 3,
    Any: 3.0,
}
"""Arguments by annotation."""


def exceptions():
    """Return all exception classes that the two packages define."""
    found = set()
    for package in (gp, failbench):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if module.name.endswith("__main__"):
                continue
            try:
                there = importlib.import_module(module.name)
            except ImportError as error:
                assert error.name and error.name.partition(".")[0] in _OPTIONAL, module.name
                continue
            found |= {
                value
                for value in vars(there).values()
                if inspect.isclass(value) and issubclass(value, BaseException) and value.__module__ == there.__name__
            }
    return sorted(found, key=lambda kind: (kind.__module__, kind.__qualname__))


def made(kind):
    """Return an instance whose arguments follow the annotations of the constructor."""
    if not inspect.isfunction(kind.__init__):  # that of a built-in exception
        return kind("some text")
    hints = typing.get_type_hints(kind.__init__)
    positional, named = [], {}
    for name, parameter in list(inspect.signature(kind.__init__).parameters.items())[1:]:
        value = _EXAMPLES[hints[name]]
        if parameter.kind is parameter.KEYWORD_ONLY:
            named[name] = value
        else:
            positional.append(value)
    return kind(*positional, **named)


def same(a, b):
    assert type(a) is type(b) and str(a) == str(b) and a.args == b.args
    assert str(vars(a)) == str(vars(b))
    for name in ("msg", "name", "strerror"):  # of ImportError and OSError
        assert getattr(a, name, None) == getattr(b, name, None)


def test_every_exception_survives_pickling():
    kinds = exceptions()
    assert {PlanningFailed, UnknownNameError, failbench.ExecutionRefused} <= set(kinds)
    for kind in kinds:
        error = made(kind)
        error.add_note("during the third motion")
        same(pickle.loads(pickle.dumps(error)), error)


def test_an_attribute_that_cannot_be_pickled_becomes_text():
    again = pickle.loads(pickle.dumps(CostError(lambda q: q, "it is negative")))
    assert "lambda" in again.cost
    assert str(again) == "function: it is negative" and again.problem == "it is negative"


def _job(k):
    if k == 1:
        return PlanResult(status=PlanStatus.INFEASIBLE, detail="job 1").unwrap()
    if k == 2:
        raise UnknownNameError("task", "lift", ["push"])
    return k


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_failed_plan_in_a_pool_loses_no_other_job():
    with ProcessPoolExecutor(1, mp_context=get_context("fork")) as pool:
        jobs = [pool.submit(_job, k) for k in range(5)]
        with pytest.raises(PlanningFailed, match="job 1") as caught:
            jobs[1].result()
        assert caught.value.result.status is PlanStatus.INFEASIBLE
        with pytest.raises(UnknownNameError, match="'lift'; valid: push"):
            jobs[2].result()
        assert [jobs[k].result() for k in (0, 3, 4)] == [0, 3, 4]


@pytest.mark.parametrize(
    ("source", "named"),
    [
        (Path("folder") / "arm.urdf", True),
        ("folder/arm.urdf", True),
        ("folder/", True),
        ("<mujoco/>", False),
        ("{}", False),
        ("a,b\n1,2", False),
        ("", False),
        (None, False),
        (3, False),
    ],
)
def test_errors_name_the_file_unless_it_is_its_own_text(source, named):
    @names_file
    def read(file):
        raise SettingError("speed", 3.0, "less")

    with pytest.raises(SettingError) as caught:
        read(file=source)
    with pytest.raises(SettingError) as again:
        read(source)
    said = str(caught.value)
    assert said == str(again.value) == (f"{source}: " if named else "") + "speed = 3.0, expected less"
    assert caught.value.value == 3.0 and str(pickle.loads(pickle.dumps(caught.value))) == said


def test_errors_that_name_the_file_are_left_alone():
    error = FormatError("folder/arm.urdf", "broken")
    with pytest.raises(FormatError) as caught, naming("folder/arm.urdf"):
        raise error
    assert caught.value is error and str(error) == "folder/arm.urdf: broken"


def test_exceptions_of_callers_survive_as_well():
    again = pickle.loads(pickle.dumps(_Own("a", limit=3)))
    assert again.limit == 3 and str(again) == "a above 3"


class _Own(GracefulPlanError):
    def __init__(self, name, *, limit):
        self.limit = limit
        super().__init__(f"{name} above {limit}")
