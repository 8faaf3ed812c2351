# SPDX-License-Identifier: Apache-2.0
"""Occupancy maps, the grid over them, and their place on the earth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import ceil, isfinite, sqrt
from typing import Any

from kbnitp_ros.core import Grid
from kbnitp_ros.plugins import extra
import numpy as np
from numpy.typing import ArrayLike, NDArray

# Tolerance, in pixels, within which edges of pixels and cells coincide: resolutions such as 0.05 m
# are not exact in binary.
ON_THE_EDGE = 1e-6


def pixels_under(
    cells: int, cell_size: float, first: float = 0.0
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the first pixel under each cell and the first pixel after it, shape (cells,) each."""
    edges = first + np.arange(cells + 1) * cell_size
    start = np.floor(edges[:-1] + ON_THE_EDGE).astype(np.intp)
    stop = np.ceil(edges[1:] - ON_THE_EDGE).astype(np.intp)
    return start, stop


def shares(cells: int, cell_size: float, first: float, pixels: int) -> NDArray[np.float64]:
    """Return the overlap of cells and pixels along an axis, in pixels, shape (cells, pixels)."""
    start = first + np.arange(cells) * cell_size
    pixel = np.arange(pixels)
    low = np.maximum(start[:, None], pixel)
    high = np.minimum(start[:, None] + cell_size, pixel + 1)
    share = high - low
    return np.where(share > ON_THE_EDGE, share, 0.0)


MAX_DEGREES = {'latitude': 90.0, 'longitude': 180.0}

# Maximum distance from the datum, in metres: a quarter of a meridian.
MAX_DISTANCE = 1e7


@dataclass(frozen=True)
class Datum:
    """The geographic origin and heading of the frame map, as in robot_localization's `datum`."""

    # Latitude and longitude of the frame's origin, WGS84, in degrees.
    latitude: float
    longitude: float
    # Angle from east to the frame's x axis, counterclockwise, in rad.
    heading: float

    def __post_init__(self) -> None:
        for name, most in MAX_DEGREES.items():
            if not abs(value := getattr(self, name)) <= most:
                raise ValueError(
                    f'datum has {name} {value}: it must be from {-most:g} to {most:g}, in degrees'
                )
        if not isfinite(self.heading):
            raise ValueError(f'datum has heading {self.heading}: it must be finite, in rad')

    @classmethod
    def of(cls, numbers: Sequence[float]) -> Datum | None:
        """Return the datum of the parameter `datum`; None if the parameter is empty."""
        if not numbers:
            return None
        if len(numbers) != 3:
            raise ValueError(
                f'parameter datum is {list(numbers)}: it must be [latitude, longitude, heading], '
                'in degrees, degrees and rad'
            )
        return cls(*numbers)

    @cached_property
    def _projection(self) -> Any:
        with extra('report'):
            from pyproj import Proj
        return Proj(proj='aeqd', lat_0=self.latitude, lon_0=self.longitude, ellps='WGS84')

    def on_earth(self, points: ArrayLike) -> NDArray[np.float64]:
        """Return latitude and longitude, WGS84 in degrees, of points of the map in metres."""
        at = np.exp(1j * self.heading) * (np.asarray(points) @ (1, 1j))
        if at.size and abs(at).max() > MAX_DISTANCE:
            raise ValueError(
                f'the field is {abs(at).max():.4g} m from the datum: at most {MAX_DISTANCE:g} m '
                'are shown on the earth'
            )
        east, north = at.real.tolist(), at.imag.tolist()
        longitude, latitude = self._projection(east, north, inverse=True)
        return np.stack([latitude, longitude], axis=-1)

    def in_map(self, latitude: float, longitude: float) -> tuple[float, float]:
        """Return x and y in metres of a place on the earth; the inverse of `on_earth`."""
        at = np.exp(-1j * self.heading) * complex(*self._projection(longitude, latitude))
        return float(at.real), float(at.imag)


def nearest_free(grid: Grid, cell: int) -> str:
    """Describe the cell nearest to a blocked one in the largest connected part of the field."""
    left: NDArray[np.bool_] = grid.free.copy()
    largest = np.zeros_like(left)
    while left.sum() > largest.sum():
        part = grid.steps_from(int(np.argmax(left)), left) < grid.cells
        left &= ~part
        largest = part if part.sum() > largest.sum() else largest
    cells = np.flatnonzero(largest)
    distances = np.hypot(*(grid.centers(cells) - grid.centers(cell)).T)
    x, y = grid.centers(nearest := cells[np.argmin(distances)])
    return f'the nearest free cell is {nearest} around ({x:g}, {y:g})'


def widened(obstacles: NDArray[np.bool_], pixels: float) -> NDArray[np.bool_]:
    """Return the pixels nearer than `pixels` to an obstacle, shape (rows, columns)."""
    if pixels <= ON_THE_EDGE or not obstacles.any():
        return obstacles
    wide, (rows, columns) = obstacles.copy(), obstacles.shape
    before = np.zeros((rows, columns + 1), dtype=np.int64)
    np.cumsum(obstacles, axis=1, out=before[:, 1:])
    for up in range(-ceil(pixels), ceil(pixels) + 1):
        # Distances are between the nearest edges of two pixels.
        gap = max(abs(up) - 1, 0)
        if gap >= pixels - ON_THE_EDGE or abs(up) >= rows:
            continue
        aside = ceil(sqrt(pixels**2 - gap**2) - ON_THE_EDGE)
        column = np.arange(columns)
        right = np.minimum(column + aside + 1, columns)
        near = before[:, right] > before[:, np.maximum(column - aside, 0)]
        # Rows moved by `up`, free where they come from beyond the map.
        moved = np.zeros_like(wide)
        first, last = max(0, -up), rows - max(0, up)
        moved[first:last] = near[slice(first + up, last + up)]
        wide |= moved
    return wide


