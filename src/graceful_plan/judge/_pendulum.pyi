"""The judge's pendulum, compiled; `rule_checks` has the typed interface."""

import numpy as np
from numpy.typing import NDArray

def swung(felt: NDArray[np.float64], *, dt: float, length: float, drag: float) -> NDArray[np.float64]: ...
