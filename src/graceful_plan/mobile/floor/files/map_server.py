"""Maps of the ROS map_server: a YAML file that describes an image.

The occupancy p of a pixel is 1 minus its brightness, or its brightness if negated. A cell is occupied above
`occupied_thresh` and free below `free_thresh`. In between it is unknown ("trinary") or has a share of occupancy
("scale"). In mode "raw", pixel values are percentages of occupancy, and those above 100 are unknown.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from graceful_plan.array_types import Array, Int
from graceful_plan.exceptions import READ_ERRORS, FormatError, SceneError, read_error_reason
from graceful_plan.mobile.floor.files.pictures import GreyPicture, read_picture
from graceful_plan.yaml_file import Block, read_yaml

RESOLUTIONS = (1e-3, 100.0)
"""Range of supported cell widths [m]."""
FARTHEST = 1e7
"""Largest origin [m or rad]; maps may use survey coordinates."""
_KEYS = ("image", "mode", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")
_MODES = ("trinary", "scale", "raw")
_FREE, _UNKNOWN, _OCCUPIED = 254, 205, 0
"""Pixel values as map_saver writes them."""
_THRESHOLDS = 0.65, 0.196
"""Thresholds for occupied and free; the unknown pixel value lies between them, at .1961."""


@dataclass(frozen=True, eq=False)
class MapServerMap:
    """Contents of a map's YAML file and image."""

    occupancy: Int[Array, "row column"]
    resolution: float
    origin: tuple[float, float, float]


def read_map_server(file: Path, image: Path | None, most_cells: int) -> MapServerMap:
    """Read a map.

    Raises:
        FormatError: If a file is missing, broken, truncated, too large or malicious.
    """
    try:
        root = read_yaml(file)
        root.only(*_KEYS)
        resolution = root["resolution"].number()
        least, most = RESOLUTIONS
        if not least <= resolution <= most:
            raise root["resolution"].error(f"a resolution of {resolution:g} m, expected {least:g} to {most:g}")
        x, y, yaw = root["origin"].numbers(3)
        if not max(abs(x), abs(y), abs(yaw)) <= FARTHEST:
            raise root["origin"].error(f"numbers of at most {FARTHEST:g}")
        picture = _picture_file(root["image"], file) if image is None else image
        said = root.get("mode")
        mode = "trinary" if said is None else said.string()
        if mode not in _MODES:
            raise root["mode"].error(f"unknown mode {mode!r}; valid: {', '.join(_MODES)}")
        negate = _flag(root.get("negate"))
        thresholds = _thresholds(root, mode)
    except SceneError as error:
        raise FormatError(str(file), str(error).removeprefix(f"{file}:")) from None
    grey = read_picture(picture, most_cells)
    return MapServerMap(_occupancy(grey, mode, negate, thresholds)[::-1], resolution, (x, y, yaw))


def _picture_file(said: Block, file: Path) -> Path:
    name = Path(said.string())
    folder = file.resolve().parent
    if name.is_absolute() or not (folder / name).resolve().is_relative_to(folder):
        raise said.error(f"the image {said.string()!r} is not in the folder of this file or below; pass image=")
    return folder / name


def _flag(said: Block | None) -> bool:
    if said is None:
        return False
    if said.is_mapping or said.is_list or said.value not in ("0", "1", "false", "true"):
        raise said.error("negate has to be 0 or 1")
    return said.value in ("1", "true")


def _thresholds(root: Block, mode: str) -> tuple[float, float]:
    if mode == "raw":
        return _THRESHOLDS
    occupied, free = root["occupied_thresh"], root["free_thresh"]
    if not 0.0 <= free.number() < occupied.number() <= 1.0:
        raise free.error(f"thresholds {free.number():g} and {occupied.number():g}, expected 0 <= free < occupied <= 1")
    return occupied.number(), free.number()


def _occupancy(
    picture: GreyPicture, mode: str, negate: bool, thresholds: tuple[float, float]
) -> Int[Array, "row column"]:
    grey = np.arange(picture.most + 1)
    if mode == "raw":
        return np.where(grey <= 100, grey, -1).astype(np.int8)[picture.grey]
    occupied, free = thresholds
    share = (grey if negate else picture.most - grey) / float(picture.most)
    between = np.rint(100.0 * (share - free) / (occupied - free)) if mode == "scale" else np.full(share.shape, -1.0)
    found = np.where(share > occupied, 100.0, np.where(share < free, 0.0, between)).astype(np.int8)[picture.grey]
    if mode == "scale" and picture.transparent is not None:
        certain = (share > occupied) | (share < free)
        found[picture.transparent & ~certain[picture.grey]] = -1
    return found


def write_map_server(
    file: Path, occupancy: Int[Array, "row column"], resolution: float, origin: tuple[float, float, float]
) -> None:
    """Write a map; shares of occupancy other than free, occupied and unknown are written in mode "raw".

    Raises:
        FormatError: If the name does not end in .yaml, or the file cannot be written.
    """
    if file.suffix != ".yaml":
        raise FormatError(str(file), "the name of a map ends in .yaml")
    plain = bool(np.isin(occupancy, (-1, 0, 100)).all())
    pixels = np.where(occupancy < 0, 255, occupancy)
    if plain:
        pixels = np.select([occupancy == 0, occupancy == 100], [_FREE, _OCCUPIED], _UNKNOWN)
    rows, columns = occupancy.shape
    picture = file.with_suffix(".pgm")
    text = (
        f"image: {picture.name}\nmode: {'trinary' if plain else 'raw'}\nresolution: {resolution!r}\n"
        f"origin: [{', '.join(repr(float(value)) for value in origin)}]\nnegate: 0\n"
        f"occupied_thresh: {_THRESHOLDS[0]}\nfree_thresh: {_THRESHOLDS[1]}\n"
    )
    try:
        picture.write_bytes(f"P5\n{columns} {rows}\n255\n".encode() + pixels[::-1].astype(np.uint8).tobytes())
        file.write_text(text)
    except READ_ERRORS as error:
        raise FormatError(str(file), read_error_reason(error).replace("read", "written", 1)) from None
