"""Array annotations with shapes: jaxtyping's types, without the cost of importing jaxtyping.

Only type checkers and the tests evaluate annotations; the tests check shapes at run time. Importing jaxtyping takes a
fifth of the import time of this library, so stand-ins replace its types unless jaxtyping is already imported.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING or "jaxtyping" in sys.modules:
    from jaxtyping import Bool, Float, Int, UInt8
else:

    class Float:
        """Stand-in for a jaxtyping type; it ignores the shape and evaluates to `np.ndarray`."""

        def __class_getitem__(cls, item: Any) -> type[np.ndarray]:
            return np.ndarray

    Bool = Int = UInt8 = Float

Array = np.ndarray

__all__ = ["Array", "Bool", "Float", "Int", "UInt8"]
