# SPDX-License-Identifier: Apache-2.0
"""The cells that paths can lead through, in the order in which they come within reach."""

from __future__ import annotations

from dataclasses import dataclass

from kbnitp_ros.core.field import Grid
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Reach:
    """
    The cells from which a robot can still return.

    Attributes
    ----------
    cells : ndarray of int, shape (n,)
        By their distance from the base, which comes first, and then ascending; the place of a
        cell is its rank.
    neighbors : ndarray of int, shape (n, 9)
        Ranks of the cells one step away, -1 where there is none. Columns j and 8 - j lead into
        opposite directions.
    within : ndarray of int, shape (max_steps + 1,)
        After so many steps the robot is in one of the first so many cells.

    """

    cells: NDArray[np.intp]
    neighbors: NDArray[np.intp]
    within: NDArray[np.intp]

    @classmethod
    def of(cls, grid: Grid, max_steps: int) -> Reach:
        """Return the reach of paths of at most `max_steps` steps."""
        cells = np.flatnonzero(grid.in_reach(max_steps))
        distance = grid.steps_to_base[cells]
        order = np.argsort(distance, kind='stable')
        cells = cells[order]
        rank = np.full(grid.cells + 1, -1)
        rank[cells] = np.arange(cells.size)
        step = np.arange(max_steps + 1)
        within = np.searchsorted(distance[order], np.minimum(step, max_steps - step), 'right')
        return cls(cells, rank[grid.neighbor_table[cells]], within)
