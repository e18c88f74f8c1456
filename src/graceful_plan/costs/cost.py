"""The cost contract: a density over states, integrated along a path by `Objective`.

A cost is a small frozen object with one method, `state`. It takes a `StateBatch` and returns one number per state: the
cost of being there, per unit of path length (or time, see `Objective.exposure`). No registration is needed: pass the
object as `Objective(motion=...)` or `Objective(impact=...)`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias, TypeVar, final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.core.compile import CompiledScene, compile_scene
from graceful_plan.core.kernels import Kernels
from graceful_plan.costs.clearance_target import kernels_for_target
from graceful_plan.exceptions import CostError, ShapeError
from graceful_plan.path import real_array
from graceful_plan.scene.scene import Scene
from graceful_plan.setting_checks import not_negative

T = TypeVar("T")

AHEAD = 0.1 * np.arange(1, 11)
"""Times after a state for which `StateBatch.ahead` gives the upcoming configurations [s]."""


class Contract(ABC):  # noqa: B024  each contract declares its own abstract methods
    """Base of the classes that users implement; a `@final` subclass cannot be extended, even without a type checker.

    Planners take shortcuts for costs that they know. These shortcuts would bypass the overrides of a subclass.
    """

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        for base in cls.__mro__[1:]:
            if base.__dict__.get("__final__", False):
                raise TypeError(
                    f"{cls.__name__} cannot extend {base.__name__}, which is final: "
                    "write your own gp.Cost or gp.InteractionModel that holds one; see docs/extending.md"
                )


_Ahead: TypeAlias = Array | Callable[[], Array] | None


@final
class StateCache:
    """Cache of intermediate results for some states, independent of time."""

    def __init__(self) -> None:
        self._made: dict[tuple[type, Hashable], object] = {}

    def get(self, kind: type[T], key: Hashable, make: Callable[[], T]) -> T:
        """Return the cached value of this kind for this key; `make` computes it the first time."""
        found = self._made.get((kind, key))
        if not isinstance(found, kind):
            found = self._made[kind, key] = make()
        return found


@final
class StateBatch:
    """States of a moving robot, with derived quantities that are computed lazily and once.

    Args:
        scene: The scene.
        q: Configurations [rad or m].
        direction: Unit direction of motion in joint space; zero where the robot is at rest.
        speed: Joint-space speed along `direction` [rad/s]; zero by default.
        time: Time of each state on the clock of the scene's predictions [s]; None if unknown.
        ahead: Configurations at the times `AHEAD` after each state [rad or m], if the robot does not fail, or a
            function that computes them; None if unknown.
    """

    def __init__(
        self,
        scene: Scene,
        q: Float[Array, "n nq"],
        direction: Float[Array, "n nq"] | None = None,
        speed: Float[Array, " n"] | None = None,
        time: Float[Array, " n"] | None = None,
        ahead: _Ahead = None,
    ) -> None:
        if q.ndim != 2 or q.shape[1] != len(scene.joints):
            raise ShapeError("q", q.shape, f"(n, {len(scene.joints)})")
        self.scene = scene
        self.q = q
        self.direction = np.zeros_like(q) if direction is None else direction
        self.speed = np.zeros(len(q)) if speed is None else speed
        if time is not None and time.shape != (len(q),):
            raise ShapeError("time", time.shape, f"({len(q)},)")
        self.time, self._ahead = time, ahead
        if not callable(ahead):
            _ = self.ahead
        self.kept = StateCache()

    def __len__(self) -> int:
        return len(self.q)

    def __getitem__(self, rows: slice) -> StateBatch:
        """Return a slice of the states."""
        if rows.start == 0 and rows.stop >= len(self):  # keeps the cache
            return self
        time = None if self.time is None else self.time[rows]
        return StateBatch(self.scene, self.q[rows], self.direction[rows], self.speed[rows], time, self._ahead_of(rows))

    def _ahead_of(self, rows: slice) -> _Ahead:
        return None if self._ahead is None else lambda: np.asarray(self.ahead)[rows]

    @cached_property
    def ahead(self) -> Float[Array, "n step nq"] | None:
        """Configurations at the times `AHEAD` after each state [rad or m], without a failure; None if unknown."""
        found = self._ahead() if callable(self._ahead) else self._ahead
        if found is not None and found.shape != (len(self.q), len(AHEAD), self.q.shape[1]):
            raise ShapeError("ahead", found.shape, f"({len(self.q)}, {len(AHEAD)}, {self.q.shape[1]})")
        return found

    def at(self, time: Float[Array, " n"]) -> StateBatch:
        """Return the same states at other times [s]; they share `kept`."""
        other = StateBatch(self.scene, self.q, self.direction, self.speed, time, self._ahead)
        other.kept = self.kept
        return other

    @cached_property
    def compiled(self) -> CompiledScene:
        """The scene's tables and kernels."""
        return compile_scene(self.scene)

    @property
    def qd(self) -> Float[Array, "n nq"]:
        """Joint velocities [rad/s]."""
        return self.direction * self.speed[:, None]

    @cached_property
    def link_poses(self) -> Float[Array, "n link 4 4"]:
        """Pose of every link in W [m]; links as in `RobotArrays`."""
        return self.compiled.kernels.link_poses(self.q)

    @cached_property
    def tool_poses(self) -> Float[Array, "n 4 4"]:
        """X_WT: pose of the tool in W [m]."""
        robot = self.compiled.robot
        return self.link_poses[:, robot.tool_link] @ robot.X_LT

    @cached_property
    def object_poses(self) -> Float[Array, "n 4 4"]:
        """X_WO: pose of the carried object in W [m].

        Raises:
            ShapeError: If nothing is carried.
        """
        if self.scene.carried is None:
            raise ShapeError("object_poses", (), "a scene with a carried object; see Scene.attach")
        return self.tool_poses @ self.scene.carried.X_TO

    @cached_property
    def clearance(self) -> Float[Array, " n"]:
        """Signed clearance to surroundings or self, whichever is nearer [m]."""
        return self.compiled.kernels.clearance(self.q)

    def clearance_to(self, to: str) -> Float[Array, " n"]:
        """Compute the signed clearance to one target [m]; infinite where there is nothing to hit.

        The clearance is that of the spheres that cover robot and carried object; it never exceeds a positive true one.

        Args:
            to: "surroundings" for everything except the robot; "self" for links, and the carried object, among
                themselves; or the name of an entity, where it stands still.

        Raises:
            UnknownNameError: If there is no such entity in the scene.
        """
        return self.kept.get(np.ndarray, ("clearance", to), lambda: self._only(to).clearance(self.q))

    def clearance_gradient_to(self, to: str) -> Float[Array, "n nq"]:
        """Compute the gradient of `clearance_to` in q [m/rad], that of the nearest pair; 0 where it is infinite.

        Args:
            to: See `clearance_to`.

        Raises:
            UnknownNameError: If there is no such entity in the scene.
        """
        return self.kept.get(np.ndarray, ("gradient", to), lambda: self._only(to).clearance_gradient(self.q)[1])

    def _only(self, to: str) -> Kernels:
        return kernels_for_target(self.scene, to)


