r"""The dynamic window approach: choose, among speeds reachable in a short time, those with the best arc.

D. Fox, W. Burgard and S. Thrun, "The dynamic window approach to collision avoidance", IEEE Robotics & Automation
Magazine 4 (1997). A pair :math:`(v, \omega)` is admissible if the base can stop before it touches anything on its arc.
The controller chooses the admissible pair with the greatest score

.. math:: \alpha\, \text{heading} + \beta\, \text{progress} - \gamma\, \text{off the path} + \delta\, \text{clearance}
          - w \sum_e P_e S_e - \text{share of the horizon after a touch}

Differences from the paper: heading is measured towards the path ahead of the arc's end (and middle). Progress is
measured along the path, relative to the distance covered at the greatest speed. P is the probability that the base hits
an entity, weighted by the energy of the hit. It is the mean over failures at the next command and half a horizon later,
by the coast model. Moving entities keep their velocity. Pairs are excluded if the base could not stop at the end of the
path, its lateral acceleration would be too great, or its wheels would turn too fast.

Candidates are evaluated in order of an upper bound on their score, until no other candidate can be better. This does
not change the result.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.core import _native
from graceful_plan.exceptions import SettingError
from graceful_plan.mobile.coast.constants import CoastSettings
from graceful_plan.mobile.coast.moving_entities import planar_shapes
from graceful_plan.mobile.coast.native import coasting_arrays
from graceful_plan.mobile.coast.tables import coast_tables
from graceful_plan.mobile.control.diff_drive_controller import limited
from graceful_plan.mobile.control.drive_state import (
    DriveCommand,
    DriveState,
    Surroundings,
    check_numbers,
    checked_places,
    checked_state,
)
from graceful_plan.path import is_real, is_whole, plain_numbers
from graceful_plan.scene.mobile.diff_drive import DiffDrive
from graceful_plan.scene.per_scene import per_scene
from graceful_plan.scene.scene import Scene

_MUCH = 1e12
"""Stands for infinity in the core."""


@dataclass(frozen=True, kw_only=True)
class DWA:
    """Settings of the dynamic window approach.

    Args:
        heading: Weight of the alignment of the heading with the path ahead, which is between 0 and 1.
        velocity: Weight of progress, which is 1 at the greatest speed along the path.
        path: Weight of the distance to the path [1/m].
        clearance: Weight of the clearance along the arc, which is 1 from `near` on.
        impact: Weight of the impact if the base fails, per unit of severity: the w of `plan`.
        most_impact: Largest acceptable impact. If all candidates exceed it, the one with the least impact is taken.
        horizon: Duration of the evaluated arcs [s].
        period: Time until the next command [s].
        window: Time of acceleration that bounds the candidate speeds, at least the period [s].
        near: Clearance beyond which more gains nothing [m].
        margin: Required clearance [m].
        ahead: Distance along the path from an arc's end to the point it should head for [m].
        tolerance: Distance to the end of the path at which the base stops [m].
        speeds: Number of candidate speeds.
        rates: Number of candidate turning rates, in addition to straight ahead and the arc to the path ahead.

    Raises:
        SettingError: If a number is out of its range.
    """

    heading: float = 0.3
    velocity: float = 1.0
    path: float = 1.0
    clearance: float = 0.2
    impact: float = 0.3
    most_impact: float = math.inf
    horizon: float = 1.2
    period: float = 0.05
    window: float = 0.2
    near: float = 0.3
    margin: float = 0.05
    ahead: float = 0.3
    tolerance: float = 0.05
    speeds: int = 7
    rates: int = 15

    def __post_init__(self) -> None:
        plain_numbers(self)
        check_numbers(self, ("heading", "velocity", "path", "clearance", "impact", "margin", "ahead", "tolerance"))
        check_numbers(self, ("most_impact",), finite=False)
        check_numbers(self, ("near",), above=True)
        for name in ("horizon", "period", "window"):
            if not is_real(getattr(self, name)):
                raise SettingError(f"DWA.{name}", getattr(self, name), "a number")
        if not 0.05 <= self.horizon <= 60.0:
            raise SettingError("DWA.horizon", self.horizon, "between 0.05 and 60 s")
        if not 0.0 < self.period <= self.horizon:
            raise SettingError("DWA.period", self.period, "above 0 s and at most the horizon")
        if not self.period <= self.window < math.inf:
            raise SettingError("DWA.window", self.window, "a finite time of at least the period")
        for name in ("speeds", "rates"):
            value = getattr(self, name)
            if not (is_whole(value) and 2 <= value <= 1000):
                raise SettingError(f"DWA.{name}", value, "a whole number between 2 and 1000")

    def bind(self, scene: Scene, coast: CoastSettings | None = None) -> DynamicWindow:
        """Create the controller for a scene's base.

        Args:
            scene: Scene that provides the base, its limits and its footprint; its obstacles are not used (see `seen`).
            coast: Failure settings; default: the shipped ones. Odometry drift counts as an immediate change of
                curvature, because the window evaluates single states.

        Raises:
            SettingError: If the scene's robot has no base.
        """
        if scene.base is None:
            raise SettingError("scene", scene.name, "a scene with a robot that drives: give it a DiffDrive")
        return DynamicWindow(self, scene, CoastSettings.shipped() if coast is None else coast)


class WindowChoice(NamedTuple):
    """The chosen command and its evaluation."""

    command: DriveCommand
    score: float
    """Score of the chosen candidate; 0 if there was none."""
    clearance: float
    """Least clearance along its arc, at most `DWA.near` [m]."""
    impact: float
    """Impact of a failure along its arc."""
    admissible: bool
    """False if no candidate was admissible; the command then brakes at the limit."""
    evaluated: int
    """Number of candidates whose arcs were evaluated."""


@dataclass(frozen=True, eq=False)
class DynamicWindow:
    """Dynamic-window controller of one base. Created by `DWA.bind`.

    Args:
        settings: Settings of the controller.
        scene: Scene with the base.
        coast: Failure settings.
    """

    settings: DWA
    scene: Scene
    coast: CoastSettings
    _native: _native.DynamicWindow = field(init=False, repr=False)

    def __post_init__(self) -> None:
        assert self.scene.base is not None
        s = self.settings
        names = (
            "heading", "velocity", "path", "clearance", "impact", "horizon", "period", "near", "margin", "ahead",
            "window",
        )  # fmt: skip
        numbers = {name: float(getattr(s, name)) for name in names} | {"most": min(s.most_impact, _MUCH)}
        native = _native.DynamicWindow(
            **coasting_arrays(self.scene, self.coast.without_drift()),
            limits=_limits(self.scene.base),
            settings=numbers,
            n_v=s.speeds,
            n_omega=s.rates,
        )
        object.__setattr__(self, "_native", native)

    def choose(
        self, state: DriveState, path: Float[Array, "n 2"], around: Surroundings, *, every: bool = False
    ) -> WindowChoice:
        """Choose the next command.

        Args:
            state: Pose and speeds of the base.
            path: Points to follow in order; the base stops at the last one [m].
            around: Static and moving shapes around the base.
            every: Whether all candidates are evaluated; this only takes longer and does not change the result.

        Raises:
            ShapeError: If state or path are not of the right shape.
            NonFiniteError: If a number of them is not finite: stop a base whose state is unknown.
            SettingError: If a number of them is too large.
        """
        state, places = checked_state(state), checked_places(path)
        if not isinstance(around, Surroundings):
            raise SettingError("around", around, "Surroundings, such as those of `seen`")
        if np.hypot(*(places[-1] - [state.x, state.y])) <= self.settings.tolerance and self.scene.base is not None:
            told = limited(
                DriveCommand(0.0, 0.0), DriveCommand(state.v, state.omega), self.scene.base, self.settings.period
            )
            return WindowChoice(told, 0.0, self.settings.near, 0.0, True, 0)
        found = self._native.choose(
            state=np.array(state, dtype=float),
            path=places,
            entity=around.entity,
            shape=around.shape,
            velocity=around.velocity,
            severity=around.severity,
            every=every,
        )
        return WindowChoice(DriveCommand(*found[:2]), *found[2:])


def seen(scene: Scene, t: float = 0.0, *, static: bool = True) -> Surroundings:
    """Return the surroundings of a scene's base, projected onto the floor.

    Args:
        scene: Scene with the base.
        t: Time on the clock of its moving entities [s].
        static: Whether static objects are included.
    """
    tables = _standing(scene)
    moving = [planar_shapes(entity, np.array([t])) for entity in scene.moving.values()]
    count = len(scene.entities)
    shape = [*(tables[0] if static else ()), *(row[0] for row, _, _ in moving)]
    entity = [*(tables[1] if static else ()), *range(count, count + len(moving))]
    velocity = np.concatenate([np.zeros((len(shape) - len(moving), 2)), *(v for _, v, _ in moving)])
    body = [entity.severity["body"] if "body" in entity.severity else 0.0 for entity in scene.entities.values()]
    walking = [float(scene.moving_severity[name]["body"]) for name in scene.moving]
    return Surroundings(np.array(shape).reshape(-1, 7), np.array(entity, dtype=int), velocity, [*body, *walking])


@per_scene
def _standing(scene: Scene) -> tuple[Array, Array]:
    tables = coast_tables(scene)
    return tables.shape, tables.entity


def _limits(base: DiffDrive) -> dict[str, float]:
    return {
        "least": -base.v_max if base.reverse else 0.0,
        "v": base.v_max,
        "omega": base.omega_max,
        "a": base.a_max,
        "alpha": base.alpha_max,
        "lateral": base.lateral_max,
        "lever": base.lever,
        "rim": base.rim_max,
    }
