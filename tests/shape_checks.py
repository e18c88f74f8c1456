"""Checks of shapes: the first calls of each function in each test, then one call in many.

Checking every call takes several times as long as the calls. A function that breaks a shape does so at one of its
first calls, or at random. Functions without shapes are left as they are: `make lint` checks their types, and checking
them at run time, too, took a tenth of all tests.
"""

from __future__ import annotations

import contextlib
import functools
import inspect
import re
import typing
from collections.abc import Callable, Generator
from typing import Any, Protocol

import jaxtyping
import numpy.typing
from beartype.roar import BeartypeCallHintViolation, BeartypeDecorHintException

FIRST = 3
"""Number of checked first calls of a function in each test. Some functions are called 100,000 times in a test."""
EVERY = 200
"""After those, one call in this number is checked."""

_SHAPED = re.compile(r"\b(Bool|Float|Int|UInt8)\[")

_in_full = jaxtyping.jaxtyped


class _Test:
    number = 0
    """Number of tests begun."""
    paused = False
    """Whether no call is checked."""


def begin_test() -> None:
    """Check the first calls of every function again."""
    _Test.number += 1


@contextlib.contextmanager
def paused() -> Generator[None]:
    """Check no calls, for tests of arguments that the annotations do not mention but functions accept or refuse."""
    _Test.paused = True
    try:
        yield
    finally:
        _Test.paused = False


class _Decorator(Protocol):
    def __call__(self, thing: Any, /) -> Any: ...


def jaxtyped(*, typechecker: Callable[..., Any]) -> _Decorator:
    """Replace the decorator that jaxtyping's import hook puts on every function and class."""
    return functools.partial(_thinned, typechecker)


def _thinned(typechecker: Callable[..., Any], thing: Any) -> Any:
    again = functools.partial(_thinned, typechecker)
    if isinstance(thing, classmethod | staticmethod):
        return type(thing)(again(thing.__func__))
    if isinstance(thing, property):
        return property(*(each and again(each) for each in (thing.fget, thing.fset, thing.fdel)))
    if isinstance(thing, type):
        if "__dataclass_fields__" in vars(thing) and "__init__" in vars(thing):
            thing.__init__ = again(thing.__init__)
        return thing
    return _function(typechecker, thing)


def _has_shapes(function: Callable[..., Any]) -> bool:
    """Return whether a function is annotated with the shape of an array."""
    return any(_SHAPED.search(str(annotation)) for annotation in function.__annotations__.values())


def _function(typechecker: Callable[..., Any], function: Callable[..., Any]) -> Callable[..., Any]:
    if not _has_shapes(function):
        return function
    checked: Callable[..., Any] | None = None  # made on first use, since making one is slow and few are used
    test, calls = -1, 0

    @functools.wraps(function)
    def thinned(*args: Any, **kwargs: Any) -> Any:
        nonlocal checked, test, calls
        if test != _Test.number:
            test, calls = _Test.number, 0
        calls += 1
        if _Test.paused or (calls > FIRST and calls % EVERY):
            return function(*args, **kwargs)
        checked = checked or _checked(typechecker, function)
        return checked(*args, **kwargs)

    return thinned


def _checked(typechecker: Callable[..., Any], function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that checks its calls.

    jaxtyping checks arguments and results by two functions, which takes twice as long to make and to call. These are
    used where the checker alone is wrong: for generators, whose yields it would check after it forgot the shapes; for
    string annotations that it does not understand; and for closures, which it keeps alive together with objects of the
    native core, which then reports leaks when the process ends.
    """
    if inspect.isgeneratorfunction(function) or function.__closure__:
        return _in_full(function, typechecker=typechecker)
    try:
        typing.get_type_hints(function, include_extras=True)  # the checker would only miss a name at a call
        plain = typechecker(function)
    except (NameError, BeartypeDecorHintException):
        return _in_full(function, typechecker=typechecker)

    @functools.wraps(function)
    def checked(*args: Any, **kwargs: Any) -> Any:
        with _in_full("context"):
            try:
                return plain(*args, **kwargs)
            except BeartypeCallHintViolation as error:
                raise jaxtyping.TypeCheckError(str(error)) from error

    return checked


def install() -> None:
    """Replace jaxtyping's decorator for all modules imported from now on."""
    jaxtyping.jaxtyped = jaxtyped
    # Checked at run time, NumPy's type refuses tuples, which have no `__reversed__`.
    numpy.typing.ArrayLike = Any
