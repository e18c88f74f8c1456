"""Floor maps: occupied cells, distances to obstacles, and the entities on the floor.

Cells are indexed as in the ROS OccupancyGrid: row 0 is the lowest, rows increase along y of the map, columns along x.
The origin is the pose of the lower left corner of the map in W.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Bool, Float, Int
from graceful_plan.core import _native
from graceful_plan.exceptions import SettingError, ShapeError, names_file
from graceful_plan.mobile.floor.files.map_server import FARTHEST, RESOLUTIONS, read_map_server, write_map_server
from graceful_plan.mobile.floor.files.moving_ai import read_moving_ai, write_moving_ai
from graceful_plan.mobile.floor.furnishing import furnished
from graceful_plan.mobile.floor.slicing import sliced
from graceful_plan.path import finite_array, is_real, plain_numbers
from graceful_plan.regular_file import path_of
from graceful_plan.scene.edit import StaticBody
from graceful_plan.scene.scene import Scene
from graceful_plan.scene.sensed.height_map import HeightMap

UNKNOWN = -1
"""Occupancy of an unknown cell."""
MAX_CELLS = 2**26
"""Largest number of cells of a map: 8192 x 8192."""
_FAR = 2.0**40
"""Largest cell index; points farther away are off the map anyway and are clamped to it."""
WALL_HEIGHT = 1.0
"""Default height of occupied cells in a scene [m]; above the bundled bases."""


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class OccupancyGrid:
    """A map of a floor; frozen, like a Scene. Its arrays are read-only.

    | field         | meaning                                                               | unit      | shape      |
    |---------------|-----------------------------------------------------------------------|-----------|------------|
    | occupancy     | 0 free to 100 occupied, -1 unknown; row 0 is the lowest               | per cent  | row column |
    | resolution    | width of a cell                                                       | m         |            |
    | origin        | x, y, yaw in W of the lower left corner of cell (0, 0)                | m, m, rad |            |
    | entities      | entities on the floor, each a StaticBody with a class                 |           |            |
    | occupied_from | least occupancy of an obstacle cell; unknown cells are obstacles, too | per cent  |            |
    | name          | name of the map                                                       |           |            |

    Raises:
        ShapeError: If the occupancy does not have two axes or has too many cells.
        SettingError: If a value is out of its range or an entity has no class.
    """

    occupancy: ArrayLike
    resolution: float
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    entities: tuple[StaticBody, ...] = ()
    occupied_from: int = 65
    name: str = "floor"

    def __post_init__(self) -> None:
        plain_numbers(self)
        try:
            given = np.asarray(self.occupancy)
        except ValueError:
            raise ShapeError("occupancy", (), "(rows, columns), as many in each row") from None
        if given.ndim != 2 or given.size == 0 or given.size > MAX_CELLS:
            raise ShapeError("occupancy", given.shape, f"(rows, columns), at most {MAX_CELLS} cells")
        if given.dtype == bool:
            given = np.where(given, 100, 0)
        if not np.issubdtype(given.dtype, np.integer):
            raise SettingError("occupancy", str(given.dtype), "whole numbers from -1 to 100, or booleans")
        if given.min() < UNKNOWN or given.max() > 100:
            raise SettingError("occupancy", [int(given.min()), int(given.max())], "whole numbers from -1 to 100")
        occupancy = given.astype(np.int8)
        occupancy.flags.writeable = False
        object.__setattr__(self, "occupancy", occupancy)
        least, most = RESOLUTIONS
        if not (is_real(self.resolution) and least <= self.resolution <= most):
            raise SettingError("resolution", self.resolution, f"a width of a cell from {least:g} to {most:g} m")
        x, y, yaw = finite_array("origin", np.asarray(self.origin), ndim=1, last=3).tolist()
        if max(abs(x), abs(y), abs(yaw)) > FARTHEST:
            raise SettingError("origin", self.origin, f"numbers of at most {FARTHEST:g}")
        object.__setattr__(self, "origin", (x, y, yaw))
        object.__setattr__(self, "entities", tuple(self.entities or ()))
        if not isinstance(self.name, str) or not self.name.isprintable():
            raise SettingError("name", self.name, "a text without control characters")
        for solid in self.entities:
            if not isinstance(solid, StaticBody):
                raise SettingError("entities", solid, "each a StaticBody with a class")
            if solid.entity is None:
                raise SettingError(f"entity of {solid.name}", None, "a class of the severity table")
        if not (is_real(self.occupied_from) and 1 <= self.occupied_from <= 100):
            raise SettingError("occupied_from", self.occupied_from, "a share from 1 to 100 per cent")

    # --- construction -------------------------------------------------------------------------------------------------

    @classmethod
    @names_file
    def from_map_server(cls, file: str | Path, image: str | Path | None = None) -> OccupancyGrid:
        """Read a map of the ROS map_server: a YAML file, and the PGM or PNG that it names.

        Args:
            file: The YAML file.
            image: Image to use instead of the named one, which must be in the folder of the YAML file or below.

        Raises:
            FormatError: If a file is missing, broken, truncated, too large or malicious.
        """
        read = read_map_server(path_of(file), None if image is None else path_of(image), MAX_CELLS)
        return cls(occupancy=read.occupancy, resolution=read.resolution, origin=read.origin, name=_name_of(file))

    @classmethod
    @names_file
    def from_moving_ai(cls, file: str | Path, resolution: float = 1.0) -> OccupancyGrid:
        """Read a .map file of the MovingAI benchmarks; "." "G" and "S" are free, and its first row is the uppermost.

        Raises:
            FormatError: If the file is missing, broken, truncated or too large.
        """
        blocked = read_moving_ai(path_of(file), MAX_CELLS)
        return cls(occupancy=blocked, resolution=resolution, name=_name_of(file))

    @classmethod
    def from_scene(
        cls,
        scene: Scene,
        *,
        heights: tuple[float, float] = (0.03, 1.0),
        resolution: float = 0.05,
        bounds: Sequence[float] | None = None,
    ) -> OccupancyGrid:
        """Build a map from the exact geometry of a scene between two heights, without robot and carried object.

        Args:
            scene: Source of the geometry.
            heights: Height up to which the base drives over things, and height of the robot [m].
            resolution: Width of a cell [m].
            bounds: Least x, greatest x, least y, greatest y [m]; default: around all geometry between the heights.

        Raises:
            SettingError: If a setting is out of its range, nothing is cut, or there would be too many cells.
        """
        occupied, corner = sliced(scene, heights, resolution, bounds, MAX_CELLS)
        return cls(occupancy=occupied, resolution=resolution, origin=(*corner, 0.0), name=scene.name)

    def with_entities(self, *entities: StaticBody) -> OccupancyGrid:
        """Return this map with additional entities.

        Raises:
            SettingError: If one has no class.
        """
        return replace(self, entities=(*self.entities, *entities))

    # --- files --------------------------------------------------------------------------------------------------------

    def save(self, file: str | Path) -> None:
        """Write the map as files of the ROS map_server, FILE.yaml and FILE.pgm; entities are not written.

        Raises:
            FormatError: If the name does not end in .yaml, or a file cannot be written.
        """
        write_map_server(Path(file), np.asarray(self.occupancy), self.resolution, self.origin)

    def save_moving_ai(self, file: str | Path) -> None:
        """Write the map as a .map file of the MovingAI benchmarks.

        Raises:
            FormatError: If the file cannot be written.
        """
        write_moving_ai(Path(file), self.occupied)

    # --- queries ------------------------------------------------------------------------------------------------------

    @cached_property
    def occupied(self) -> Bool[Array, "row column"]:
        """Mask of obstacle cells, including unknown ones."""
        occupancy = np.asarray(self.occupancy)
        found = (occupancy >= self.occupied_from) | (occupancy == UNKNOWN)
        found.flags.writeable = False
        return found

    @cached_property
    def distance(self) -> Float[Array, "row column"]:
        """Distance from the centre of each cell to the nearest obstacle [m]; the outside of the map is an obstacle."""
        blocked = np.ascontiguousarray(self.occupied, dtype=np.uint8)
        found = _native.distance_field(blocked=blocked, resolution=self.resolution, outside=True)
        found.flags.writeable = False
        return found

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of rows and columns."""
        rows, columns = np.shape(self.occupancy)
        return rows, columns

    @property
    def size(self) -> tuple[float, float]:
        """Extent along x and y of the map [m]."""
        rows, columns = self.shape
        return columns * self.resolution, rows * self.resolution

    def on_map(self, xy: Sequence[float] | ArrayLike) -> Float[Array, "*batch 2"]:
        """Transform points from W to the frame of the map [m]."""
        x, y, yaw = self.origin
        c, s = math.cos(yaw), math.sin(yaw)
        return (finite_array("xy", np.asarray(xy), last=2) - (x, y)) @ np.array([[c, -s], [s, c]])

    def in_world(self, xy: Sequence[float] | ArrayLike) -> Float[Array, "*batch 2"]:
        """Transform points from the frame of the map to W [m]."""
        x, y, yaw = self.origin
        c, s = math.cos(yaw), math.sin(yaw)
        return finite_array("xy", np.asarray(xy), last=2) @ np.array([[c, s], [-s, c]]) + (x, y)

    def cells(self, xy: Sequence[float] | ArrayLike) -> Int[Array, "*batch 2"]:
        """Return column and row of the cells that contain points of W; cells may be off the map."""
        return np.floor(np.clip(self.on_map(xy) / self.resolution, -_FAR, _FAR)).astype(int)

    def centres(self, cells: Sequence[Any] | ArrayLike) -> Float[Array, "*batch 2"]:
        """Return the centres in W [m] of cells, given by column and row."""
        return self.in_world((finite_array("cells", np.asarray(cells), last=2) + 0.5) * self.resolution)

    def clearance(self, xy: Sequence[float] | ArrayLike) -> Float[Array, "*batch"]:
        """Return a lower bound on the distance of points in W to obstacles [m]; 0 off the map and on occupied cells."""
        points = np.clip(self.on_map(xy), -_FAR * self.resolution, _FAR * self.resolution)
        cells = np.floor(points / self.resolution).astype(int)
        rows, columns = self.shape
        inside = np.all((cells >= 0) & (cells < (columns, rows)), axis=-1)
        column, row = np.moveaxis(np.where(inside[..., None], cells, 0), -1, 0)
        aside = np.linalg.norm(points - (cells + 0.5) * self.resolution, axis=-1)
        return np.where(inside, np.maximum(self.distance[row, column] - aside, 0.0), 0.0)

    # --- as a scene ---------------------------------------------------------------------------------------------------

    def walls(self, name: str = "walls", height: float = WALL_HEIGHT) -> HeightMap:
        """Return the occupied cells as an obstacle for `Scene.edit(add=...)`: few boxes that cover exactly these cells.

        Raises:
            SettingError: If the map is rotated: boxes of a HeightMap are aligned with W. See `to_scene`.
        """
        if self.origin[2] != 0.0:
            raise SettingError("origin", self.origin, "a yaw of 0: a HeightMap is not rotated; see `to_scene`")
        return HeightMap(
            name=name,
            heights=np.where(self.occupied.T, height, np.nan),
            cell=self.resolution,
            corner=self.origin[:2],
        )

    def to_scene(
        self,
        robot: str = "jackal",
        *,
        height: float = WALL_HEIGHT,
        severity: Mapping[str, Any] | str | Path | None = None,
        keyframes: Mapping[str, ArrayLike] | None = None,
    ) -> Scene:
        """Build a scene in which a bundled robot stands on this floor.

        Occupied cells and a border around the map become few boxes, and entities become solids. The position limits of
        the base are those of the map.

        Args:
            robot: "jackal" or "fetch".
            height: Height of occupied cells [m].
            severity: As in `Scene.from_mjcf`.
            keyframes: Configurations by name.

        Raises:
            UnknownNameError: If there is no such robot with a base, or no such class.
            SettingError: If there are too many boxes.
        """
        return furnished(
            self.occupied,
            self.resolution,
            self.origin,
            solids=self.entities,
            robot=robot,
            height=height,
            severity=severity,
            keyframes=keyframes,
            name=self.name,
        )


def _name_of(file: str | Path) -> str:
    """Return the stem of a file's name with unprintable characters replaced, as a scene name."""
    return "".join(letter if letter.isprintable() else "_" for letter in Path(file).stem)
