"""Caches bound to the lifetime of a scene, or of a family of scenes that differ only in the poses of obstacles."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Hashable
from functools import wraps
from threading import Lock
from typing import Concatenate, ParamSpec, TypeVar, overload

from graceful_plan.scene.facts import Layout
from graceful_plan.scene.scene import Scene, checked_scene

P = ParamSpec("P")
T = TypeVar("T")
_Maker = Callable[Concatenate[Scene, P], T]


@overload
def per_scene(make: _Maker[P, T], /) -> _Maker[P, T]: ...


@overload
def per_scene(*, most: int) -> Callable[[_Maker[P, T]], _Maker[P, T]]: ...


def per_scene(make: _Maker[P, T] | None = None, /, *, most: int | None = None) -> object:
    """Cache the results of a function of a scene and of hashable arguments for as long as the scene lives.

    Cached values must not refer to the scene, or neither is ever freed. Concurrent threads may each compute a value;
    all of them get the one that finished first. Exceptions are not cached.

    Args:
        make: The function.
        most: Number of values cached per scene, the oldest of which is dropped; None for no limit. Set it where
            arguments vary from call to call, such as constants in a fit.
    """

    def keeping(make: _Maker[P, T]) -> _Maker[P, T]:
        return _kept(make, lambda scene: scene, most)

    return keeping if make is None else keeping(make)


@overload
def per_layout(make: _Maker[P, T], /) -> _Maker[P, T]: ...


@overload
def per_layout(*, most: int) -> Callable[[_Maker[P, T]], _Maker[P, T]]: ...


def per_layout(make: _Maker[P, T] | None = None, /, *, most: int | None = None) -> object:
    """Cache the results of a function of a scene for all scenes that differ only in the poses of obstacles.

    Use it for results that do not depend on these poses; otherwise it behaves like `per_scene`.
    """

    def keeping(make: _Maker[P, T]) -> _Maker[P, T]:
        return _kept(make, lambda scene: scene.layout, most)

    return keeping if make is None else keeping(make)


def _kept(make: _Maker[P, T], owner: Callable[[Scene], Scene | Layout], most: int | None) -> _Maker[P, T]:
    kept: weakref.WeakKeyDictionary[Scene | Layout, dict[Hashable, T]] = weakref.WeakKeyDictionary()
    storing = Lock()

    @wraps(make)
    def get(scene: Scene, *args: P.args, **kwargs: P.kwargs) -> T:
        checked_scene(scene)
        key = args, tuple(sorted(kwargs.items()))
        own = kept.setdefault(owner(scene), {})
        try:
            return own[key]
        except KeyError:
            value = make(scene, *args, **kwargs)
        with storing:
            if most is not None and key not in own and len(own) >= most:
                del own[next(iter(own))]
            return own.setdefault(key, value)

    return get
