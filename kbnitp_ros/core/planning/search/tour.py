# SPDX-License-Identifier: Apache-2.0
"""Tours of the cells that earlier robots visited least, to compare planners with."""

from __future__ import annotations

from collections.abc import Callable

from kbnitp_ros.core.field import Grid
from kbnitp_ros.core.planning.objective import SearchOptions
import numpy as np
from numpy.typing import NDArray

# What of the steps to each cell, shape (cells,), makes one come before another: lower is first.
Order = Callable[[NDArray[np.intp]], NDArray[np.intp]]


def boustrophedon(grid: Grid) -> Order:
    """Return the order of a field that is ploughed: row after row, every second one backwards."""
    row, col = np.divmod(np.arange(grid.cells), grid.width)
    place = row * grid.width + np.where(row % 2, grid.width - 1 - col, col)
    return lambda _: place


def nearest(steps: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the order in which the nearest cell comes first."""
    return steps


def tour(
    grid: Grid, options: SearchOptions, visited: NDArray[np.intp], order: Order
) -> NDArray[np.intp]:
    """Return a closed path through cells that were visited least, each by the shortest way."""
    max_steps, max_visits = options.max_steps, options.max_visits
    wanted: NDArray[np.bool_] = grid.in_reach(max_steps)
    wanted[grid.base] = False
    if wanted.any():
        wanted &= visited == visited[wanted].min()
    path, home = [grid.base], [grid.base]
    entered: NDArray[np.intp] = np.zeros(grid.cells, dtype=np.intp)
    while wanted.any():
        steps = grid.steps_from(path[-1], is_open(grid, entered, max_visits))
        candidates = np.flatnonzero(
            wanted
            & (steps < grid.cells)
            & (len(path) - 1 + steps + grid.steps_to_base <= max_steps)
        )
        if not candidates.size:
            break
        target = int(candidates[np.argmin(order(steps)[candidates])])
        leg = way(grid, steps, target)
        after = entered + np.bincount(leg, minlength=grid.cells)
        back = grid.steps_from(target, is_open(grid, after, max_visits, home=True))
        wanted[target] = False
        home_again = back[grid.base]
        if home_again < grid.cells and len(path) - 1 + len(leg) + home_again <= max_steps:
            path += leg
            entered = after
            wanted[leg] = False
            home = way(grid, back, grid.base)
    return np.array(path + home, dtype=np.intp)


def is_open(
    grid: Grid, entered: NDArray[np.intp], max_visits: int, *, home: bool = False
) -> NDArray[np.bool_]:
    """Return which cells may be entered once more; the base only on the way home."""
    result: NDArray[np.bool_] = grid.free & (entered < max_visits)
    result[grid.base] = home
    return result


def way(grid: Grid, steps: NDArray[np.intp], target: int) -> list[int]:
    """Return a shortest way, without its start, from the steps from there to each cell."""
    cells = [target]
    while steps[cells[-1]] > 1:
        around = grid.neighbors(cells[-1])
        cells.append(int(around[np.argmax(steps[around] == steps[cells[-1]] - 1)]))
    return cells[::-1]
