"""What the rearranged scenes of `variants` add to bundled scenes, remove from them, and move."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import NamedTuple


@dataclass(frozen=True, kw_only=True)
class Thing:
    """An added object, free to move.

    Args:
        kind: "box" or "cylinder".
        size: Half lengths, or radius and half height [m].
        category: Entity class.
        severity: Severity instead of that of the table.
    """

    kind: str
    size: tuple[float, ...]
    category: str
    severity: float | None = None

    @property
    def half_height(self) -> float:
        """Half of the height when standing [m]."""
        return self.size[-1]


class Shift(NamedTuple):
    """Largest random displacements of objects."""

    distance: float
    """Largest shift along x and y [m]."""
    turn: float
    """Largest rotation about z [rad]."""


_UNMOVED = Shift(0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class Variant:
    """A scene made from a bundled one.

    Args:
        base: Name of the bundled scene.
        seed: Seed of all random numbers.
        remove: Removed bodies.
        shift: Largest displacement of every free body.
        keep: Free bodies that are not moved.
        turn: Fixed bodies and their rotations about z [rad].
        add: Objects added on the support, anywhere in `area`.
        area: Where (x, y at least; x, y at most; z of the support) [m].
        carry: Objects that no task of the bundled scene carries, by name, with the point where they are held, above the
            body's origin [m]; each does the first two tasks.
    """

    base: str
    seed: int
    remove: tuple[str, ...] = ()
    shift: Shift = _UNMOVED
    keep: tuple[str, ...] = ()
    turn: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    add: Mapping[str, Thing] = field(default_factory=lambda: MappingProxyType({}))
    area: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    carry: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))


_TABLE = (-0.25, -0.47, 0.25, -0.23, 0.40)
_TUMBLER = Thing(kind="cylinder", size=(0.028, 0.045), category="glass", severity=10.0)
_PLATE = Thing(kind="cylinder", size=(0.07, 0.01), category="glass", severity=10.0)
_TOWER = Thing(kind="box", size=(0.025, 0.025, 0.09), category="robust", severity=2.0)
_BRICK = Thing(kind="box", size=(0.05, 0.025, 0.02), category="robust", severity=2.0)
VARIANTS: Mapping[str, Variant] = MappingProxyType(
    {
        "tabletop_turned": Variant(
            base="tabletop",
            seed=601,
            remove=("white2", "red4"),
            shift=Shift(0.025, 0.8),
        ),
        "tabletop_mixed": Variant(
            base="tabletop",
            seed=602,
            remove=("white1", "white3", "white6", "white7", "red2", "red3"),
            shift=Shift(0.02, 0.4),
            add={"tumbler1": _TUMBLER, "tumbler2": _TUMBLER, "plate": _PLATE, "tower": _TOWER, "brick": _BRICK},
            area=_TABLE,
            carry={"tumbler1": 0.02, "tower": 0.07},
        ),
        "tabletop_l1_scattered": Variant(
            base="tabletop_l1",
            seed=603,
            shift=Shift(0.08, 3.1),
            add={"tumbler": _TUMBLER, "brick1": _BRICK, "brick2": _BRICK},
            area=_TABLE,
        ),
        "tabletop_l3_thinned": Variant(
            base="tabletop_l3",
            seed=604,
            remove=("bottle2", "tumbler2", "tower2", "white5", "bottle4", "tumbler6", "white8", "tumbler8"),
            shift=Shift(0.03, 1.5),
            carry={"tumbler4": 0.02, "tower1": 0.08},
        ),
        "desk_rearranged": Variant(
            base="desk",
            seed=605,
            remove=("stapler",),
            shift=Shift(0.08, 0.6),
            turn={"cat": 0.7},
            add={
                "cup": Thing(kind="cylinder", size=(0.035, 0.04), category="glass"),
                "letters": Thing(kind="box", size=(0.11, 0.06, 0.004), category="paper"),
            },
            area=(0.25, -0.5, 0.75, 0.5, 0.74),
        ),
        "dining_table_rearranged": Variant(
            base="dining_table",
            seed=606,
            remove=("fork",),
            shift=Shift(0.06, 1.0),
            add={
                "glass": Thing(kind="cylinder", size=(0.03, 0.06), category="glass"),
                "saucer": Thing(kind="cylinder", size=(0.08, 0.008), category="glass"),
            },
            area=(0.3, -0.45, 0.75, 0.45, 0.74),
        ),
        "kitchen_counter_rearranged": Variant(
            base="kitchen_counter",
            seed=607,
            remove=("glass_right",),
            shift=Shift(0.04, 0.6),
            keep=("soup_pot", "pan", "cutting_board", "knife"),
            add={
                "tin": Thing(kind="cylinder", size=(0.04, 0.05), category="robust"),
                "tile": Thing(kind="box", size=(0.07, 0.05, 0.006), category="robust"),
            },
            area=(0.28, -0.42, 0.7, 0.22, 0.90),
        ),
    }
)
"""Variants by name."""
