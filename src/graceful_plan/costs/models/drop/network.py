r"""A small network that corrects the drop model: it multiplies the odds of each hit by a learned factor.

The network has two layers of `hidden` units and is evaluated for each surface of an entity. Its inputs describe the
motion of the object relative to the surface (positions, heights and velocities in the surface's axes, in units of the
object's size), the results of the drop model (first contact, fall, side contact), and the shapes of both. The inputs
are invariant to translation and to rotation about the vertical and do not identify the entity, so the network
generalises to unseen objects. With P the drop model's probability of a hit and m the output,

.. math:: P' = \frac{P e^{g m}}{1 - P + P e^{g m}}, \qquad g = \max(0, 1 - 10^{-4}/P), \qquad |m| < \mathrm{bound}

so that impossible and certain hits stay so, and no odds change by more than e^bound. The activation function is
s(x) = x/sqrt(1 + x^2) everywhere: smooth, bounded, and cheap. The native kernel is native/impact/learned/network.hpp,
its gradient network_gradient.hpp.

`failbench learn` trains such a network; the shipped one is `drop_network.npz`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.costs.models.drop.tables import SHAPE_CLASSES, DropTables
from graceful_plan.exceptions import FormatError, ShapeError
from graceful_plan.formats.npz_file import read_arrays
from graceful_plan.regular_file import path_of
from graceful_plan.untrusted_json import parse_json

STATE_FEATURES = (
    "farther_beside", "nearer_beside", "approach", "speed", "vertical_speed", "drop_height", "above_top",
    "above_bottom", "height", "tilt", "centre_height", "leaves", "leaves_towards", "contact", "tumble", "side",
    "fallen", "lands_here_or_lower",
)  # fmt: skip
"""Network inputs that depend on state and surface, in the order of the core."""
LOOKS = ("narrow", "wide", "thick", "carries")
"""Network inputs that depend on the surface alone."""
LEAST = 1e-4
"""Probability below which nothing is corrected."""
MOST_HIDDEN = 32
_SCHEMA, _VERSION = "graceful_plan.drop_network", 1
_ARRAYS = ("told", "looks", "shapes", "first_bias", "second", "second_bias", "last", "last_bias")
_MOST_BYTES = 1 << 20
_MOST_WEIGHT = 1e4
_FILE = Path(__file__).parent / "drop_network.npz"


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class DropNetwork:
    """The weights of a network; see `DropNetwork.shipped()` and `DropNetwork.read(file)`.

    | field       | meaning                                                       | unit | shape         |
    |-------------|---------------------------------------------------------------|------|---------------|
    | told        | first layer: weights of `STATE_FEATURES`                                |      | hidden told   |
    | looks       | first layer: weights of `LOOKS`                               |      | hidden looks  |
    | shapes      | first layer: offset for each of `SHAPE_CLASSES`               |      | shape hidden  |
    | first_bias  | biases of the first layer                                     |      | hidden        |
    | second      | second layer                                                  |      | hidden hidden |
    | second_bias | biases of the second layer                                    |      | hidden        |
    | last        | weights of the output                                         |      | hidden        |
    | last_bias   | bias of the output                                            |      | 1             |
    | bound       | bound of the logarithm of the factor, in both directions      |      |               |
    | about       | provenance, as JSON values                                    |      |               |

    Raises:
        ShapeError: If an array does not fit the others.
    """

    told: Array
    looks: Array
    shapes: Array
    first_bias: Array
    second: Array
    second_bias: Array
    last: Array
    last_bias: Array
    bound: float
    about: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        h = len(self.last)
        shapes = ((h, len(STATE_FEATURES)), (h, len(LOOKS)), (len(SHAPE_CLASSES), h), (h,), (h, h), (h,), (h,), (1,))
        for name, wanted in zip(_ARRAYS, shapes, strict=True):
            if getattr(self, name).shape != wanted:
                raise ShapeError(name, getattr(self, name).shape, str(wanted))

    @classmethod
    def shipped(cls) -> DropNetwork:
        """Return the network that comes with the library; docs/learned-drops.md reports its accuracy."""
        return _shipped()

    @classmethod
    def read(cls, file: str | Path) -> DropNetwork:
        """Read a file written by `write`.

        Raises:
            FormatError: If the file has another format or version, is too large, or holds invalid numbers.
        """
        try:
            return _read(path_of(file))
        except FormatError:
            raise
        except (ValueError, KeyError, TypeError, RecursionError, ShapeError) as error:
            raise FormatError(str(file), f"no network: {error}") from None

    def write(self, file: str | Path) -> None:
        """Write the arrays to a NumPy archive, with a JSON header that states their provenance."""
        header = {
            "schema": _SCHEMA,
            "version": _VERSION,
            "told": STATE_FEATURES,
            "looks": LOOKS,
            "shapes": SHAPE_CLASSES,
        }
        text = json.dumps({**header, "bound": self.bound, "about": dict(self.about)}, allow_nan=False)
        with Path(file).open("wb") as out:
            np.savez_compressed(out, header=np.array(text), **{name: getattr(self, name) for name in _ARRAYS})

    def weights_for(self, tables: DropTables) -> Float[Array, " weights"]:
        """Return all weights in the order of the core; inputs that are constant in a scene are folded into biases."""
        biases = self.first_bias + self.shapes[tables.shape_class] + looks(tables) @ self.looks.T
        parts = (self.told, self.second, self.second_bias, self.last, self.last_bias, biases)
        return np.concatenate([np.ravel(part) for part in parts])

    def log_factor(
        self,
        told: Float[Array, "*batch told"],
        looks: Float[Array, "*batch looks"],
        shape: Float[Array, "*batch shape"],
    ) -> Float[Array, "*batch"]:
        """Compute the logarithm of the factor of the odds.

        Args:
            told: Inputs of states and surfaces, from the core.
            looks: Inputs of the surfaces; see `looks`.
            shape: One-hot shape class of the carried object.
        """
        first = squash(told @ self.told.T + looks @ self.looks.T + shape @ self.shapes + self.first_bias)
        second = squash(first @ self.second.T + self.second_bias)
        return self.bound * squash(second @ self.last + self.last_bias[0])


def squash(x: Array) -> Array:
    """Return x/sqrt(1 + x^2)."""
    return x / np.sqrt(1.0 + x * x)


def fade(P: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """Return the applied share of a correction: 0 for negligible probabilities, towards 1 for large ones."""
    return np.where(P > LEAST, 1.0 - LEAST / np.maximum(P, LEAST), 0.0)


def looks(tables: DropTables) -> Float[Array, "target looks"]:
    """Return the network inputs of each surface, in units of the object's size."""
    a, b = np.sort(tables.target_half, axis=1).T / tables.size
    bottom, top = tables.target_height.T
    carries = np.sqrt(tables.target_carries.prod(axis=1) / np.maximum(tables.target_half.prod(axis=1), 1e-12))
    return np.stack([squash(a), squash(b), squash((top - bottom) / tables.size), np.minimum(carries, 1.0)], axis=1)


