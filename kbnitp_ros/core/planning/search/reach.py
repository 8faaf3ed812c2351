# SPDX-License-Identifier: Apache-2.0
"""The cells that paths can lead through, in the order in which they come within reach."""

from __future__ import annotations

from kbnitp_ros.core.field import Grid
from kbnitp_ros.core.planning.search.label_kernels import Reach
import numpy as np


def reach_of(grid: Grid, max_steps: int) -> Reach:
    """Return the reach of paths of at most `max_steps` steps."""
    cells = np.flatnonzero(grid.in_reach(max_steps))
    distance = grid.steps_to_base[cells]
    order = np.argsort(distance, kind='stable')
    cells = cells[order]
    rank = np.full(grid.cells + 1, -1)
    rank[cells] = np.arange(cells.size)
    step = np.arange(max_steps + 1)
    within = np.searchsorted(distance[order], np.minimum(step, max_steps - step), 'right')
    start = np.append(0, np.cumsum(within))
    return Reach(cells, rank[grid.neighbor_table[cells]], within, start)
