"""Planners of a comparison: names with settings, for planners of the library and imported classes.

A planner is written `name` or `name:setting=value,setting=value`, followed by `+refine` if `plan` shall refine its
paths. The name is one of `PLANNERS`, a custom class `package.module:Class`, or a function `package.module:function`
(see `ExternalProblem`). Importing that module runs its code in this process and in every worker.
"""

from __future__ import annotations

import dataclasses
import hashlib
import importlib
import inspect
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any, final

import yaml

from graceful_plan.exceptions import FormatError, GracefulPlanError, SettingError, UnknownNameError
from graceful_plan.planners import PLANNERS, Planner
from graceful_plan.planners.external import planner_from_function

REFINED = "+refine"
"""Suffix of a planner whose paths `plan` refines."""


@final
class PlannerImportError(GracefulPlanError, ImportError):
    """A class that cannot be imported, or is not a planner.

    Args:
        planner: The class, as "package.module:Class".
        problem: Description of the error.
    """

    def __init__(self, planner: str, problem: str) -> None:
        self.planner, self.problem = planner, problem
        super().__init__(f"planner {planner}: {problem}")


@final
@dataclasses.dataclass(frozen=True, kw_only=True)
class PlannerSpec:
    """A requested planner, as plain data that can be sent to another process.

    Args:
        label: Name in reports.
        name: Name in `PLANNERS`, or "package.module:Class".
        settings: Settings other than the defaults.
        digest: Checksum of the module's file; empty for a planner of the library.
        refine: Whether `plan` refines its paths, which makes the motions of most planners similar.
    """

    label: str
    name: str
    settings: tuple[tuple[str, Any], ...] = ()
    digest: str = ""
    refine: bool = False

    def make(self) -> Planner:
        """Create the planner.

        Raises:
            GracefulPlanError: If the planner does not exist or rejects its settings.
        """
        if self.name in PLANNERS:
            return PLANNERS[self.name](**dict(self.settings))
        planner = imported_planner(self.name)
        if digest_of(planner) != self.digest:
            raise FormatError(planner.__module__, "changed since the comparison began")
        made = _with_defaults(self.name, planner)
        return dataclasses.replace(made, **dict(self.settings)) if self.settings else made  # type: ignore[type-var]

    def to_document(self) -> dict[str, Any]:
        """Return a dictionary that identifies the planner, without the location of its module."""
        document = {"label": self.label, "name": self.name, "settings": dict(self.settings)}
        digest = {"digest": self.digest} if self.digest else {}
        return document | digest | ({"refine": True} if self.refine else {})


def read_planners(words: Sequence[str] | None) -> tuple[PlannerSpec, ...]:
    """Parse planners with settings.

    Args:
        words: Planners with settings, the reference first; all planners of the library if None.

    Raises:
        PlannerImportError: If a class cannot be imported or is not a planner.
        UnknownNameError: If a planner or a setting does not exist.
        SettingError: If a setting has an invalid value, or two planners have the same label.
    """
    notes = [_parsed(word) for word in (PLANNERS if words is None else words)]
    labels = [note.label for note in notes]
    twice = next((label for label in labels if labels.count(label) > 1), None)
    if twice is not None:
        raise SettingError("planners", twice, "every planner once")
    if not notes:
        raise SettingError("planners", [], "at least one planner")
    for note in notes:
        _check(note)
    return tuple(notes)


def _check(note: PlannerSpec) -> None:
    """Create a planner once, to report its errors early."""
    try:
        note.make()
    except GracefulPlanError:
        raise
    except Exception as error:
        raise SettingError(
            "planner", note.label, f"settings that it takes ({type(error).__name__}: {error})"
        ) from error


def _parsed(label: str) -> PlannerSpec:
    refine = label.endswith(REFINED)
    word = label.removesuffix(REFINED)
    name, rest = _split(word)
    if name in PLANNERS:
        planner, digest = PLANNERS[name], ""
    elif ":" in name:
        planner = imported_planner(name)
        digest = digest_of(planner)
    else:
        raise UnknownNameError("planner", name, [*PLANNERS, "package.module:Class"])
    settings = () if rest is None else tuple(_settings(word, rest))
    given = [key for key, _ in settings]
    if len(set(given)) < len(given):
        raise SettingError("planner", word, "every setting once")
    valid = [item.name for item in dataclasses.fields(planner)] if dataclasses.is_dataclass(planner) else []
    for key in given:
        if key not in valid:
            raise UnknownNameError(f"setting of planner {name}", key, valid)
    return PlannerSpec(label=label, name=name, settings=settings, digest=digest, refine=refine)


