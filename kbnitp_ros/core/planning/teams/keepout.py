# SPDX-License-Identifier: Apache-2.0
"""What robots keep off when plans are refused, so that the next are of another region."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from kbnitp_ros.core.field import Grid
import numpy as np
from numpy.typing import ArrayLike, NDArray


def regions_of(grid: Grid, path: ArrayLike) -> list[NDArray[np.intp]]:
    """Return the region that a path is sent to, and smaller ones in its place."""
    cells = np.unique(np.asarray(path, dtype=np.intp))
    steps = grid.at(int(np.asarray(path)[0])).steps_to_base
    farthest = cells[[np.argmax(steps[cells])]]

    def far(cells: NDArray[np.intp]) -> NDArray[np.intp]:
        kept: NDArray[np.intp] = cells[2 * steps[cells] > steps[farthest]]
        return kept[~np.isin(kept, list(grid.bases))]

    def around(cells: NDArray[np.intp]) -> NDArray[np.intp]:
        neighbors: list[NDArray[np.intp]] = [grid.neighbors(cell) for cell in cells]
        together: NDArray[np.intp] = np.unique(np.concatenate([cells, *neighbors]))
        return together

    half = far(cells)
    return [far(around(half)), half, far(around(farthest)), far(farthest)]


def without(grid: Grid, cells: Iterable[int]) -> Grid:
    """Return the grid on which robots keep off these cells as well."""
    return replace(grid, blocked=tuple({*grid.blocked, *map(int, cells)}))


def keepout_cells(
    grid: Grid,
    max_steps: int,
    bases: Sequence[int | None],
    rounds: Sequence[Sequence[ArrayLike]],
    max_distance: float = 0.0,
) -> NDArray[np.intp]:
    """
    Return the cells that the next robots keep off after rounds of plans were refused.

    Parameters
    ----------
    grid : Grid
        The field.
    max_steps : int
        The most steps of a path.
    bases : sequence of int or None
        Where each robot starts that leaves next; None for the base of the grid.
    rounds : sequence of sequence of array_like of int
        The paths that were refused, one round after another.
    max_distance : float
        The longest path, metres; 0 for no limit.

    Returns
    -------
    ndarray of int
        The regions of all of them. When these leave fewer cells in reach than there are robots, or
        cut off half of those that are of no region, the last round has smaller ones; when that
        does not help, the earlier rounds are forgotten.

    """

    def left(cells: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return how many cells are left in reach of each base and, last, of any."""
        open_grid = without(grid, cells)
        in_reach = [
            open_grid.at(base).in_reach(max_steps, max_distance) for base in dict.fromkeys(bases)
        ]
        in_reach.append(np.any(in_reach, axis=0))
        sizes: NDArray[np.intp] = np.sum(in_reach, axis=1)
        return sizes

    in_reach = left(np.empty(0, dtype=np.intp))[-1]
    kept: NDArray[np.intp] = np.empty(0, dtype=np.intp)
    for paths in rounds:
        sizes = [
            np.unique(np.concatenate(each))
            for each in zip(*(regions_of(grid, path) for path in paths))
        ]
        for cells in (*(np.union1d(kept, size) for size in sizes), *sizes, kept[:0]):
            *of_each, of_all = left(cells).tolist()
            # A base is always in reach from itself.
            is_enough = of_all > len(bases) and min(of_each) > 1
            if is_enough and 2 * of_all > in_reach - cells.size:
                break
        kept = cells
    return kept
