# SPDX-License-Identifier: Apache-2.0
"""Where a robot that is out goes next, also when what drives it fails."""

from __future__ import annotations

from collections.abc import Sequence

from kbnitp_ros.core import Grid
from kbnitp_ros.robot.way import Leg, legs_of, shortest_way, without_loops


class Itinerary:
    """The legs of a deployment, one after another, and the way home when they cannot be made."""

    # After too many tries without a new cell the robot goes home the way it came, without loops,
    # and then by the shortest way and the way it came in turns.

    def __init__(self, grid: Grid, path: Sequence[int], attempts: int) -> None:
        self._grid = grid
        self._legs = legs_of(path) if path else []
        self._attempts = attempts
        # How often the leg was tried without progress, and how many of its cells were entered.
        self._tried = 0
        self._entered = 1
        self.heads_home = not self._legs

    @property
    def is_stay(self) -> bool:
        """Whether the robot is to wait where it is."""
        return not self.heads_home and self._legs[0][0] == self._legs[0][-1]

    @property
    def destination(self) -> int:
        """Return the cell where the next goal ends."""
        return self._grid.base if self.heads_home else self._legs[0][-1]

    def next_leg(self, walk: Sequence[int]) -> Leg:
        """Return the cells of the next goal; the first of them is the last of the walk so far."""
        if self.heads_home:
            is_turn_of_shortest = self._tried // self._attempts % 2 == 1
            if is_turn_of_shortest:
                return tuple(shortest_way(self._grid, walk[-1], self._grid.base))
            return tuple(without_loops(reversed(walk)))
        first = self._entered
        return (walk[-1], *self._legs[0][first:])

    def enter(self, cell: int) -> None:
        """Take note that the robot has come to a cell."""
        if self.heads_home:
            self._tried = 0
        elif self._entered < len(self._legs[0]) and cell == self._legs[0][self._entered]:
            self._entered += 1
            self._tried = 0

    def succeed(self) -> None:
        """Take note that the robot is where the leg ends."""
        if self._legs:
            self._legs.pop(0)
        self._begin_leg()

    def fail(self) -> None:
        """Take note that the leg was not made."""
        self._tried += 1
        if not self.heads_home and self._tried >= self._attempts:
            self.go_home()

    def go_home(self) -> None:
        """Leave out what is left of the path."""
        self._legs.clear()
        self._begin_leg()

    def _begin_leg(self) -> None:
        self._tried, self._entered = 0, 1
        self.heads_home = not self._legs
