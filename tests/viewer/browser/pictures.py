"""Comparison of pages with stored pictures: the same content is required, not the same pixels.

Pictures are shrunk, so fonts and antialiasing matter little. For each patch of the stored picture, the new one must
have a similar patch nearby: a panel with slightly shifted lines passes, a missing chart does not.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

STORED = Path(__file__).parent / "stored"
SIZE = (275, 180)
"""Width and height of stored pictures: a quarter of a window of 1100 x 720."""
_PATCH, _STEP, _NEARBY = 10, 5, 4
"""Size of a patch, distance between patches, and allowed shift of a patch [pixels of the stored picture]."""
UNLIKE = 0.09
"""Mean colour difference above which a patch counts as different, in [0, 1]."""


def small(picture):
    """Shrink a picture to the size of stored ones, by averaging; values in [0, 1]."""
    from PIL import Image

    image = Image.fromarray(np.round(255.0 * picture[..., :3]).astype(np.uint8))
    return np.asarray(image.resize(SIZE, Image.Resampling.BOX), dtype=float) / 255.0


def differences(stored, seen):
    """Return the least difference of each patch of the stored picture from patches nearby, in [0, 1] [row, column]."""
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
    """Return the greatest difference in both directions: missing and additional content count alike."""
    return max(float(differences(*pair).max()) for pair in ((stored, seen), (seen, stored)))


def compared(name, picture, folder):
    """Compare with a stored picture, and save the new one in a folder.

    Returns:
        The difference, and the path of the new picture: inspect it, and store it if it is right.
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
    """Return the mean of each pixel and its neighbours."""
    padded = np.pad(picture, ((1, 1), (1, 1), (0, 0)), mode="edge")
    return sliding_window_view(padded, (3, 3), axis=(0, 1)).mean(axis=(3, 4))
