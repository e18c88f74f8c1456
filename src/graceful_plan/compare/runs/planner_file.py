"""Which planners are compared: names with settings, and planners from a user's own file.

A planner is written `name` or `name:setting=value,setting=value`. A planner file is Python code of the user's; naming
it runs it, on purpose, in this process and in every worker.
"""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.util
import inspect
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import redirect_stdout
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any

import yaml

from graceful_plan.exceptions import FormatError, GracefulPlanError, SettingError, UnknownNameError
from graceful_plan.planners import PLANNERS, Planner

EXPECTED = (
    "a planner file defines at least one graceful_plan.Planner: a subclass (a frozen dataclass with `name`, `anytime` "
    "and `solve`, made with its default settings) or an instance"
)


@dataclasses.dataclass(frozen=True, kw_only=True)
class PlannerNote:
    """A planner as it was asked for: plain data, so that it can go to another process.

    Args:
        label: What it is called in reports.
        name: Name in `PLANNERS`, or in the file.
        settings: Settings other than the defaults.
        file: Python file that defines it; nothing if it is one of the library's.
        digest: Checksum of that file.
    """

    label: str
    name: str
    settings: tuple[tuple[str, Any], ...] = ()
    file: str = ""
    digest: str = ""

    def make(self) -> Planner:
        """Make the planner.

        Raises:
            GracefulPlanError: If it does not exist or refuses its settings.
        """
        if self.file and _digest(self.file) != self.digest:
            raise FormatError(self.file, "changed since the comparison began")
        known = of_file(self.file) if self.file else PLANNERS
        if self.name not in known:
            raise UnknownNameError("planner", self.name, known)
        made = known[self.name]
        instance = made if isinstance(made, Planner) else _made(made, self.file)
        return dataclasses.replace(instance, **dict(self.settings)) if self.settings else instance  # type: ignore[type-var]

    def to_document(self) -> dict[str, Any]:
        """Return what makes this planner what it is; not where its file lies."""
        document = {"label": self.label, "name": self.name, "settings": dict(self.settings)}
        return document | ({"file": Path(self.file).name, "digest": self.digest} if self.file else {})


def read_planners(words: Sequence[str] | None, files: Sequence[str | Path] = ()) -> tuple[PlannerNote, ...]:
    """Read what the command line says about planners.

    Args:
        words: Planners with settings, the reference first; all there are if None.
        files: Python files; their planners are compared too, at the end where `words` does not name them.

    Raises:
        FormatError: If a file cannot be run or defines no planner.
        UnknownNameError: If a planner or a setting does not exist.
        SettingError: If a setting has a wrong value, or two planners have one label.
    """
    found: dict[str, tuple[str, str]] = {}
    for file in map(str, files):
        path = str(Path(file).resolve())
        for name in of_file(path):
            if name in PLANNERS or name in found:
                raise FormatError(file, f"its planner {name!r} has the name of another one; choose another name")
            found[name] = (path, _digest(path))
    notes = [_parsed(word, found) for word in (PLANNERS if words is None else words)]
    named = {note.name for note in notes}
    notes += [_parsed(name, found) for name in found if name not in named]
    labels = [note.label for note in notes]
    twice = next((label for label in labels if labels.count(label) > 1), None)
    if twice is not None:
        raise SettingError("planners", twice, "every planner once")
    if not notes:
        raise SettingError("planners", [], "at least one planner")
    for note in notes:
        _check(note)
    return tuple(notes)


def _check(note: PlannerNote) -> None:
    """Make a planner once, so that its complaints come early."""
    try:
        note.make()
    except GracefulPlanError:
        raise
    except Exception as error:
        raise SettingError(
            "planner", note.label, f"settings that it takes ({type(error).__name__}: {error})"
        ) from error


def _parsed(word: str, found: Mapping[str, tuple[str, str]]) -> PlannerNote:
    name, colon, rest = word.partition(":")
    known = [*PLANNERS, *found]
    if name not in known:
        raise UnknownNameError("planner", name, known)
    file, digest = found.get(name, ("", ""))
    settings = tuple(_settings(word, rest)) if colon else ()
    given = [key for key, _ in settings]
    if len(set(given)) < len(given):
        raise SettingError("planner", word, "every setting once")
    plain = PlannerNote(label=word, name=name, file=file, digest=digest)
    planner: Any = plain.make() if settings else None
    valid = [item.name for item in dataclasses.fields(planner)] if dataclasses.is_dataclass(planner) else []
    for key in given:
        if key not in valid:
            raise UnknownNameError(f"setting of planner {name}", key, valid)
    return dataclasses.replace(plain, settings=settings)


def _digest(file: str) -> str:
    return hashlib.sha256(Path(file).read_bytes()).hexdigest()[:16]


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
    """Read what YAML 1.1 takes for text, as 1e-3."""
    try:
        return float(text)
    except ValueError:
        return text


@lru_cache(maxsize=16)
def of_file(file: str) -> Mapping[str, Planner | type[Planner]]:
    """Run a planner file and return what it defines, by name.

    Instances count by the name of their variable. If there are none, every class derived from Planner that the file
    itself defines counts by its `name`.

    Raises:
        FormatError: If it cannot be run, with what it raised, or defines no planner.
    """
    module = _run(Path(file))
    public = {name: value for name, value in vars(module).items() if not name.startswith("_")}
    instances = {name: value for name, value in public.items() if isinstance(value, Planner)}
    if instances:
        return instances
    classes = [
        value
        for value in public.values()
        if inspect.isclass(value) and issubclass(value, Planner) and value.__module__ == module.__name__
    ]
    concrete = [cls for cls in classes if not inspect.isabstract(cls)]
    found = {str(getattr(cls, "name", cls.__name__)): cls for cls in concrete}
    if len(found) < len(concrete):
        raise FormatError(file, f"two of its planners have one name: {', '.join(cls.__name__ for cls in concrete)}")
    if not found:
        abstract = [f"; {cls.__name__} lacks {', '.join(sorted(cls.__abstractmethods__))}" for cls in classes]
        raise FormatError(file, f"no planner in it{''.join(abstract)}; {EXPECTED}")
    for cls in found.values():
        _made(cls, file)
    return found


def _run(file: Path) -> ModuleType:
    if file.suffix != ".py":
        raise FormatError(str(file), f"no Python file (.py); {EXPECTED}")
    if not file.is_file():
        raise FormatError(str(file), f"there is no such file; {EXPECTED}")
    name = f"graceful_plan_bench_{hashlib.sha256(str(file).encode()).hexdigest()[:12]}"
    spec = importlib.util.spec_from_file_location(name, file)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    # Dataclasses look their module up by its name.
    sys.modules[name] = module
    try:
        with redirect_stdout(sys.stderr):  # what it prints is no part of what the command prints
            spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        line = _line_of(error, file)
        raise FormatError(f"{file}{line}", f"raised {type(error).__name__}: {error}; {EXPECTED}") from error
    return module


def _line_of(error: BaseException, file: Path) -> str:
    """Return the line of the file that an error came from, as ":12"."""
    if isinstance(error, SyntaxError) and error.lineno is not None:
        return f":{error.lineno}"
    line = ""
    trace = error.__traceback__
    while trace is not None:
        if trace.tb_frame.f_code.co_filename == str(file):
            line = f":{trace.tb_lineno}"
        trace = trace.tb_next
    return line


def _made(cls: type[Planner], file: str) -> Planner:
    try:
        return cls()
    except GracefulPlanError:
        raise
    except Exception as error:
        if not file:
            raise
        raise FormatError(file, f"{cls.__name__}() raised {type(error).__name__}: {error}; {EXPECTED}") from error
