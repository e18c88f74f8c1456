"""Colours and styles of all pictures."""

from __future__ import annotations

from typing import Any

PATH_COLOURS = ("#111111", "#0b62c4", "#00805a", "#a3408f")
"""Distinct from each other and from the heat map, also with colour blindness; line styles distinguish them in print."""
ENTITY_COLOURS = ("#e69f00", "#56b4e9", "#009e73", "#d55e00", "#0072b2", "#cc79a7", "#f0e442")
"""Colours of stacked areas, distinguishable with colour blindness (Okabe and Ito)."""
OTHERS_COLOUR = "#9a9a9a"
HEAT = ("#ffffff", "#fff3c4", "#fed976", "#fd8d3c", "#e31a1c", "#8c0d26")
"""Colours from white (no impact) to dark red."""
STYLE: dict[Any, Any] = {
    "font.size": 9,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "svg.fonttype": "none",
}
HALO: dict[str, Any] = {"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none", "alpha": 0.8}
"""Box behind text on a picture."""


def heat_map() -> Any:
    """Return the colours of `HEAT` as a matplotlib colour map."""
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("impact", HEAT)
