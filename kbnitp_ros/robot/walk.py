# SPDX-License-Identifier: Apache-2.0
"""From the positions of a robot to the cells of its walk."""

from __future__ import annotations

from math import hypot

from kbnitp_ros.core import Grid
from kbnitp_ros.robot.way import shortest_way
import numpy as np

# How far beyond the edge of its cell a robot must be to have left it, in sides of a cell: one that
# drives along the edge does not go back and forth between the two, and one that passes a corner on
# its diagonal is not in the cells beside it.
MARGIN = 0.2


class Walk:
    """The cell that a robot is in, and the steps that take it to the next."""

    def __init__(self, grid: Grid, cell: int, patience: float, max_speed: float = 0.0) -> None:
        self.grid = grid
        self.cell = cell
        # Why the cells of this walk may be others: the last jump that counts and that the robot
        # cannot have made; empty without any.
        self.doubt = ''
        self._patience = patience
        self._max_speed = max_speed
        # Where and when it was last seen where it can be: x, y and time.
        self._seen: tuple[float, float, float] | None = None
        # Since when the robot seems to have jumped.
        self._away_since: float | None = None

    def follow(self, x: float, y: float, time: float) -> list[int]:
        """Return the cells that a robot entered up to a position, in metres, at a time."""
        if self._off_middle(x, y) <= 0.5 + MARGIN:
            return self._come_to(self.cell, x, y, time)
        cell = self.cell_at(x, y)
        row, col = divmod(self.cell, self.grid.width)
        to_row, to_col = divmod(cell, self.grid.width)
        if max(abs(to_row - row), abs(to_col - col)) > 1:
            if self._away_since is None:
                self._away_since = time
            if time - self._away_since < self._patience:
                raise ValueError(
                    f'the robot seems to have jumped from cell {self.cell} to cell {cell}, '
                    f'({x:.2f}, {y:.2f}): that counts if it lasts for {self._patience} s'
                )
            self.doubt = self._doubt_of(x, y, time) or self.doubt
        return self._come_to(cell, x, y, time)

    def _come_to(self, cell: int, x: float, y: float, time: float) -> list[int]:
        """Have the robot be in a cell; return those that it has entered on a shortest way."""
        way = shortest_way(self.grid, self.cell, cell)[1:]
        self.cell, self._seen, self._away_since = cell, (x, y, time), None
        return way

    def _doubt_of(self, x: float, y: float, time: float) -> str:
        """Return that a robot cannot have come to a position by now; empty if it can."""
        if self._seen is None or not self._max_speed:
            return ''
        from_x, from_y, since = self._seen
        distance, seconds = hypot(x - from_x, y - from_y), time - since
        # Localisation that corrects itself by less than a cell is as good as that.
        if distance <= self._max_speed * seconds + self.grid.resolution:
            return ''
        return (
            f'a jump from ({from_x:.2f}, {from_y:.2f}) to ({x:.2f}, {y:.2f}), {distance:.1f} m in '
            f'{seconds:.2f} s, and the robot makes {self._max_speed} m/s (parameter max_speed)'
        )

    def _off_middle(self, x: float, y: float) -> float:
        """Return how far a position is from the middle of the cell, along x or y, in its sides."""
        row, col = divmod(self.cell, self.grid.width)
        place = self.grid.in_cells([x, y]) - (col, row)
        return float(np.abs(place - 0.5).max())

    def sees_its_cell(self, x: float, y: float) -> bool:
        """Return whether a robot is so far within its cell that what it sees is there."""
        return self._off_middle(x, y) <= 0.5 - MARGIN

    def settle(self, x: float, y: float) -> list[int]:
        """Return the cells entered by a robot that has come to rest: then no margin counts."""
        cell = self.cell_at(x, y)
        way = shortest_way(self.grid, self.cell, cell)[1:]
        self.cell = cell
        return way

    def cell_at(self, x: float, y: float) -> int:
        """Return the cell at a position."""
        cell = int(self.grid.cells_at([[x, y]])[0])
        if cell in self.grid.blocked:
            raise ValueError(f'point ({x}, {y}) is in cell {cell}, which is blocked')
        return cell
