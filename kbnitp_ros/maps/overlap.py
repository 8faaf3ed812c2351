# SPDX-License-Identifier: Apache-2.0
"""How the pixels of a map lie under the cells of a grid, along one axis."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# A pixel's edge this close to a cell's edge, in pixels, is on it: resolutions such as 0.05 m are
# not exact in binary.
ON_THE_EDGE = 1e-6


def pixels_under(
    cells: int, cell_size: float, first: float = 0.0
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the first pixel under each cell and the one after the last, shape (cells,) each."""
    edges = first + np.arange(cells + 1) * cell_size
    start = np.floor(edges[:-1] + ON_THE_EDGE).astype(np.intp)
    stop = np.ceil(edges[1:] - ON_THE_EDGE).astype(np.intp)
    return start, stop


def shares(cells: int, cell_size: float, first: float, pixels: int) -> NDArray[np.float64]:
    """Return how much of each pixel lies under each cell, in pixels, shape (cells, pixels)."""
    start = first + np.arange(cells) * cell_size
    pixel = np.arange(pixels)
    low = np.maximum(start[:, None], pixel)
    high = np.minimum(start[:, None] + cell_size, pixel + 1)
    share = high - low
    return np.where(share > ON_THE_EDGE, share, 0.0)
