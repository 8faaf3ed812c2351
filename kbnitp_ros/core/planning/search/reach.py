# SPDX-License-Identifier: Apache-2.0
"""The cells that paths can lead through, in the order in which they come within reach."""

from __future__ import annotations

from kbnitp_ros.core.field import Grid, longest
from kbnitp_ros.core.planning.objective import SearchOptions
from kbnitp_ros.core.planning.search.label_kernels import Reach
import numpy as np


def reach_of(grid: Grid, options: SearchOptions) -> Reach:
    """Return the reach of paths within `max_steps` and `max_distance`."""
    max_steps, max_distance = options.max_steps, options.max_distance
    cells = np.flatnonzero(grid.in_reach(max_steps, max_distance))
    distance = grid.steps_to_base[cells]
    order = np.argsort(distance, kind='stable')
    cells = cells[order]
    rank = np.full(grid.cells + 1, -1)
    rank[cells] = np.arange(cells.size)
    step = np.arange(max_steps + 1)
    within = np.searchsorted(distance[order], np.minimum(step, max_steps - step), 'right')
    start = np.append(0, np.cumsum(within))
    neighbors = rank[grid.neighbor_table[cells]]
    if not max_distance:
        # Where no length is allowed for, none is counted.
        lengths, home = np.zeros(9), np.zeros(cells.size)
        return Reach(cells, neighbors, within, start, lengths, home, 0.0)
    return Reach(
        cells,
        neighbors,
        within,
        start,
        grid.step_lengths.copy(),
        grid.distance_to_base[cells],
        longest(max_distance),
    )
