"""Pictures of pages beside stored ones: what is there has to be there again, not every pixel.

A picture is made small, so that fonts and how edges are drawn matter little. Of each patch of the stored one, the new
one has to have something alike nearby: a panel whose lines are a little higher passes, one without its chart does not.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

STORED = Path(__file__).parent / "stored"
SIZE = (275, 180)
"""Width and height of what is stored: a quarter of a window of 1100 x 720."""
_PATCH, _STEP, _NEARBY = 10, 5, 4
"""Width of a patch, from one to the next, and how far a patch may have moved [pixels of what is stored]."""
UNLIKE = 0.09
"""Mean difference of the colours of a patch that is something else, in [0, 1]."""


def small(picture):
    """Make a picture as small as stored ones are: each pixel is the mean of those that it stands for; in [0, 1]."""
    from PIL import Image

    image = Image.fromarray(np.round(255.0 * picture[..., :3]).astype(np.uint8))
    return np.asarray(image.resize(SIZE, Image.Resampling.BOX), dtype=float) / 255.0


def differences(stored, seen):
    """How unlike what is nearest each patch of the stored picture is, in [0, 1], with rows and columns of patches."""
    stored, wide = _smooth(stored), np.pad(_smooth(seen), ((_NEARBY, _NEARBY), (_NEARBY, _NEARBY), (0, 0)), mode="edge")
    height, width, _ = stored.shape
    least = np.full(((height - _PATCH) // _STEP + 1, (width - _PATCH) // _STEP + 1), np.inf)
    for dy in range(2 * _NEARBY + 1):
        for dx in range(2 * _NEARBY + 1):
            apart = np.abs(stored - wide[dy : dy + height, dx : dx + width]).mean(axis=2)
            patches = sliding_window_view(apart, (_PATCH, _PATCH))[::_STEP, ::_STEP].mean(axis=(2, 3))
            least = np.minimum(least, patches)
    return least


def unlike(stored, seen):
    """The greatest of the differences, both ways: what is missing counts as much as what is there besides."""
    return max(float(differences(*pair).max()) for pair in ((stored, seen), (seen, stored)))


def compared(name, picture, folder):
    """Compare with a stored picture, and leave what was seen in a folder.

    Returns:
        How unlike they are, and where what was seen is: to be looked at, and stored if it is right.
    """
    from PIL import Image

    seen = small(picture)
    Image.fromarray(np.round(255.0 * seen).astype(np.uint8)).quantize(64).save(file := folder / f"{name}.png")
    if not (STORED / f"{name}.png").exists():
        return 1.0, file
    return unlike(load(name), seen), file


def load(name):
    """Read a stored picture, in [0, 1]."""
    from PIL import Image

    return np.asarray(Image.open(STORED / f"{name}.png").convert("RGB"), dtype=float) / 255.0


def _smooth(picture):
    """Mean of each pixel and its neighbours."""
    padded = np.pad(picture, ((1, 1), (1, 1), (0, 0)), mode="edge")
    return sliding_window_view(padded, (3, 3), axis=(0, 1)).mean(axis=(3, 4))
