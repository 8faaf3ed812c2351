# SPDX-License-Identifier: Apache-2.0
"""Conversion of orders to legs for Nav2, and of positions to steps of a walk."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from itertools import pairwise

from kbnitp_ros.core import Grid
import numpy as np

# The cells of a goal, the robot's cell first; for a stay, the robot's cell twice.
Leg = tuple[int, ...]


def split_legs(path: Sequence[int]) -> list[Leg]:
    """Split a path into legs, one for each goal of Nav2."""
    # Nav2 ends a goal near its last pose, and takes the nearest point of a path as the place of
    # the robot. So no leg may enter a cell twice, and each stay is a leg.
    legs: list[Leg] = []
    leg = [path[0]]
    for before, cell in pairwise(path):
        if cell in leg:
            if len(leg) > 1:
                legs.append(tuple(leg))
            leg = [before]
        if cell == before:
            legs.append((cell, cell))
        else:
            leg.append(cell)
    if len(leg) > 1:
        legs.append(tuple(leg))
    return legs


def without_loops(cells: Iterable[int]) -> list[int]:
    """Return the way through these cells without its loops."""
    way: dict[int, None] = {}
    for cell in cells:
        if cell in way:
            while next(reversed(way)) != cell:
                way.popitem()
        else:
            way[cell] = None
    return list(way)


def steps_within(cells: Sequence[int], most: int) -> list[int]:
    """Choose at most `most` steps of a walk to report; return their numbers."""
    # Report the start of the walk as far as possible, and then, for each cell, the step by which
    # the robot last left the cell: these steps lead home without loops.
    steps = len(cells) - 1
    if steps <= most:
        return list(range(1, steps + 1))
    last = {cell: number for number, cell in enumerate(cells)}
    steps_home = {cells[steps]: 0}
    for number in range(steps - 1, -1, -1):
        if last[cells[number]] == number:
            steps_home[cells[number]] = 1 + steps_home[cells[number + 1]]
    kept = max(number for number in range(most + 1) if number + steps_home[cells[number]] <= most)
    numbers = list(range(1, kept + 1))
    at = last[cells[kept]]
    while at < steps:
        numbers.append(at + 1)
        at = last[cells[at + 1]]
    return numbers


def shortest_way(grid: Grid, start: int, end: int) -> list[int]:
    """Return the cells of a way with the fewest steps, both ends included."""
    came_from = {start: start}
    frontier = deque([start])
    while frontier and end not in came_from:
        cell = frontier.popleft()
        for neighbor in grid.neighbors(cell).tolist():
            if neighbor not in came_from:
                came_from[neighbor] = cell
                frontier.append(neighbor)
    if end not in came_from:
        raise ValueError(f'no way leads from cell {start} to cell {end}')
    way = [end]
    while way[-1] != start:
        way.append(came_from[way[-1]])
    return way[::-1]


class Itinerary:
    """The legs of a deployment in order, and the way home if they fail."""

    # After too many tries without a new cell the robot goes home: first back along its walk
    # without loops, then alternately by the shortest way and along its walk.

    def __init__(self, grid: Grid, path: Sequence[int], attempts: int) -> None:
        self._grid = grid
        self._legs = split_legs(path) if path else []
        self._attempts = attempts
        # Number of tries of the leg without progress, and number of the leg's cells entered.
        self._tried = 0
        self._entered = 1
        self.heads_home = not self._legs

    @property
    def is_stay(self) -> bool:
        """Return whether the next leg is a stay."""
        return not self.heads_home and self._legs[0][0] == self._legs[0][-1]

    @property
    def is_last_try(self) -> bool:
        """Return whether another failure without a new cell exhausts the tries."""
        return self._tried + 1 >= self._attempts

    @property
    def destination(self) -> int:
        """Return the last cell of the next goal."""
        return self._grid.base if self.heads_home else self._legs[0][-1]

    def next_leg(self, walk: Sequence[int]) -> Leg:
        """Return the cells of the next goal, from the last cell of the walk so far."""
        if self.heads_home:
            is_turn_of_shortest = self._tried // self._attempts % 2 == 1
            if is_turn_of_shortest:
                return tuple(shortest_way(self._grid, walk[-1], self._grid.base))
            return tuple(without_loops(reversed(walk)))
        first = self._entered
        return (walk[-1], *self._legs[0][first:])

    def enter(self, cell: int) -> None:
        """Record that the robot has entered a cell."""
        if self.heads_home:
            self._tried = 0
        elif self._entered < len(self._legs[0]) and cell == self._legs[0][self._entered]:
            self._entered += 1
            self._tried = 0

    def succeed(self) -> None:
        """Record that the robot has reached the end of the leg."""
        if self._legs:
            self._legs.pop(0)
        self._begin_leg()

    def fail(self) -> None:
        """Count a failed try of the leg; after the last try, go home."""
        self._tried += 1
        if not self.heads_home and self._tried >= self._attempts:
            self.go_home()

    def go_home(self) -> None:
        """Skip the rest of the path."""
        self._legs.clear()
        self._begin_leg()

    def _begin_leg(self) -> None:
        self._tried, self._entered = 0, 1
        self.heads_home = not self._legs


# Distance beyond the edge of a cell, in sides of a cell, up to which a robot counts as inside: a
# robot on an edge must not change cells all the time, and a robot that passes a corner diagonally
# must not enter the cells beside it.
MARGIN = 0.2


class Walk:
    """The walk of a robot: its current cell, and the cells that it enters."""

    def __init__(self, grid: Grid, cell: int, patience: float) -> None:
        self.grid = grid
        self.cell = cell
        self._patience = patience
        # Time at which the robot seemed to jump; None if it did not.
        self._away_since: float | None = None

    def follow(self, x: float, y: float, time: float) -> list[int]:
        """Return the cells entered on the way to a position (metres) at a time (seconds)."""
        if self._off_middle(x, y) <= 0.5 + MARGIN:
            self._away_since = None
            return []
        cell = self.cell_at(x, y)
        row, col = divmod(self.cell, self.grid.width)
        to_row, to_col = divmod(cell, self.grid.width)
        if max(abs(to_row - row), abs(to_col - col)) > 1:
            if self._away_since is None:
                self._away_since = time
            if time - self._away_since < self._patience:
                raise ValueError(
                    f'the robot seems to have jumped from cell {self.cell} to cell {cell}, '
                    f'({x:.2f}, {y:.2f}): the new position is accepted if it lasts for '
                    f'{self._patience} s (parameter tf_timeout)'
                )
        return self._come_to(cell)

    def _come_to(self, cell: int) -> list[int]:
        """Move to a cell; return the cells entered on a shortest way."""
        way = shortest_way(self.grid, self.cell, cell)[1:]
        self.cell, self._away_since = cell, None
        return way

    def _off_middle(self, x: float, y: float) -> float:
        """Return the larger of the x and y offsets from the middle of the cell, in cell sides."""
        row, col = divmod(self.cell, self.grid.width)
        place = self.grid.in_cells([x, y]) - (col, row)
        return float(np.abs(place - 0.5).max())

    def sees_its_cell(self, x: float, y: float) -> bool:
        """Return whether a robot is so far inside its cell that detections are of that cell."""
        return self._off_middle(x, y) <= 0.5 - MARGIN

    def settle(self, x: float, y: float) -> list[int]:
        """Return the cells entered by a robot that stands still; its place needs no margin."""
        return self._come_to(self.cell_at(x, y))

    def cell_at(self, x: float, y: float) -> int:
        """Return the cell at a position."""
        cell = int(self.grid.cells_at([[x, y]])[0])
        if cell in self.grid.blocked:
            raise ValueError(f'point ({x}, {y}) is in cell {cell}, which is blocked')
        return cell
