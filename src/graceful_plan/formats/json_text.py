"""Trajectories as JSON: an object with schema, version, units, joint names and lists of numbers."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from graceful_plan.exceptions import FormatError
from graceful_plan.formats.samples import SCHEMA, UNITS, VERSION, TimedSamples, text_of
from graceful_plan.path import finite_array
from graceful_plan.untrusted_json import check_keys, parse_json


def to_json(samples: TimedSamples) -> str:
    """Return the samples as JSON text."""
    document = {"schema": SCHEMA, "version": VERSION, "units": UNITS, "joints": list(samples.joints)}
    document |= {name: getattr(samples, name).tolist() for name in UNITS}
    return json.dumps(document, allow_nan=False) + "\n"


def from_json(source: str | Path) -> TimedSamples:
    """Read the output of `to_json`, from a file or from text that starts with a brace.

    Raises:
        FormatError: If the document has another format, version or unit.
        ShapeError: If its numbers do not form an array.
        NonFiniteError: If a number is NaN or infinite.
    """
    name, text = text_of(source, lambda text: text.lstrip().startswith("{"), "JSON")
    document = parse_json(text, name)
    _check(name, document)
    t, q, qd, qdd = (finite_array(key, document[key], ndim=1 if key == "t" else 2) for key in UNITS)
    return TimedSamples(t, q, qd, qdd, tuple(document["joints"]))


def _check(name: str, document: Any) -> None:
    """Refuse anything but the keys, version, units and value types that `to_json` writes."""
    check_keys(name, document, {"schema", "version", "units", "joints", *UNITS})
    for key, value in (("schema", SCHEMA), ("version", VERSION), ("units", UNITS)):
        if document[key] != value:
            raise FormatError(name, f"{key} is {document[key]!r}, this version reads {value!r}")
    joints = document["joints"]
    if not isinstance(joints, list) or not all(isinstance(joint, str) for joint in joints):
        raise FormatError(name, "joints must be a list of names")
    for key in UNITS:
        rows = [document[key]] if key == "t" else document[key]
        if not isinstance(rows, list) or not all(isinstance(row, list) and _only_numbers(row) for row in rows):
            raise FormatError(name, f"{key} must be a list of numbers")


def _only_numbers(values: Sequence[Any]) -> bool:
    return all(type(x) in (int, float) for x in values)
