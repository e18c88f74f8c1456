"""Tables of a dataset: their columns, types, units and meaning."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

from graceful_plan.exceptions import FormatError

if TYPE_CHECKING:
    import pyarrow as pa

VERSION = 3
"""Version of the table layout. Increased when a column is added, removed or changes its meaning."""
ADDED = {"own_loss": 2, "healthy_harm": 3, "healthy_spilled": 3, "whole_impact": 3}
"""Columns added after version 1, with the version that added them."""


class Column(NamedTuple):
    """A column of a table."""

    name: str
    type: str
    """One of "int64", "double", "bool", "string", "list<string>", "list<double>" and "poses"."""
    unit: str
    meaning: str


ROLLOUTS = (
    Column("rollout", "int64", "", "number of the rollout in the sweep, from 0"),
    Column("motion", "string", "", "name of the motion"),
    Column("scene", "string", "", "bundled scene or scene file"),
    Column("task", "string", "", "task whose object is carried; null if nothing is"),
    Column("fault", "string", "", "what broke"),
    Column("category", "string", "", "actuator, sensor, end_effector, power or surroundings"),
    Column("degree", "string", "", "minor, moderate, severe or critical"),
    Column("fault_settings", "string", "", "all settings of the fault, as JSON"),
    Column("onset", "double", "s", "when it broke, after the start of the motion"),
    Column("duration", "double", "s", "duration of the healthy motion"),
    Column("seed", "int64", "", "of everything random in the rollout"),
    Column("weight", "double", "", "of the rollout in means: density of onsets asked about over density drawn from"),
    Column("status", "string", "", "completed, or diverged if the simulation blew up"),
    Column("healthy_harm", "double", "", "severities of all that the motion hits without failure, with probability 1"),
    Column("healthy_spilled", "double", "", "part of the contents that the motion loses without failure, in [0, 1]"),
    Column("observed_impact", "double", "", "severities of all touches of entities, and own_loss; null if diverged"),
    Column("whole_impact", "double", "", "the same with all hits before the onset, each pair once; null if diverged"),
    Column("own_loss", "double", "", "severity of the carried object's loss times P(it is damaged); null if diverged"),
    Column("energy_impact", "double", "", "observed_impact, times P(damage at that energy); null if diverged"),
    Column(
        "secondary_impact", "double", "", "severities of entities that only other entities touched; null if diverged"
    ),
    Column("dropped", "bool", "", "whether the carried object left the gripper; null if diverged"),
    Column("spilled", "double", "", "lost fraction of the container's contents at the onset; null if diverged"),
    Column("contacts", "int64", "", "rows of this rollout in the table of contacts"),
    Column("fell", "list<string>", "", "entities that ended more than 5 cm lower than they began"),
    Column("tipped", "list<string>", "", "entities that ended more than 30 degrees off their initial axis"),
    Column("left_support", "list<string>", "", "entities that ended without touching their initial support"),
    Column("poses", "poses", "m", "final pose in the world of each free body: unit quaternion wxyz, then xyz"),
    Column(
        "state", "list<double>", "", "if it diverged: MuJoCo's integration state at the onset, for replay; else null"
    ),
)

CONTACTS = (
    Column("rollout", "int64", "", "number of the rollout"),
    Column("striker", "string", "", "body, carried, contents, or the entity that was knocked onto the other"),
    Column("entity", "string", "", "the entity that was touched"),
    Column("secondary", "bool", "", "whether the striker is an entity"),
    Column("time", "double", "s", "first touch, after the onset"),
    Column("x", "double", "m", "where, in the world"),
    Column("y", "double", "m", "where, in the world"),
    Column("z", "double", "m", "where, in the world"),
    Column("peak_force", "double", "N", "greatest normal force; depends on the softness of MuJoCo's contacts"),
    Column("impulse", "double", "N s", "integral of the contact force's magnitude over time"),
    Column("speed", "double", "m/s", "relative speed along the normal at the first touch"),
    Column("energy", "double", "J", "kinetic energy of the striker along the normal at the first touch"),
)

TABLES = {"rollouts": ROLLOUTS, "contacts": CONTACTS}


def check_rows(rows: Any, first: int, count: int, source: str) -> None:
    """Check the rows of consecutive rollouts, as `run_chunk` returns them, before they become part of a dataset.

    Args:
        rows: Rows by table.
        first: Number of the first rollout.
        count: Number of rollouts.
        source: Name of the file that they come from, for errors.

    Raises:
        FormatError: If rows are missing, or a row lacks a column or has a value of another type.
    """
    if not isinstance(rows, dict) or set(rows) != set(TABLES) or not all(isinstance(x, list) for x in rows.values()):
        raise FormatError(source, f"damaged: rows have to be lists by table: {', '.join(TABLES)}")
    for table, found in rows.items():
        for k, row in enumerate(found):
            if (problem := _problem(TABLES[table], row)) is not None:
                raise FormatError(source, f"damaged: row {k} of {table}, rollouts from {first}: {problem}")
    numbers, known = [row["rollout"] for row in rows["rollouts"]], range(first, first + count)
    if numbers != list(known):
        raise FormatError(source, f"damaged: {len(numbers)} rows for the {count} rollouts from {first}")
    if any(row["rollout"] not in known for row in rows["contacts"]):
        raise FormatError(source, f"damaged: contacts of other rollouts than the {count} from {first}")


def _problem(columns: tuple[Column, ...], row: Any) -> str | None:
    """Return the defect of a row, None without one; columns added in later versions may be missing."""
    if not isinstance(row, dict):
        return "not a mapping"
    names = {column.name for column in columns}
    if unknown := row.keys() - names:
        return f"unknown column {min(unknown)[:40]!r}"
    if missing := names - row.keys() - ADDED.keys():
        return f"no {min(missing)}"
    wrong = (column for column in columns if column.name in row and not _fits(column, row[column.name]))
    return next((f"{column.name} is not of the type {column.type}" for column in wrong), None)


def _fits(column: Column, value: Any) -> bool:
    if value is None:
        return column.type in ("double", "bool", "list<double>") or column.name == "task"
    return _TYPES[column.type](value)


def _is_number(value: Any) -> bool:
    return type(value) in (int, float) and abs(value) <= sys.float_info.max


def _are_numbers(value: Any) -> bool:
    return isinstance(value, list) and all(map(_is_number, value))


def _is_pose(value: Any) -> bool:
    return (
        isinstance(value, dict)
        and value.keys() == {"name", "wxyz_xyz"}
        and isinstance(value["name"], str)
        and isinstance(value["wxyz_xyz"], list)
        and all(x is None or _is_number(x) for x in value["wxyz_xyz"])
    )


_TYPES: dict[str, Callable[[Any], bool]] = {
    "int64": lambda value: type(value) is int and -(2**63) <= value < 2**63,
    "double": _is_number,
    "bool": lambda value: isinstance(value, bool),
    "string": lambda value: isinstance(value, str),
    "list<string>": lambda value: isinstance(value, list) and all(isinstance(x, str) for x in value),
    "list<double>": _are_numbers,
    "poses": lambda value: isinstance(value, list) and all(map(_is_pose, value)),
}


def arrow_schema(table: str, version: int = VERSION) -> pa.Schema:
    """Return a table's Arrow schema, with unit and meaning of each column in its field's metadata."""
    import pyarrow as pa

    types = {
        "int64": pa.int64(),
        "double": pa.float64(),
        "bool": pa.bool_(),
        "string": pa.string(),
        "list<string>": pa.list_(pa.string()),
        "list<double>": pa.list_(pa.float64()),
        "poses": pa.list_(pa.struct({"name": pa.string(), "wxyz_xyz": pa.list_(pa.float64())})),
    }
    return pa.schema(
        [
            pa.field(column.name, types[column.type], metadata={"unit": column.unit, "meaning": column.meaning})
            for column in TABLES[table]
            if ADDED.get(column.name, 1) <= version
        ]
    )
