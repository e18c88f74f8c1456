"""Elements of a scene: small frozen records without MuJoCo.

Components are the parts of the robot that can do harm (`body`, `carried`, `contents`); entities are the things that
can be harmed. `Notes` holds everything a scene knows beyond its MuJoCo model, from a scene file or from arguments.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import ClassVar

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import GracefulPlanError, SceneError, SettingError
from graceful_plan.path import is_real, plain_numbers
from graceful_plan.scene.harm.severity import SeverityTable
from graceful_plan.scene.mobile.diff_drive import DiffDrive
from graceful_plan.scene.moving import MovingEntity
from graceful_plan.setting_checks import positive

COMPONENTS = ("body", "carried", "contents")
"""Names of the components: the moving links, the carried object, the contents of a carried container."""

BODY_CLASSES = ("arm_collapse", "arm_braked", "base_coast")
CARRIED_CLASSES = ("light", "medium", "heavy", "sharp", "glass")


@dataclass(frozen=True, kw_only=True, eq=False)
class Limits:
    """Limits of the planned joints.

    | field        | meaning                                               | unit           | shape |
    |--------------|-------------------------------------------------------|----------------|-------|
    | position     | lower and upper limit                                 | rad or m       | nq 2  |
    | velocity     | largest speed                                         | rad/s or m/s   | nq    |
    | acceleration | largest acceleration                                  | rad/s2 or m/s2 | nq    |
    | torque       | largest torque or force, infinite if unknown          | N m or N       | nq    |
    """

    position: Float[Array, "nq 2"]
    velocity: Float[Array, " nq"]
    acceleration: Float[Array, " nq"]
    torque: Float[Array, " nq"]


@dataclass(frozen=True, kw_only=True)
class Component:
    """A part of the robot that can do harm, with its column of the severity table."""

    name: str
    geoms: tuple[int, ...]
    component_class: str


@dataclass(frozen=True, kw_only=True)
class Entity:
    """Something that can be harmed, with the severity of a hit by each component."""

    name: str
    category: str
    geoms: tuple[int, ...]
    severity: Mapping[str, float]


@dataclass(frozen=True, kw_only=True, eq=False)
class Carried:
    """The object in the gripper. `X_TO` is the pose of its body in the tool frame."""

    body: str
    X_TO: Float[Array, "4 4"]
    object_class: str


@dataclass(frozen=True)
class Liquid:
    """A liquid in a carried container.

    Args:
        volume: Amount [litres].
        temperature: Temperature [degrees Celsius]; from 60 on, water counts as hot.
        kind: "water" for any thin liquid, "oil" for hot oil and soup.
        geoms: Names of the carried body's geoms that represent the contents; by default the geom "<body>_contents".
    """

    volume: float
    temperature: float = 20.0
    kind: str = "water"
    geoms: tuple[str, ...] = ()
    HOT: ClassVar[float] = 60.0
    """Temperature [degrees Celsius] from which a splash scalds."""

    def __post_init__(self) -> None:
        plain_numbers(self)
        positive("volume", self.volume)
        if not (is_real(self.temperature) and -50.0 <= self.temperature <= 400.0):
            raise SettingError("temperature", self.temperature, "degrees Celsius between -50 and 400")
        if self.kind not in ("water", "oil"):
            raise SettingError("kind", self.kind, "'water' or 'oil'")

    @property
    def component_class(self) -> str:
        """Column of the severity table: hot oil, hot water or anything cold."""
        if self.temperature < self.HOT:
            return "cold"
        return "oil" if self.kind == "oil" else "hot"


@dataclass(frozen=True)
class Granular:
    """Something dry in a carried container: rice, screws, letters.

    Args:
        volume: Amount [litres].
        geoms: Names of the carried body's geoms that represent the contents; by default the geom "<body>_contents".
    """

    volume: float
    geoms: tuple[str, ...] = ()
    component_class: ClassVar[str] = "dry"

    def __post_init__(self) -> None:
        plain_numbers(self)
        positive("volume", self.volume)


Contents = Liquid | Granular


@dataclass(frozen=True)
class Opening:
    """Opening of a gripper, as a value of `fingers`; linkages close, and fingers that mimic others follow.

    Args:
        metres: Distance between the two pads, measured beside the tool [m]. Without it, the fingers close until one
            touches the carried object.
    """

    metres: float | None = None

    def __post_init__(self) -> None:
        plain_numbers(self)
        if self.metres is not None and not (is_real(self.metres) and 0.0 <= self.metres < math.inf):
            raise SettingError("metres", self.metres, "a finite number of at least 0")


Fingers = float | Mapping[str, float] | Opening
"""Position of all leading joints of a gripper, positions by joint name, or an opening."""


@dataclass(frozen=True)
class Adhesion:
    """Grip of a vacuum cup or magnet: a flat disc at the tool that pulls the object against the tool's z axis.

    The disc pushes the object back, so the force is what presses them together. The grip breaks where a load pulls the
    object off, peels it off over the rim, or slides or turns it.

    Args:
        force: Force with which the object is pulled off at the centre [N].
        radius: Radius of the disc [m].
        friction: Coefficient between disc and object.
    """

    force: float
    radius: float
    friction: float = 0.5

    def __post_init__(self) -> None:
        plain_numbers(self)
        for name in ("force", "radius", "friction"):
            positive(name, getattr(self, name))


@dataclass(frozen=True)
class AllowedContact:
    """Two geoms or bodies, by name, that may touch.

    "always": along the whole path. "ends": only in one contiguous stretch at each end of a path, for example an object
    in contact with its support until it is lifted. `reason` is an explanation for people.
    """

    first: str
    second: str
    when: str = "always"
    reason: str = field(default="", compare=False)

    def __post_init__(self) -> None:
        if self.when not in ("always", "ends"):
            raise SettingError("when", self.when, "'always' or 'ends'")


@dataclass(frozen=True, kw_only=True)
class EntityAnnotation:
    """The class of an entity, and severities that replace those of the table.

    Severities are one number for all components, or numbers by component ("carried") or component class ("glass");
    the component takes precedence.
    """

    category: str
    severity: float | Mapping[str, float] | None = None

    def __post_init__(self) -> None:
        plain_numbers(self)


@dataclass(frozen=True, kw_only=True, eq=False)
class ObjectNote:
    """How an object is held; see `Scene.attach` for the defaults."""

    body: str
    X_TO: Float[Array, "4 4"] | None = None
    object_class: str | None = None
    contents: Contents | None = None
    fingers: Fingers | None = None
    grip: Adhesion | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class TaskNote:
    """A declared task; start and goals are configurations or names of keyframes."""

    start: str | tuple[float, ...]
    goal: tuple[str | tuple[float, ...], ...]
    description: str = ""
    object_name: str | None = None
    support: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class Notes:
    """Everything a scene knows beyond its MuJoCo model."""

    name: str
    description: str = ""
    robot: str
    tool: str
    joints: tuple[str, ...] | None = None
    """Planned joints; None for all joints from the world to the tool."""
    body_class: str = "arm_collapse"
    fingers: Fingers | None = None
    limits: Mapping[str, tuple[float, float]] = field(default_factory=lambda: MappingProxyType({}))
    """Lower and upper limits by joint, replacing the model's."""
    velocity: tuple[float, ...] | None = None
    acceleration: tuple[float, ...] | None = None
    torque: tuple[float, ...] | None = None
    base: DiffDrive | None = None
    """Kinematics and limits of the base, if the first planned joints are those of a base."""
    entities: Mapping[str, EntityAnnotation] = field(default_factory=lambda: MappingProxyType({}))
    severity: SeverityTable
    overrides: Mapping[str, float | Mapping[str, float]] = field(default_factory=lambda: MappingProxyType({}))
    """Severities that replace the table's, by entity (see `EntityAnnotation`) or by entity and component class."""
    objects: Mapping[str, ObjectNote] = field(default_factory=lambda: MappingProxyType({}))
    state: Mapping[str, tuple[float, ...]] = field(default_factory=lambda: MappingProxyType({}))
    """Positions of joints that are not planned, where they differ from the model's initial state; see `rest_state`."""
    keyframes: Mapping[str, tuple[float, ...]] = field(default_factory=lambda: MappingProxyType({}))
    states: Mapping[str, Mapping[str, tuple[float, ...]]] = field(default_factory=lambda: MappingProxyType({}))
    """State of the joints that are not planned in each of the model's keyframes."""
    tasks: Mapping[str, TaskNote] = field(default_factory=lambda: MappingProxyType({}))
    allowed: tuple[AllowedContact, ...] = ()
    moving: Mapping[str, MovingEntity] = field(default_factory=lambda: MappingProxyType({}))
    constraints: tuple[object, ...] = ()
    """Constraints on motions in the scene that apply by default: `graceful_plan.Constraint` objects."""
    held: ObjectNote | None = None
    """The object in the gripper, with all defaults resolved."""
    support: tuple[str, ...] = ()
    """Bodies or geoms that the held object may touch at the ends of a path."""
    file: str | None = None
    """The scene file while it is being read; None afterwards, since later errors do not come from the file."""
    lines: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))
    """Line numbers in that file by dotted name, such as "entities.mug"."""

    @contextmanager
    def about(self, place: str) -> Generator[None, None, None]:
        """Convert errors about an entry of a scene file into a SceneError with file and line."""
        try:
            yield
        except GracefulPlanError as error:
            if self.file is None or getattr(error, "file", None) is not None:
                raise
            kind = type(error) if isinstance(error, SceneError) else SceneError
            raise kind(f"{place}: {error}", file=self.file, line=self.lines.get(place)) from error