@cache
def _shipped() -> DropNetwork:
    return DropNetwork.read(_FILE)


def _read(file: Path) -> DropNetwork:
    data = read_arrays(file, _MOST_BYTES)
    header = parse_json(str(data["header"]), str(file))
    arrays = {name: np.asarray(data[name], dtype=np.float64) for name in _ARRAYS}
    expected: dict[str, object] = {
        "schema": _SCHEMA,
        "version": _VERSION,
        "told": list(STATE_FEATURES),
        "looks": list(LOOKS),
    }
    expected["shapes"] = list(SHAPE_CLASSES)
    for key, wanted in expected.items():
        if header[key] != wanted:
            raise FormatError(str(file), f"{key} is {header[key]!r}, not {wanted!r}")
    for name, values in arrays.items():
        values.flags.writeable = False
        if not np.all(np.abs(values) <= _MOST_WEIGHT):
            raise FormatError(
                str(file), f"{name} has entries that are not between -{_MOST_WEIGHT:g} and {_MOST_WEIGHT:g}"
            )
    if not 1 <= len(np.atleast_1d(arrays["last"])) <= MOST_HIDDEN:
        raise FormatError(str(file), f"it has {len(arrays['last'])} units in a layer, not 1 to {MOST_HIDDEN}")
    bound = float(header["bound"])
    if not 0.0 <= bound <= 30.0:
        raise FormatError(str(file), f"bound is {bound!r}, not between 0 and 30")
    return DropNetwork(**arrays, bound=bound, about=dict(header["about"]))
