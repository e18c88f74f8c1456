"""Errors that misuse raises. A problem without a solution is a `PlanResult` with a status instead."""

from __future__ import annotations

from collections.abc import Iterable


def _listed(names: Iterable[str]) -> str:
    return ", ".join(sorted(names)) or "none"


NOT_READ = (OSError, ValueError)
"""What opening a file raises; ValueError for names that no file can have, with a null in them."""


def why_not_read(error: OSError | ValueError) -> str:
    """Return why a file could not be opened, without its name."""
    said = error.strerror if isinstance(error, OSError) else error
    return f"cannot be read: {said}"


class GracefulPlanError(Exception):
    """Base of every error that this library raises on purpose."""


class UnknownNameError(GracefulPlanError, KeyError):
    """A name that does not exist where it was looked up.

    Args:
        kind: What the name should have been, e.g. "keyframe".
        name: The name given.
        valid: The names that exist.
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
    """A setting outside of its range."""

    def __init__(self, name: str, value: object, expected: str) -> None:
        self.name, self.value, self.expected = name, value, expected
        super().__init__(f"{name} = {value!r}, expected {expected}")


class SceneError(GracefulPlanError, ValueError):
    """A scene file or model that is broken, hostile or inconsistent.

    Args:
        message: What is wrong and, where there are some, the valid names.
        file: The file it is in, if it is in one.
        line: The line in that file, from 1.
    """

    def __init__(self, message: str, *, file: str | None = None, line: int | None = None) -> None:
        self.message, self.file, self.line = message, file, line
        where = "" if file is None else f"{file}:{line}: " if line is not None else f"{file}: "
        super().__init__(where + message)


class UnsupportedError(SceneError):
    """A model feature that the planner cannot represent."""


class TooLargeError(SceneError, MemoryError):
    """A scene that needs more memory than there is.

    Args:
        what: What takes it.
        reason: What was said when it was asked for.
    """

    def __init__(self, what: str, reason: str = "") -> None:
        self.what, self.reason = what, reason
        said = f" ({reason})" if reason else ""
        super().__init__(
            f"{what} needs more memory than there is{said}; fewer bodies do: the geoms of what stands still may share"
            " one, and what a sensor saw may be a PointCloud or a HeightMap"
        )


class FormatError(GracefulPlanError, ValueError):
    """A file or text that is not what it should be."""

    def __init__(self, source: str, problem: str) -> None:
        self.source, self.problem = source, problem
        super().__init__(f"{source}: {problem}")


class EndpointError(GracefulPlanError, RuntimeError):
    """A language model that could not be asked: its server is not there, refuses, or answers nonsense.

    Args:
        endpoint: Where it should be, without what is secret.
        problem: What went wrong.
    """

    def __init__(self, endpoint: str, problem: str) -> None:
        self.endpoint, self.problem = endpoint, problem
        super().__init__(f"{endpoint}: {problem}")


class AnnotationError(GracefulPlanError, ValueError):
    """An answer about entities that is not what was asked for.

    Args:
        problems: What is wrong with it, each with the names it is about.
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
    """A cost that breaks its contract: wrong shape, negative or not finite."""

    def __init__(self, cost: object, problem: str) -> None:
        self.cost, self.problem = cost, problem
        super().__init__(f"{type(cost).__name__}: {problem}")
