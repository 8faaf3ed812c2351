# SPDX-License-Identifier: Apache-2.0
"""The cells of places that people name: points, or the corners of a polygon."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kbnitp_ros.configuration.field import make_datum
from kbnitp_ros.core import Grid
import numpy as np
from numpy.typing import NDArray


def said_cells(grid: Grid, values: Mapping[str, Any], request: Any) -> NDArray[np.intp]:
    """Return the cells of the places of a request of `add_finding`; values: the parameters."""
    if len(request.x) != len(request.y):
        raise ValueError(f'x has {len(request.x)} values, and y {len(request.y)}')
    places = np.stack([request.x, request.y], axis=-1)
    if not np.isfinite(places).all():
        raise ValueError('x and y must be finite')
    if request.geographic:
        if (datum := make_datum(values)) is None:
            raise ValueError('geographic is True, and the parameter datum is empty')
        places = np.array([datum.in_map(*place) for place in places.tolist()])
    if not request.polygon:
        return np.unique(grid.cells_at(places))
    inside = np.flatnonzero(within(grid.centers(np.arange(grid.cells)), places))
    if not inside.size:
        raise ValueError('the polygon contains no centre of a cell')
    return inside


def within(points: NDArray[np.float64], corners: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which points lie in a polygon, by the number of its sides to their right."""
    if len(corners) < 3:
        raise ValueError(f'the polygon has {len(corners)} corners: it must have at least 3')
    x, y = points[:, :1], points[:, 1:]
    (x0, y0), (x1, y1) = corners.T, np.roll(corners, -1, axis=0).T
    crosses = (y0 > y) != (y1 > y)
    height = np.where(y1 == y0, 1.0, y1 - y0)
    right = x < x0 + (y - y0) * (x1 - x0) / height
    odd: NDArray[np.bool_] = (crosses & right).sum(axis=1) % 2 == 1
    return odd
