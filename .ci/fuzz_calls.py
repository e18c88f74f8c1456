"""Call every public function with invalid arguments; each call must succeed or raise a GracefulPlanError.

python .ci/fuzz_calls.py [--name NAME ...]

Covers `__all__` of both packages, with constructors and class methods. One parameter at a time gets numbers, arrays,
texts or file names that its type allows; the others are valid. A call fails if it raises any error other than a
GracefulPlanError or takes more than 20 s. Not covered: objects of a wrong type (a number for a scene) and items of
sequences.
"""

from __future__ import annotations

import argparse
import inspect
import logging
import signal
import sys
import tempfile
import traceback
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

import failbench
import graceful_plan as gp

SLOW = 20
NUMBERS: dict[str, Any] = {
    "NaN": float("nan"),
    "infinity": float("inf"),
    "minus infinity": float("-inf"),
    "a negative number": -1,
    "a huge integer": 10**400,
}
ARRAYS: dict[str, Any] = {
    "no numbers": np.zeros(0),
    "no rows": np.zeros((0, 7)),
    "wrong shape": np.zeros((2, 3, 5)),
    "NaN in an array": np.full(7, np.nan),
    "infinity in an array": np.full((2, 7), np.inf),
    "texts in an array": np.array(["a", "b"]),
    "rows of several lengths": [[1.0], [1.0, 2.0]],
}
TEXTS: dict[str, Any] = {
    "nonsense": "nonsense",
    "nothing": "",
    "a lone surrogate": "\ud800",
    "a null": "a\0b",
    "a long one": "x" * 10_000,
}
OTHERS: dict[str, Any] = {"None": None, "bytes": b"abc", "an object": object(), "a list": ["a"]}
"""Values for parameters that accept a file name."""
COMPOSED = ("Callable", "dict", "Mapping", "Sequence", "tuple", "Iterable", "Restraint", "Reaches")
"""Words in the types of parameters that are not tested."""
KINDS: tuple[tuple[tuple[str, ...], dict[str, Any]], ...] = (
    (("float", "int", "ArrayLike", "Float", "Configuration", "Goal"), NUMBERS),
    (("ArrayLike", "Float", "Configuration", "Goal"), ARRAYS),
    (("str", "Configuration", "Goal"), TEXTS),
    (("str | Path", "str | FilePath"), OTHERS),
)
"""Words in a parameter's annotation, and the values to pass."""
LEFT_OUT = frozenset({"view", "annotate", "compare", "film", "sweep_of", "generate", "resume", "StateBatch"})
"""Functions that start a server, use a network or run for minutes, and `StateBatch`, which checks nothing."""
CHEAP = ("iterations", "n", "rollouts", "nodes", "points")
"""Parameters that get a small value even if they have a default, to save time."""
MADE_OTHERWISE = frozenset({"Roadmap"})
"""Classes whose constructors are not for users."""


def valid(folder: Path) -> dict[str, Any]:
    """Return valid values by parameter name."""
    task = gp.load_scene("tabletop").tasks["right_to_left"]
    start, goal = np.asarray(task.start), np.atleast_2d(task.goal)[0]
    path = gp.Path(np.array([start, goal]))
    motion = gp.retime(path, task.scene.limits, task.scene.joints)
    motion.to_json(folder / "m.json")
    return {
        "start": start, "goal": goal, "scene": task.scene, "path": path, "trajectory": motion, "motion": motion,
        "q": start, "limits": task.scene.limits, "iterations": 20, "n": 4, "rollouts": 2, "height": 0.2, "points": 2,
        "file": folder / "m.json", "source": folder / "m.json", "task": task, "nodes": 40,
    }  # fmt: skip


def callables() -> Iterator[tuple[str, Callable[..., Any]]]:
    """Yield all public callables with their names."""
    for package in (gp, failbench):
        for name in sorted(package.__all__):
            found = getattr(package, name)
            if name in LEFT_OUT or not callable(found) or inspect.isabstract(found):
                continue
            if name not in MADE_OTHERWISE and not (inspect.isclass(found) and issubclass(found, BaseException)):
                yield f"{package.__name__}.{name}", found
            for method in vars(found) if inspect.isclass(found) else ():
                if not method.startswith("_") and isinstance(vars(found)[method], classmethod | staticmethod):
                    yield f"{package.__name__}.{name}.{method}", getattr(found, method)


def wrong_values(annotation: str) -> dict[str, Any]:
    """Return invalid values that pass a type check of the parameter."""
    chosen: dict[str, Any] = {}
    if any(word in annotation for word in COMPOSED):
        return chosen
    for words, values in KINDS:
        if any(word in annotation for word in words):
            chosen |= values
    return chosen


def cases(call: Callable[..., Any], known: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the name of the invalid argument and all arguments of the call."""
    try:
        parameters = inspect.signature(call).parameters.values()
    except (TypeError, ValueError):
        return
    named = [p for p in parameters if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)]
    for wrong in named:
        for what, value in wrong_values(str(wrong.annotation)).items():
            given = {p.name: known[p.name] for p in named if p.name in known and p.default is p.empty}
            given |= {p.name: known[p.name] for p in named if p.name in CHEAP}
            given[wrong.name] = value
            if all(p.name in given for p in named if p.default is p.empty):
                yield f"{wrong.name} = {what}", given


class TooSlow(BaseException):
    """A call took too long."""


def _alarm(number: int, frame: FrameType | None) -> None:
    raise TooSlow


def trouble(call: Callable[..., Any], given: dict[str, Any]) -> str | None:
    """Return a description of a wrong reaction to the arguments, or None."""
    signal.alarm(SLOW)
    try:
        call(**given)
    except gp.GracefulPlanError as error:
        return None if str(error) else "an error without words"
    except TooSlow:
        return f"took more than {SLOW} s"
    except Exception as error:
        at = traceback.extract_tb(error.__traceback__)[-1]
        return f"{type(error).__name__}: {str(error)[:90]!a} ({Path(at.filename).name}:{at.lineno})"
    finally:
        signal.alarm(0)
    return None


def main() -> int:
    """Return the number of failed calls."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--name", nargs="*", help="only these, such as graceful_plan.plan")
    args = parser.parse_args()
    logging.disable()
    warnings.simplefilter("ignore")
    signal.signal(signal.SIGALRM, _alarm)
    total = wrong = 0
    with tempfile.TemporaryDirectory() as scratch:
        known = valid(Path(scratch))
        for name, call in callables():
            if args.name and name not in args.name:
                continue
            for what, given in cases(call, known):
                total += 1
                if found := trouble(call, given):
                    wrong += 1
                    print(f"{name}: {what}: {found}", flush=True)
    print(f"{total} calls, {wrong} wrong")
    return wrong


if __name__ == "__main__":
    sys.exit(min(main(), 100))