def _split(word: str) -> tuple[str, str | None]:
    """Split a planner into name and settings; the latter are None without a colon."""
    name, colon, rest = word.partition(":")
    cls, *settings = rest.split(":", 1)
    if name not in PLANNERS and cls.isidentifier():
        return f"{name}:{cls}", settings[0] if settings else None
    return name, rest if colon else None


def _settings(word: str, text: str) -> Iterator[tuple[str, Any]]:
    for part in text.split(","):
        key, equals, value = part.partition("=")
        if not (key.strip() and equals and value.strip()):
            raise SettingError("planner", word, "name:setting=value,setting=value")
        try:
            read = yaml.safe_load(value)
        except yaml.YAMLError:
            read = value
        if not isinstance(read, bool | int | float | str | type(None)):
            raise SettingError(key.strip(), value, "a number, a word, true, false or null")
        yield key.strip(), _number(read) if isinstance(read, str) else read


def _number(text: str) -> float | str:
    """Parse numbers that YAML 1.1 reads as text, such as 1e-3."""
    try:
        return float(text)
    except ValueError:
        return text


def imported_planner(name: str) -> type[Planner]:
    """Import a planner's class, or create a class from a function.

    Args:
        name: "package.module:Class" or "package.module:function", on the module path or in the current directory.

    Raises:
        PlannerImportError: If the module does not exist or cannot be imported, or the class is not a planner.
        UnknownNameError: If the module has no such class.
    """
    module_name, _, cls_name = name.partition(":")
    here = os.getcwd()
    if here not in sys.path:
        # Last, so that no file here shadows an installed module.
        sys.path.append(here)
    try:
        with redirect_stdout(sys.stderr):  # keeps its output out of that of the command
            module = importlib.import_module(module_name)
    except (Exception, SystemExit) as error:
        missing = str(error.name) if isinstance(error, ModuleNotFoundError) else ""
        if missing and f"{module_name}.".startswith(f"{missing}."):
            raise PlannerImportError(name, f"there is no module {missing!r}, nor in {here}") from None
        raise PlannerImportError(
            name, f"importing {module_name} raised {type(error).__name__}: {error}{_line_of(error)}"
        ) from error
    planner = getattr(module, cls_name, None)
    if inspect.isfunction(planner):
        planner = planner_from_function(planner)
    if planner is None:
        valid = [
            key
            for key, value in vars(module).items()
            if (_is_planner(value) and not inspect.isabstract(value))
            or (inspect.isfunction(value) and value.__module__ == module_name and not key.startswith("_"))
        ]
        raise UnknownNameError(f"planner of {module_name}", cls_name, valid)
    if not _is_planner(planner):
        raise PlannerImportError(name, "is no class derived from graceful_plan.Planner, and no function")
    if inspect.isabstract(planner):
        raise PlannerImportError(name, f"lacks {', '.join(sorted(planner.__abstractmethods__))}")
    _with_defaults(name, planner)
    return planner


def _is_planner(value: object) -> bool:
    return inspect.isclass(value) and issubclass(value, Planner)


def _with_defaults(name: str, planner: type[Planner]) -> Planner:
    try:
        return planner()
    except GracefulPlanError:
        raise
    except Exception as error:
        raise PlannerImportError(
            name, f"has to be made without arguments; that raised {type(error).__name__}: {error}"
        ) from error


def _line_of(error: BaseException) -> str:
    """Return the location of an error, such as " (mine.py:12)"."""
    if isinstance(error, SyntaxError) and error.filename and error.lineno is not None:
        return f" ({Path(error.filename).name}:{error.lineno})"
    trace, line = error.__traceback__, ""
    while trace is not None:
        file = trace.tb_frame.f_code.co_filename
        if not file.startswith("<frozen"):
            line = f" ({Path(file).name}:{trace.tb_lineno})"
        trace = trace.tb_next
    return line


def digest_of(planner: type[Planner]) -> str:
    """Return a checksum of the file that defines a planner."""
    return hashlib.sha256(Path(inspect.getfile(planner)).read_bytes()).hexdigest()[:16]
