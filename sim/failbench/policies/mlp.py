"""A small network evaluated in NumPy and stored as arrays, independent of the training framework."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import FormatError, ShapeError, names_file
from graceful_plan.formats.npz_file import read_arrays


@dataclass(frozen=True, eq=False)
class Mlp:
    """A multilayer perceptron with tanh between layers and a linear output.

    Args:
        weights: Weights of each layer, [output, input].
        biases: Biases of each layer, [output].
    """

    weights: tuple[Array, ...]
    biases: tuple[Array, ...]

    def __post_init__(self) -> None:
        if not self.weights or len(self.weights) != len(self.biases):
            raise ShapeError("biases", (len(self.biases),), f"one for each of {len(self.weights)} layers, at least one")
        width = self.weights[0].shape[-1]
        for i, (W, b) in enumerate(zip(self.weights, self.biases, strict=True)):
            if W.ndim != 2 or W.shape[1] != width or b.shape != (W.shape[0],):
                raise ShapeError(f"layer {i}", W.shape, f"weights [output, {width}] and biases [output]")
            width = W.shape[0]

    @property
    def inputs(self) -> int:
        """Number of inputs."""
        return self.weights[0].shape[1]

    @property
    def outputs(self) -> int:
        """Number of outputs."""
        return self.weights[-1].shape[0]

    def __call__(self, features: Float[Array, "*batch input"]) -> Float[Array, "*batch output"]:
        """Return the network's output for features."""
        if features.shape[-1] != self.inputs:
            raise ShapeError("features", features.shape, f"(..., {self.inputs})")
        x = features
        for W, b in zip(self.weights[:-1], self.biases[:-1], strict=True):
            x = np.tanh(x @ W.T + b)
        return x @ self.weights[-1].T + self.biases[-1]

    def save(self, file: FilePath) -> None:
        """Write the network to an .npz file, as single-precision arrays w0, b0, w1, ..."""
        arrays: dict[str, Any] = {f"w{i}": W.astype(np.float32) for i, W in enumerate(self.weights)}
        arrays |= {f"b{i}": b.astype(np.float32) for i, b in enumerate(self.biases)}
        np.savez(file, **arrays)

    @classmethod
    @names_file
    def load(cls, file: FilePath) -> Mlp:
        """Read a file written by `save`, without executing any of it.

        Raises:
            FormatError: If the file has another content.
        """
        arrays = read_arrays(file)
        layers = range(len(arrays) // 2)
        wanted = {f"{kind}{i}" for i in layers for kind in "wb"}
        if not arrays or set(arrays) != wanted:
            raise FormatError(str(file), f"has the arrays {sorted(arrays)}, expected w0, b0, w1, b1, ...")
        try:
            read = {name: np.asarray(value, dtype=float) for name, value in arrays.items()}
            if not all(np.isfinite(value).all() for value in read.values()):
                raise FormatError(str(file), "has weights that are not finite")
            return cls(tuple(read[f"w{i}"] for i in layers), tuple(read[f"b{i}"] for i in layers))
        except (TypeError, ValueError) as error:
            raise FormatError(str(file), str(error)) from error
