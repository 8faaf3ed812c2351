# SPDX-License-Identifier: Apache-2.0
"""An occupancy map, and the grid that robots may walk on it."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, isfinite

from kbnitp_ros.core import Grid
from kbnitp_ros.maps.overlap import ON_THE_EDGE, pixels_under
import numpy as np
from numpy.typing import NDArray

UNKNOWN = -1
OCCUPIED = 100


class MapError(ValueError):
    """A map that cannot be used; the text names the file and what to change."""


@dataclass(frozen=True, eq=False)
class Map:
    """What is known to stand in the field, as nav_msgs/OccupancyGrid has it."""

    # Rows from the bottom; 0 (free) to 100 (occupied), -1 where it is not known.
    data: NDArray[np.int8]
    # Side of a pixel in metres, positive.
    resolution: float
    # Lower-left corner in metres.
    origin: tuple[float, float]
    # The angle from the frame's x axis to the rows, counterclockwise, in rad.
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
    ) -> Grid:
        """
        Return the grid over the map; the cells with an occupied pixel are blocked.

        Cells start at the map's origin and follow its rows and columns. Those that reach beyond
        its far edges are unknown there.

        The resolution is at least the map's, by default that; `base_position` is a point in the
        cell of the base in place of its number, and the rest is as of `Grid`.
        """
        side = self.resolution if resolution is None else resolution
        pixels = side / self.resolution
        if not (isfinite(side) and pixels >= 1.0 - ON_THE_EDGE):
            raise MapError(
                f'grid resolution is {side}: it must be at least that of the map, '
                f'{self.resolution} m'
            )
        rows, columns = (ceil(count / pixels - ON_THE_EDGE) for count in self.data.shape)
        blocked = self._blocked(rows, columns, pixels, unknown_blocks)
        bare = Grid(columns, rows, resolution=side, origin=self.origin, yaw=self.yaw)
        if base_position is not None:
            base = int(bare.cells_at([base_position])[0])
        if 0 <= base < bare.cells and blocked.flat[base]:
            x, y = bare.centers(base)
            raise MapError(
                f'the base, cell {base} around ({x:g}, {y:g}), is blocked: '
                'its pixels must be free; choose another base_position'
            )
        return Grid(
            width=columns,
            height=rows,
            base=base,
            resolution=side,
            origin=self.origin,
            blocked=np.flatnonzero(blocked).tolist(),
            connectivity=connectivity,
            through_corners=through_corners,
            yaw=self.yaw,
        )

    def _blocked(
        self, rows: int, columns: int, pixels: float, unknown_blocks: bool
    ) -> NDArray[np.bool_]:
        """Return which cells have a pixel that blocks, shape (rows, columns)."""
        row_start, row_stop = pixels_under(rows, pixels)
        column_start, column_stop = pixels_under(columns, pixels)
        blocking = np.full((row_stop[-1], column_stop[-1]), unknown_blocks)
        height, width = self.data.shape
        blocking[:height, :width] = self.data == OCCUPIED
        if unknown_blocks:
            blocking[:height, :width] |= self.data == UNKNOWN
        # The number of blocking pixels below and left of each corner, so that the pixels of a cell
        # are counted from its four.
        count = np.zeros((blocking.shape[0] + 1, blocking.shape[1] + 1), dtype=np.int64)
        count[1:, 1:] = blocking.cumsum(axis=0, dtype=np.int64).cumsum(axis=1)
        in_rows = count[row_stop] - count[row_start]
        in_cells: NDArray[np.int64] = in_rows[:, column_stop] - in_rows[:, column_start]
        return in_cells > 0