class Cost(Contract):
    """Base of all costs: a frozen object with `state`, and optionally `gradient`.

    Costs can be added and scaled: `impact + 2.0 * clearance` is a cost.
    """

    @abstractmethod
    def state(self, batch: StateBatch) -> Float[Array, " n"]:
        """Return the cost density at each state.

        Laws: finite and never negative; each entry depends on its own state only; deterministic.
        """

    def gradient(self, batch: StateBatch) -> Float[Array, "n nq"] | None:
        """Return the derivative of `state` with respect to q, or None if the cost has none."""
        del batch
        return None

    def __add__(self, other: Cost) -> SumCost:
        """Return the sum of both."""
        return SumCost((*terms_of(self), *terms_of(other))) if isinstance(other, Cost) else NotImplemented

    def __mul__(self, factor: float) -> SumCost:
        """Return the cost times a factor."""
        return SumCost(((factor, self),))

    __rmul__ = __mul__


@final
@dataclass(frozen=True)
class SumCost(Cost):
    """A weighted sum of costs; it runs in the core if all of them do, and has a gradient if all of them have.

    Args:
        terms: Pairs of a factor >= 0 and a cost.

    Raises:
        SettingError: If a factor is not a finite number >= 0.
    """

    terms: tuple[tuple[float, Cost], ...]

    def __post_init__(self) -> None:
        flat = [(factor * inner, cost) for factor, term in self.terms for inner, cost in terms_of(term)]
        object.__setattr__(self, "terms", tuple(flat))
        for factor, cost in flat:
            not_negative("factor", factor, f"a finite number >= 0 before {type(cost).__name__}")

    def state(self, batch: StateBatch) -> Float[Array, " n"]:
        """Return the cost density at each state."""
        return np.sum([factor * checked_state(cost, batch) for factor, cost in self.terms], axis=0)

    def gradient(self, batch: StateBatch) -> Float[Array, "n nq"] | None:
        """Return the derivative of `state` with respect to q, or None if any cost has none."""
        found = [(factor, cost.gradient(batch)) for factor, cost in self.terms]
        known = [factor * np.asarray(gradient) for factor, gradient in found if gradient is not None]
        return np.sum(known, axis=0) if len(known) == len(found) else None


def terms_of(cost: Cost) -> tuple[tuple[float, Cost], ...]:
    """Return the factors and terms of a sum; of another cost, itself."""
    return cost.terms if isinstance(cost, SumCost) else ((1.0, cost),)


@final
class NonFiniteCostError(CostError):
    """A cost returned a NaN or an infinity; planning ends with the status NONFINITE."""


def checked_state(cost: Cost, batch: StateBatch) -> Float[Array, " n"]:
    """Evaluate a cost and check its result against the contract.

    Raises:
        CostError: If it returns the wrong shape or a negative number.
        NonFiniteCostError: If it returns a NaN or an infinity.
    """
    try:
        value = real_array("state()", cost.state(batch))
    except ShapeError as error:
        raise CostError(cost, str(error)) from None
    if value.shape != (len(batch),):
        raise CostError(cost, f"state() returned shape {value.shape} for {len(batch)} states, expected ({len(batch)},)")
    if not np.all(np.isfinite(value)):
        worst = int(np.flatnonzero(~np.isfinite(value))[0])
        raise NonFiniteCostError(cost, f"state() returned {value[worst]} at q = {np.round(batch.q[worst], 4).tolist()}")
    if np.any(value < 0.0):
        worst = int(np.argmin(value))
        raise CostError(cost, f"state() returned {value[worst]:.3g} < 0 at q = {np.round(batch.q[worst], 4).tolist()}")
    return value


def moving_batch(
    scene: Scene,
    q: Float[Array, "n nq"],
    qd: Float[Array, "n nq"] | None,
    times: Float[Array, " n"] | None = None,
) -> StateBatch:
    """Return states with these joint velocities (at rest if None), at these times [s] if they are known."""
    if qd is None:
        return StateBatch(scene, q, time=times)
    speed = np.linalg.norm(qd, axis=1)
    return StateBatch(scene, q, qd / np.where(speed > 0, speed, 1.0)[:, None], speed, times)
