# SPDX-License-Identifier: Apache-2.0
"""The field as a grid of cells, and the paths a robot may take on it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from hashlib import sha256
from itertools import pairwise
from math import cos, inf, isfinite, pi, remainder, sin, sqrt, tau
import struct

from kbnitp_ros.core.field.check import (
    as_floats,
    cell_numbers,
    cost,
    flag,
    in_short,
    number,
    on_field,
    read_only,
    whole_number,
    whole_numbers,
)
from kbnitp_ros.core.field.observation import as_path
import numpy as np
from numpy.typing import ArrayLike, NDArray

# Number of parts of a cell that coordinates must resolve, so that rounding over several steps
# moves no point to the next cell.
APART = 1000
EPSILON = float(np.finfo(np.float64).eps)

# Angles of fields are equal if they are equal in picoradians.
PICO = 1e12

# Relative tolerance of a path's length, for rounded sums.
ROUNDING = 1e-9

# Row and column offsets of the neighbour in each column of `Grid.neighbor_table`, (2, 9).
STEPS = np.divmod(np.arange(9), 3) - np.ones((2, 1), dtype=int)

# Maximum number of blocked cells shown by `str`.
MAX_BLOCKED_SHOWN = 8


@dataclass(frozen=True)
class Grid:
    """
    A rectangle of square cells with a base that robots leave from and return to.

    Cells are numbered ``row * width + col``, row 0 at the bottom, as in nav_msgs/OccupancyGrid.
    The rows may be turned in the frame of the positions (`yaw`).

    Parameters
    ----------
    width, height : int
        Cells in a row and in a column, at least 1 each.
    base : int
        The cell that paths start and end in: not blocked, and without a hazard.
    resolution : float
        Side of a cell in metres, positive.
    origin : tuple of float
        Lower-left corner of cell 0 in metres, near enough to 0 for coordinates to resolve a cell.
    blocked : iterable of int or array_like of bool
        Cells that no robot can enter, known beforehand: cell numbers, or a mask of shape (cells,)
        or (height, width). Targets are not sought there.
    connectivity : int
        Number of neighbours that a step may lead to: 8, or the 4 that share a side.
    through_corners : bool
        Whether a diagonal step may touch a blocked cell, as in arXiv:2305.06929. If False, both
        cells beside the step must be free.
    other_bases : iterable of int
        Further bases, selected by `at`: not blocked, and without a hazard.
    yaw : float
        The angle from the frame's x axis to the rows, counterclockwise, in rad.

    Raises
    ------
    ValueError
        If a size, a base, the resolution, the origin, a blocked cell, the connectivity or the yaw
        is out of range.

    """

    width: int
    height: int
    base: int = 0
    resolution: float = 1.0
    origin: tuple[float, float] = (0.0, 0.0)
    blocked: Iterable[int] | NDArray[np.bool_] = ()
    connectivity: int = 8
    through_corners: bool = True
    other_bases: Iterable[int] = ()
    yaw: float = 0.0

    def __post_init__(self) -> None:
        width = whole_number('grid width', self.width, 1)
        height = whole_number('grid height', self.height, 1)
        last = width * height - 1
        blocked = frozenset(cell_numbers('blocked', self.blocked, height, width))
        base = whole_number('base', self.base, 0, last)
        others = whole_numbers('other_bases', self.other_bases, 'base', 0, last)
        for cell in (base, *others):
            if cell in blocked:
                raise ValueError(
                    f'base is {cell}: it must be a free cell, and this cell is blocked'
                )
        resolution = number(
            'resolution', self.resolution, 'positive, in metres', lambda r: 0.0 < r < inf
        )
        # Of objects: lists of different lengths are no numbers either.
        if np.shape(np.array(self.origin, dtype=object)) != (2,):
            raise ValueError(
                f'origin is {in_short(self.origin)}: it must be two finite numbers, in metres'
            )
        origin = tuple(
            number('origin', each, 'two finite numbers, in metres', isfinite)
            for each in self.origin
        )
        reach = max(map(abs, origin)) + max(width, height) * resolution
        if not reach * EPSILON * APART <= resolution:
            raise ValueError(
                f'origin is {self.origin}: cells of {resolution} m cannot be told apart that '
                f'far out; it must be within {resolution / (APART * EPSILON):.3g} m'
            )
        connectivity = number('connectivity', self.connectivity, '4 or 8', {4.0, 8.0}.__contains__)
        vars(self).update(
            width=width,
            height=height,
            base=base,
            resolution=resolution,
            origin=origin,
            blocked=blocked,
            connectivity=int(connectivity),
            through_corners=flag('through_corners', self.through_corners),
            other_bases=frozenset(others) - {base},
            yaw=number('yaw', self.yaw, 'finite, in rad', isfinite),
        )

    def __str__(self) -> str:
        """Return the call that makes this grid, with the first few of its blocked cells."""
        blocked = sorted(self.blocked)
        first = ', '.join(map(str, blocked[:MAX_BLOCKED_SHOWN]))
        more = f', ... {len(blocked)} in all' if len(blocked) > MAX_BLOCKED_SHOWN else ''
        rest = (
            f'width={self.width}, height={self.height}, base={self.base}, '
            f'resolution={self.resolution}, origin={self.origin}, yaw={self.yaw}, '
            f'connectivity={self.connectivity}, through_corners={self.through_corners}'
        )
        others = f', other_bases={sorted(self.other_bases)}' if self.other_bases else ''
        return f'Grid({rest}, blocked=[{first}{more}]{others})'

    @property
    def cells(self) -> int:
        """Return the number of cells."""
        return self.width * self.height

    @cached_property
    def id(self) -> str:  # noqa: A003
        """
        Return the name of the field, 16 hex digits, the same in all nodes with the same field.

        It is the beginning of the SHA-256 hash of little-endian numbers without padding: width and
        height (uint32), resolution in metres (float32), origin x and y in metres (float64), yaw in
        picoradians (int64, above -pi), connectivity and through_corners (uint8), number of blocked
        cells (uint32), and the blocked cells in ascending order (uint32). Bases are not part of
        it.
        """
        yaw = round(remainder(self.yaw, tau) * PICO)
        x, y = (coordinate + 0.0 for coordinate in self.origin)
        numbers = struct.pack(
            '<2If2dq2BI',
            self.width,
            self.height,
            self.resolution,
            x,
            y,
            # Left and right half turns are the same angle.
            abs(yaw) if abs(yaw) > pi * PICO else yaw,
            self.connectivity,
            self.through_corners,
            len(frozenset(self.blocked)),
        )
        blocked = np.array(sorted(self.blocked), dtype='<u4').tobytes()
        return sha256(numbers + blocked).hexdigest()[:16]

    @cached_property
    def free(self) -> NDArray[np.bool_]:
        """Return a mask of the cells that a robot can enter, shape (cells,)."""
        free = np.ones(self.cells, dtype=bool)
        free[list(self.blocked)] = False
        return read_only(free)

    @cached_property
    def may_be_hazardous(self) -> NDArray[np.bool_]:
        """Return a mask of cells that may have a hazard, (cells,): free cells except bases."""
        may_be = self.free.copy()
        may_be[list(self.bases)] = False
        return read_only(may_be)

    @property
    def bases(self) -> frozenset[int]:
        """Return the cells that robots leave from and return to."""
        return frozenset(self.other_bases) | {self.base}

    def at(self, base: int | None) -> Grid:
        """Return the grid with another of its bases as `base`; None keeps the base."""
        base = self.base if base is None else whole_number('base', base, 0)
        if base == self.base:
            return self
        if base not in self.bases:
            raise ValueError(
                f'base {base} is not a base of the grid, which has {sorted(self.bases)}: add it '
                'to other_bases, so that its cell counts as free of hazard'
            )
        if base not in self._at:
            self._at[base] = replace(self, base=base, other_bases=self.bases)
        return self._at[base]

    @cached_property
    def _at(self) -> dict[int, Grid]:
        # One grid for each base, so that the distances to a base are computed only once.
        return {}

    @cached_property
    def around(self) -> NDArray[np.intp]:
        """Return the eight cells around every cell, whatever may be entered; -1 for none."""
        row, col = np.divmod(np.arange(self.cells)[:, None], self.width)
        row, col = (each + np.delete(step, 4) for each, step in zip((row, col), STEPS))
        inside = (row >= 0) & (row < self.height) & (col >= 0) & (col < self.width)
        return read_only(np.where(inside, row * self.width + col, -1))

    @cached_property
    def neighbor_table(self) -> NDArray[np.intp]:
        """Return the neighbours of every cell, ascending, -1 for none. Shape (cells, 9)."""
        row, col = np.divmod(np.arange(self.cells), self.width)
        step_row, step_col = STEPS
        to_row = row[:, None] + step_row
        to_col = col[:, None] + step_col
        inside = (to_row >= 0) & (to_row < self.height) & (to_col >= 0) & (to_col < self.width)
        table = np.where(inside, to_row * self.width + to_col, -1)
        table[~self.free[table] | ~self.free[:, None]] = -1
        diagonal = (step_row != 0) & (step_col != 0)
        if self.connectivity == 4:
            table[:, diagonal] = -1
        elif not self.through_corners:
            beside = (table[:, 4 + step_col] < 0) | (table[:, 4 + 3 * step_row] < 0)
            table[beside & diagonal] = -1
        return read_only(table)

    @cached_property
    def step_lengths(self) -> NDArray[np.float64]:
        """Return the metres of a step by column of `neighbor_table`, (9,); 0 for a stay."""
        return read_only(np.hypot(*STEPS) * self.resolution)

    def cell(self, row: int, col: int) -> int:
        """
        Return the number of a cell; row 0 is at the bottom.

        Raises
        ------
        ValueError
            If the row or the column is not on the grid.

        """
        row = whole_number('row', row, 0, self.height - 1)
        return row * self.width + whole_number('col', col, 0, self.width - 1)

    def row_col(self, cell: int) -> tuple[int, int]:
        """
        Return the row and the column of a cell.

        Raises
        ------
        ValueError
            If `cell` is not on the grid.

        """
        return divmod(whole_number('cell', cell, 0, self.cells - 1), self.width)

    def neighbors(self, cell: int) -> NDArray[np.intp]:
        """
        Return the cells one step away, `cell` itself among them.

        Raises
        ------
        ValueError
            If `cell` is not on the grid.

        """
        row = self.neighbor_table[whole_number('cell', cell, 0, self.cells - 1)]
        neighbors: NDArray[np.intp] = row[row >= 0]
        return neighbors

    @cached_property
    def steps_to_base(self) -> NDArray[np.intp]:
        """Return the fewest steps from each cell to the base, (cells,); `cells` if unreachable."""
        return read_only(self.steps_from(self.base, self.free))

    def steps_from(self, cell: int, is_open: NDArray[np.bool_]) -> NDArray[np.intp]:
        """Return the fewest steps from `cell` through open cells, (cells,); `cells` if cut off."""
        steps = np.full(self.cells, self.cells, dtype=np.intp)
        frontier = np.array([cell])
        distance = 0
        while frontier.size:
            steps[frontier] = distance
            around = np.unique(self.neighbor_table[frontier])
            around = around[around >= 0]
            frontier = around[is_open[around] & (steps[around] == self.cells)]
            distance += 1
        return steps

    @cached_property
    def distance_to_base(self) -> NDArray[np.float64]:
        """Return the distance of each cell to the base, (cells,), metres; inf if unreachable."""
        distance = np.full(self.cells, np.inf)
        distance[self.base] = 0.0
        nearer = np.array([self.base])
        while nearer.size:
            around = self.neighbor_table[nearer]
            through = distance[nearer, None] + self.step_lengths
            # Differences of rounding are ignored.
            is_nearer = (around >= 0) & (through * (1.0 + ROUNDING) < distance[around])
            np.minimum.at(distance, around[is_nearer], through[is_nearer])
            nearer = np.unique(around[is_nearer])
        return read_only(distance)

    def in_reach(self, max_steps: int, max_distance: float = 0.0) -> NDArray[np.bool_]:
        """Return a mask, (cells,), of cells that paths within limits can visit; 0 m: no limit."""
        steps = self.steps_to_base
        in_reach = (2 * steps <= whole_number('max_steps', max_steps, 0)) & (steps < self.cells)
        if cost('max_distance', max_distance):
            in_reach &= 2.0 * self.distance_to_base <= longest(max_distance)
            in_reach[in_reach] = self._within_both(in_reach, max_steps, longest(max_distance))
        return in_reach

    def _within_both(
        self, cells: NDArray[np.bool_], max_steps: int, most: float
    ) -> NDArray[np.bool_]:
        """Return which of some cells a closed path of both limits can visit, (cells.sum(),)."""
        # Shortest ways of at most k steps to each cell; one entry stands for cells off the grid.
        metres = np.full(self.cells + 1, np.inf)
        metres[self.base] = 0.0
        place = np.flatnonzero(cells)
        table = self.neighbor_table[place]
        by_steps = [metres[place]]
        for _ in range(max_steps):
            nearer = metres.copy()
            nearer[place] = (metres[table] + self.step_lengths).min(axis=1)
            if (nearer == metres).all():
                break
            metres = nearer
            by_steps.append(metres[place])
        # Longer ways are no shorter, so that the last entry is that of all further steps.
        last = len(by_steps) - 1
        within: NDArray[np.bool_] = np.any(
            [
                by_steps[min(there, last)] + by_steps[min(max_steps - there, last)] <= most
                for there in range(min(last, max_steps) + 1)
            ],
            axis=0,
        )
        return within

    def path_length(self, path: NDArray[np.intp]) -> float:
        """Return the length of a path, shape (steps + 1,), in metres."""
        row, col = np.divmod(on_field('path', path, self.cells), self.width)
        moves = np.abs(np.diff(row)) + np.abs(np.diff(col))
        straight, diagonal = (moves == 1).sum(), (moves == 2).sum()
        return float((straight + sqrt(2.0) * diagonal) * self.resolution)

    def check_path(
        self, path: ArrayLike, max_steps: int | None = None, max_distance: float = 0.0
    ) -> NDArray[np.intp]:
        """Return `path` as an array of cells; raise ValueError if it is invalid on this grid."""
        cells = as_path(path)
        steps = len(cells) - 1
        if max_steps is not None and steps > whole_number('max_steps', max_steps, 1):
            raise ValueError(
                f'path has {steps} steps: at most max_steps = {max_steps} are allowed'
            )
        self.check_cells(cells)
        for end, cell in (('start', cells[0]), ('end', cells[-1])):
            if cell != self.base:
                raise ValueError(f'path must {end} at the base {self.base}, not at cell {cell}')
        self.check_steps(cells)
        most = longest(cost('max_distance', max_distance))
        if most and (length := self.path_length(cells)) > most:
            raise ValueError(
                f'path is {length:.6g} m long: '
                f'at most max_distance = {max_distance:.6g} m is allowed'
            )
        return cells

    def check_cells(self, cells: NDArray[np.intp]) -> None:
        """Check that the cells of a path are free cells of this grid."""
        listed = cells.tolist()
        if min(listed) < 0 or max(listed) >= self.cells:
            place = int(np.argmax((cells < 0) | (cells >= self.cells)))
            raise ValueError(
                f'path leaves the grid: its cell at index {place} is {cells[place]}, '
                f'allowed are 0 to {self.cells - 1}'
            )
        if not frozenset(self.blocked).isdisjoint(listed):
            place = int(self.free[cells].argmin())
            raise ValueError(f'path enters a blocked cell: at index {place} it is {cells[place]}')

    def check_steps(self, cells: NDArray[np.intp]) -> None:
        """Check that each step of a path stays or leads to a neighbour."""
        for step, (here, there) in enumerate(pairwise(cells.tolist()), 1):
            near = self._near.get(here)
            if near is None:
                near = self._near[here] = frozenset(self.neighbors(here).tolist())
            if there not in near:
                raise ValueError(
                    f'path jumps at step {step}, from cell {here} to {there}: '
                    f'a step stays or leads to one of {sorted(near)}'
                )

    @cached_property
    def _near(self) -> dict[int, frozenset[int]]:
        # The neighbours of cells, as they are needed: faster for paths than arrays.
        return {}

    def check_any_path(self, path: ArrayLike) -> NDArray[np.intp]:
        """Return `path` as an array of cells, checked as a path from one of the bases."""
        cells = as_path(path)
        base = int(cells[0])
        return (self.at(base) if base in self.bases else self).check_path(cells)

    def in_metres(self, places: ArrayLike) -> NDArray[np.float64]:
        """Convert columns and rows to x and y in the frame, (..., 2); (0, 0) gives `origin`."""
        return np.add(turned(np.asarray(places) * self.resolution, self.yaw), self.origin)

    def in_cells(self, points: ArrayLike) -> NDArray[np.float64]:
        """Convert x and y in metres to columns and rows, (..., 2); the inverse of `in_metres`."""
        return turned(np.asarray(points) - np.array(self.origin), -self.yaw) / self.resolution

    def centers(self, cells: ArrayLike) -> NDArray[np.float64]:
        """Return the centres of `cells`, shape (n,), in metres, as x and y, shape (n, 2)."""
        row, col = np.divmod(on_field('cells', cells, self.cells), self.width)
        return self.in_metres(np.stack([col, row], axis=-1) + 0.5)

    def cells_at(self, points: ArrayLike) -> NDArray[np.intp]:
        """Return the cells of points, (n, 2) in metres; raise ValueError outside the grid."""
        array = as_floats('points', points)
        if array.ndim != 2 or array.shape[1] != 2:
            raise ValueError(f'points have shape {array.shape}: it must be (n, 2), x and y')
        with np.errstate(invalid='ignore', over='ignore'):
            place = np.floor(self.in_cells(array))
            inside = ((place >= 0) & (place < (self.width, self.height))).all(axis=1)
        if not inside.all():
            x, y = array[np.argmin(inside)]
            turn = f', turned by {self.yaw} rad' if self.yaw else ''
            raise ValueError(
                f'point ({x}, {y}) is outside the grid of {self.width} x {self.height} cells of '
                f'{self.resolution} m from {self.origin}{turn}'
            )
        return place.astype(np.intp) @ (1, self.width)


def longest(max_distance: float) -> float:
    """Return the maximum sum of step lengths for a limit in metres, with a margin for rounding."""
    return max_distance * (1.0 + ROUNDING)


def turned(vectors: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
    """Return vectors x, y, shape (..., 2), turned counterclockwise by an angle in rad."""
    x, y = vectors[..., 0], vectors[..., 1]
    c, s = cos(angle), sin(angle)
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)