UNKNOWN = -1
OCCUPIED = 100

# Occupancy from which a pixel is an obstacle, as in map_server's files by default.
OCCUPIED_THRESH = 0.65


class MapError(ValueError):
    """A map cannot be used; the text names the file and the remedy."""


@dataclass(frozen=True, eq=False)
class Map:
    """A map of obstacles in the field, as in nav_msgs/OccupancyGrid."""

    # Rows from the bottom; 0 (free) to 100 (occupied), -1 for unknown.
    data: NDArray[np.int8]
    # Side of a pixel in metres, positive.
    resolution: float
    # Lower-left corner in metres.
    origin: tuple[float, float]
    # Angle from the frame's x axis to the rows, counterclockwise, in rad.
    yaw: float = 0.0

    def __post_init__(self) -> None:
        if self.data.ndim != 2 or not self.data.size:
            raise MapError(f'map has the shape {self.data.shape}: it must have rows and columns')
        if not (isfinite(self.resolution) and self.resolution > 0):
            raise MapError(f'resolution is {self.resolution}: it must be positive, in metres')
        if not all(map(isfinite, self.origin)):
            raise MapError(f'origin is {self.origin}: it must be finite, in metres')
        if not isfinite(self.yaw):
            raise MapError(f'yaw is {self.yaw}: it must be finite, in rad')

    def grid(
        self,
        resolution: float | None = None,
        base_position: tuple[float, float] | None = None,
        connectivity: int = 8,
        unknown_blocks: bool = True,
        *,
        base: int = 0,
        through_corners: bool = False,
        occupied_thresh: float = OCCUPIED_THRESH,
        robot_radius: float = 0.0,
    ) -> Grid:
        """Return the grid over the map; cells with an occupied pixel are blocked."""
        side = self.resolution if resolution is None else resolution
        pixels = side / self.resolution
        if not (isfinite(side) and pixels >= 1.0 - ON_THE_EDGE):
            raise MapError(
                f'grid resolution is {side}: it must be at least that of the map, '
                f'{self.resolution} m'
            )
        rows, columns = (ceil(count / pixels - ON_THE_EDGE) for count in self.data.shape)
        obstacles = self.data >= 100.0 * occupied_thresh - ON_THE_EDGE
        # A robot in the middle of a cell is clear of obstacles half a cell away.
        wider = widened(obstacles, robot_radius / self.resolution - 0.5 * pixels)
        blocked = self._blocked(wider, rows, columns, pixels, unknown_blocks)
        bare = Grid(columns, rows, resolution=side, origin=self.origin, yaw=self.yaw)
        if base_position is not None:
            base = int(bare.cells_at([base_position])[0])
        if blocked.all():
            raise MapError(f'all cells of {side:g} m are blocked: choose a finer grid.resolution')
        is_blocked = 0 <= base < bare.cells and bool(blocked.flat[base])
        grid = replace(
            bare,
            base=int(np.argmin(blocked)) if is_blocked else base,
            blocked=np.flatnonzero(blocked).tolist(),
            connectivity=connectivity,
            through_corners=through_corners,
        )
        if is_blocked:
            x, y = bare.centers(base)
            raise MapError(
                f'the base, cell {base} around ({x:g}, {y:g}), is blocked: its pixels must be '
                f'free; set grid.base or grid.base_position, {nearest_free(grid, base)}'
            )
        return grid

    def graded(self, occupied_thresh: float) -> int:
        """Return the number of pixels above 0 that are no obstacles."""
        return int(((self.data > 0) & (self.data < 100.0 * occupied_thresh - ON_THE_EDGE)).sum())

    def _blocked(
        self,
        obstacles: NDArray[np.bool_],
        rows: int,
        columns: int,
        pixels: float,
        unknown_blocks: bool,
    ) -> NDArray[np.bool_]:
        """Return the cells with a blocking pixel, shape (rows, columns)."""
        row_start, row_stop = pixels_under(rows, pixels)
        column_start, column_stop = pixels_under(columns, pixels)
        blocking = np.full((row_stop[-1], column_stop[-1]), unknown_blocks)
        height, width = self.data.shape
        blocking[:height, :width] = obstacles
        if unknown_blocks:
            blocking[:height, :width] |= self.data == UNKNOWN
        # Number of blocking pixels below and left of each corner: four corners give the number in
        # a cell.
        count = np.zeros((blocking.shape[0] + 1, blocking.shape[1] + 1), dtype=np.int64)
        count[1:, 1:] = blocking.cumsum(axis=0, dtype=np.int64).cumsum(axis=1)
        in_rows = count[row_stop] - count[row_start]
        in_cells: NDArray[np.int64] = in_rows[:, column_stop] - in_rows[:, column_start]
        return in_cells > 0
