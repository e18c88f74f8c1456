"""Errors raised for misuse. A planning problem without a solution gives a `PlanResult` with a status instead."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Generator, Iterable, Mapping
from contextlib import contextmanager
from functools import wraps
from inspect import signature
from os import PathLike
from os.path import basename
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")


def _listed(names: Iterable[str]) -> str:
    return ", ".join(sorted(names)) or "none"


READ_ERRORS = (OSError, ValueError)
"""Exceptions from opening a file; ValueError is for invalid names, such as one that contains a null character."""


def read_error_reason(error: OSError | ValueError) -> str:
    """Return the reason why a file could not be opened, without the file's name."""
    said = error.strerror if isinstance(error, OSError) else error
    return f"cannot be read: {said}"


class GracefulPlanError(Exception):
    """Base class of all errors that this library raises deliberately.

    Errors can be pickled, so they reach the caller from another process. Attributes that cannot be pickled, such as a
    cost with a lambda, arrive as text.
    """

    def __reduce__(self) -> tuple[Any, ...]:
        # The default calls the class with the message, but constructors take other arguments.
        return _restored, (type(self), self.args, {name: _picklable(value) for name, value in vars(self).items()})


def _restored(kind: type[GracefulPlanError], args: tuple[Any, ...], attributes: Mapping[str, Any]) -> GracefulPlanError:
    """Return an error without calling its constructor."""
    error = kind.__new__(kind, *args)
    super(GracefulPlanError, error).__init__(*args)
    vars(error).update(attributes)
    return error


def _picklable(value: object) -> object:
    """Return a value, or its text if it cannot be pickled."""
    try:
        pickle.dumps(value)
    except Exception:  # classes raise anything
        return repr(value)
    return value


@contextmanager
def naming(source: object) -> Generator[None]:
    """Add the name of a file to errors of this library that do not mention it.

    Args:
        source: The file, or its content as text, which is not added.
    """
    try:
        yield
    except GracefulPlanError as error:
        name = _file_name(source)
        if name and name not in str(error):
            error.args = (f"{source}: {error}", *error.args[1:])
        raise


def names_file(function: Callable[P, T]) -> Callable[P, T]:
    """Add the name of the file, the first argument after a class, to errors of a function that do not mention it."""
    names = list(signature(function).parameters)
    place = 1 if names[0] in ("cls", "self") else 0

    @wraps(function)
    def named(*args: P.args, **kwargs: P.kwargs) -> T:
        with naming(args[place] if len(args) > place else kwargs.get(names[place])):
            return function(*args, **kwargs)

    return named


def _file_name(source: object) -> str:
    """Return the last part of the name of a file; "" for the content of a file or anything else."""
    if isinstance(source, PathLike):
        return basename(str(source).rstrip("/"))
    is_content = isinstance(source, str) and ("\n" in source or source.lstrip()[:1] in ("", "<", "{", "["))
    return basename(source.rstrip("/")) if isinstance(source, str) and not is_content else ""


class UnknownNameError(GracefulPlanError, KeyError):
    """An unknown name.

    Args:
        kind: Kind of thing that the name should denote, e.g. "keyframe".
        name: The name given.
        valid: The valid names.
    """

    def __init__(self, kind: str, name: str, valid: Iterable[str]) -> None:
        self.kind, self.name, self.valid = kind, name, tuple(sorted(valid))
        super().__init__(f"unknown {kind} {name!r}; valid: {_listed(self.valid)}")

    def __str__(self) -> str:
        return str(self.args[0])  # KeyError would show the repr


class ShapeError(GracefulPlanError, ValueError):
    """An array of the wrong shape."""

    def __init__(self, name: str, shape: tuple[int, ...], expected: str) -> None:
        self.name, self.shape, self.expected = name, shape, expected
        super().__init__(f"{name} has shape {shape}, expected {expected}")


class NonFiniteError(GracefulPlanError, ValueError):
    """A NaN or infinite number where a finite one is needed."""

    def __init__(self, name: str, index: tuple[int, ...]) -> None:
        self.name, self.index = name, index
        super().__init__(f"{name} is not finite at index {index}")


class SettingError(GracefulPlanError, ValueError):
    """A setting outside its range."""

    def __init__(self, name: str, value: object, expected: str) -> None:
        self.name, self.value, self.expected = name, value, expected
        super().__init__(f"{name} = {value!r}, expected {expected}")


class SceneError(GracefulPlanError, ValueError):
    """A scene file or model that is malformed, malicious or inconsistent.

    Args:
        message: Description of the problem, with the valid names if there are any.
        file: File with the problem, if it is in a file.
        line: Line in that file, counted from 1.
    """

    def __init__(self, message: str, *, file: str | None = None, line: int | None = None) -> None:
        self.message, self.file, self.line = message, file, line
        where = "" if file is None else f"{file}:{line}: " if line is not None else f"{file}: "
        super().__init__(where + message)


class UnsupportedError(SceneError):
    """A model feature that the planner cannot represent."""


class TooLargeError(SceneError, MemoryError):
    """A scene that needs more memory than is available.

    Args:
        what: Data that needs the memory.
        reason: Message of the failed allocation.
    """

    def __init__(self, what: str, reason: str = "") -> None:
        self.what, self.reason = what, reason
        said = f" ({reason})" if reason else ""
        super().__init__(
            f"{what} needs more memory than there is{said}; use fewer bodies: static geoms may share one body, and"
            " sensor data may be a PointCloud or a HeightMap"
        )


class FormatError(GracefulPlanError, ValueError):
    """A file or text that does not have the expected format."""

    def __init__(self, source: str, problem: str) -> None:
        self.source, self.problem = source, problem
        super().__init__(f"{source}: {problem}")


class EndpointError(GracefulPlanError, RuntimeError):
    """A failed request to a language model: the server is unreachable, refuses, or sends an invalid response.

    Args:
        endpoint: Address of the server, without credentials.
        problem: Description of the problem.
    """

    def __init__(self, endpoint: str, problem: str) -> None:
        self.endpoint, self.problem = endpoint, problem
        super().__init__(f"{endpoint}: {problem}")


class AnnotationError(GracefulPlanError, ValueError):
    """An invalid answer to a request for annotations of entities.

    Args:
        problems: Descriptions of the problems, each with the names concerned.
    """

    SHOWN = 8

    def __init__(self, problems: Iterable[str]) -> None:
        self.problems = tuple(problems)
        more = len(self.problems) - self.SHOWN
        said = "; ".join(self.problems[: self.SHOWN]) + (f"; and {more} more" if more > 0 else "")
        super().__init__(f"annotations cannot be used: {said}")


class RetimingError(GracefulPlanError, RuntimeError):
    """A path that cannot be timed within the limits; `plan` turns it into RETIMING_FAILED."""

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(reason)


class CostError(GracefulPlanError, ValueError):
    """A cost that violates its contract: wrong shape, negative or non-finite."""

    def __init__(self, cost: object, problem: str) -> None:
        self.cost, self.problem = cost, problem
        super().__init__(f"{type(cost).__name__}: {problem}")
