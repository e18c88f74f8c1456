"""Array annotations with shapes: jaxtyping's, without the cost of importing it.

Annotations are never evaluated, except by type checkers and by the tests, which check shapes at run time. Importing
jaxtyping takes a fifth of the time that importing this library takes, so where nobody has imported it, names stand in.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING or "jaxtyping" in sys.modules:
    from jaxtyping import Bool, Float, Int, UInt8
else:

    class Float:
        """An array; the shape is for readers."""

        def __class_getitem__(cls, item: Any) -> type[np.ndarray]:
            return np.ndarray

    Bool = Int = UInt8 = Float

__all__ = ["Bool", "Float", "Int", "UInt8"]
