# SPDX-License-Identifier: Apache-2.0
"""The normalisation of clustered hazards."""

from __future__ import annotations

from kbnitp_ros.core.field.partition_kernels import transfer
import numpy as np
from numpy.typing import NDArray

# Fields of at most so many cells across are summed exactly.
MOST_ACROSS = 16
# Wider ones are put together of strips of so many columns.
STRIP = 12


def log_partition(
    free: NDArray[np.bool_], fields: NDArray[np.float64], coupling: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """
    Return ln Z and the expected number of hazards, for each field.

    Equations :eq:`transfer-matrix` and :eq:`strips`.
    """
    if free.shape[1] > free.shape[0]:
        free = free.T
    rows, columns = free.shape
    holes = np.argwhere(~free)
    if columns <= STRIP or (columns <= MOST_ACROSS and len(holes) > 1):
        return _sums(free, fields, coupling)
    if len(holes) > 1:
        raise ValueError(
            f'a field of {columns} x {rows} cells with {len(holes)} cells that cannot have a '
            f'hazard is too wide for clustered hazards: with obstacles, at most {MOST_ACROSS} '
            'cells across'
        )
    # The hole is as far from the nearer edge as in the field.
    strip = np.ones((rows, STRIP), dtype=bool)
    for row, column in holes:
        middle = STRIP // 2
        strip[row, column if column < middle else max(middle, column - columns + STRIP)] = False
    log_z, count = _sums(strip, fields, coupling)
    wide, narrow = (
        _sums(np.ones((rows, width), dtype=bool), fields, coupling) for width in (STRIP, STRIP - 1)
    )
    more = columns - STRIP
    return log_z + more * (wide[0] - narrow[0]), count + more * (wide[1] - narrow[1])


def _sums(
    free: NDArray[np.bool_], fields: NDArray[np.float64], coupling: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return what `transfer` finds."""
    log_z, count = np.empty_like(fields), np.empty_like(fields)
    transfer(np.ascontiguousarray(free), fields, coupling, log_z, count)
    return log_z, count
