"""Rules: constraints on a motion as plain data about the frames of a scene.

Constraints produce rules; planners convert them to tables for the core; the judge checks them with its own
kinematics. Frames: W world, T tool, O carried object, B box.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, final, runtime_checkable

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SettingError
from graceful_plan.scene.rules.grip import AdhesiveGrip, Grip
from graceful_plan.scene.rules.vessel import Vessel, find_vessel
from graceful_plan.scene.scene import Scene

Vector = tuple[float, float, float]

FRAMES = ("tool", "object")


@final
@dataclass(frozen=True, kw_only=True)
class AxisRule:
    """A unit axis in a frame, "tool" or "object", stays within an angle [rad] of a unit direction in W."""

    name: str
    frame: str
    axis: Vector
    direction: Vector
    angle: float


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class BoxRule:
    """The tool's origin stays between two corners [m] of a box with the pose X_WB."""

    name: str
    X_WB: Float[Array, "4 4"]
    lower: Vector
    upper: Vector


@final
@dataclass(frozen=True, kw_only=True)
class DistanceRule:
    """Robot and carried object keep a distance [m] from an entity."""

    name: str
    entity: str
    metres: float


@final
@dataclass(frozen=True, kw_only=True)
class SpeedRule:
    """The tool's origin moves at most at `limit` [m/s], everywhere or within a distance of an entity [m]."""

    name: str
    limit: float
    near: str | None
    within: float


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class ContentsRule:
    """A fraction `part` of the contents stays in the vessel at rest, in motion and while the contents slosh."""

    name: str
    vessel: Vessel
    part: float = 0.99


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class GripRule:
    """Two pads or a disc carry the load of the held object: weight and inertia, with their moments about the grasp.

    The load must not exceed the fraction `share` of the capacity of `grip`.
    """

    name: str
    grip: Grip | AdhesiveGrip
    share: float


@final
@dataclass(frozen=True, kw_only=True)
class StandsRule:
    """A loose load on the carried object neither slides nor tips.

    Its centre of mass is at `point` in the object's frame [m]; `axis` is the upward normal of its support. The slope
    of the specific force at that point relative to the axis is at most `friction` and at most `support`, the radius of
    the load's base over the height of its centre of mass.
    """

    name: str
    point: Vector
    axis: Vector
    friction: float
    support: float


@final
@dataclass(frozen=True, kw_only=True)
class TorqueRule:
    """The torques of the joints stay within a fraction `share` of the scene's limits."""

    name: str
    share: float


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class CustomRule:
    """A user-defined constraint on configurations: `residual` [n, nq] -> [n] is at most 0."""

    name: str
    residual: Callable[[Float[Array, "n nq"]], Float[Array, " n"]]
    told: Callable[[float], str]


FrameRule = AxisRule | BoxRule | DistanceRule | SpeedRule | ContentsRule | GripRule | StandsRule | CustomRule
Rule = FrameRule | TorqueRule


@runtime_checkable
class Ruled(Protocol):
    """An object that provides a rule, such as every constraint."""

    def rule(self, scene: Scene) -> Rule:
        """Return the rule for a scene; raise an error that names the missing part if it does not apply."""
        ...


def default_rules(scene: Scene) -> tuple[Rule, ...]:
    """Return the rules that apply by default.

    These are the rules that the scene declares, and that contents stay in the carried vessel.
    """
    declared = tuple(asked.rule(scene) for asked in scene.notes.constraints if isinstance(asked, Ruled))
    vessel = find_vessel(scene)
    if vessel is None or any(isinstance(rule, ContentsRule) for rule in declared):
        return declared
    return (*declared, ContentsRule(name="KeepContents", vessel=vessel))


def checked_frame(scene: Scene, frame: str | None) -> str:
    """Return the name of a frame; by default "object" if something is carried, else "tool".

    Raises:
        SettingError: If there is no such frame.
    """
    if frame is None:
        return "tool" if scene.carried is None else "object"
    if frame not in FRAMES:
        raise SettingError("frame", frame, f"one of {', '.join(FRAMES)}")
    if frame == "object" and scene.carried is None:
        raise SettingError("frame", frame, "'tool': nothing is carried in this scene")
    return frame
