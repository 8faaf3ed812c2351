# SPDX-License-Identifier: Apache-2.0
"""Clustered hazards: their prior, and its normalization."""

from __future__ import annotations

from dataclasses import dataclass

from kbnitp_ros.core.field.check import in_short, number, typed_fields
from kbnitp_ros.core.field.grid import Grid
from kbnitp_ros.core.field.partition_kernels import transfer
from kbnitp_ros.core.field.unknowns import Bins
import numpy as np
from numpy.typing import NDArray

# Maximum width of a field whose partition function is summed exactly, in cells.
MAX_ACROSS = 16
# Width of the strips from which the sums of wider fields are extrapolated, in cells.
STRIP = 12


def log_partition(
    free: NDArray[np.bool_], fields: NDArray[np.float64], coupling: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return ln Z and expected hazards for each field a (:eq:`transfer-matrix`, :eq:`strips`)."""
    if free.shape[1] > free.shape[0]:
        free = free.T
    rows, columns = free.shape
    holes = np.argwhere(~free)
    if columns <= STRIP or (columns <= MAX_ACROSS and len(holes) > 1):
        return transfer(np.ascontiguousarray(free), fields, coupling)
    if len(holes) > 1:
        raise ValueError(
            f'a field of {columns} x {rows} cells with {len(holes)} cells that cannot have a '
            f'hazard is too wide for clustered hazards: with obstacles, its shorter side may have '
            f'at most {MAX_ACROSS} cells'
        )
    # Place the hole as far from the nearer edge of the strip as it is in the whole field.
    strip = np.ones((rows, STRIP), dtype=bool)
    for row, column in holes:
        middle = STRIP // 2
        strip[row, column if column < middle else max(middle, column - columns + STRIP)] = False
    log_z, count = transfer(strip, fields, coupling)
    wide, narrow = (
        transfer(np.ones((rows, width), dtype=bool), fields, coupling)
        for width in (STRIP, STRIP - 1)
    )
    more = columns - STRIP
    return log_z + more * (wide[0] - narrow[0]), count + more * (wide[1] - narrow[1])


# Maximum coupling: above the critical 1.763, hazards nearly fill large regions, or none occur.
STRONGEST = 1.7
# Number of bins of a learnt coupling.
COUPLINGS = 17
# Tolerance of the log odds of the density, and maximum number of secant steps.
PRECISION = 1e-10
MAX_SECANTS = 100

LEARNT_COUPLING = 'learn'


@typed_fields
@dataclass(frozen=True)
class Clustering:
    r"""
    A prior in which hazards lie in clusters: a Markov random field.

    Equation :eq:`clustered-prior`,

    .. math:: P(z) \propto \exp \Bigl( a \sum_i z_i + J \sum_{i \sim j} z_i z_j \Bigr),

    over the cells that may have a hazard; i ~ j are the pairs of cells that share a side. The
    field a is chosen so that the mean of P(z_i = 1) over these cells is the prior's density.

    Parameters
    ----------
    grid : Grid
        Grid of the cells.
    coupling : float or str
        J in [0, 1.7]; 0 for independent hazards; ``'learn'`` for an unknown coupling with a
        uniform prior.

    Raises
    ------
    ValueError
        If the coupling is NaN, out of range or another word.

    """

    grid: Grid
    coupling: float | str

    def __post_init__(self) -> None:
        if isinstance(self.coupling, str) and self.coupling == LEARNT_COUPLING:
            return
        try:
            coupling = number('coupling', self.coupling, '', lambda c: 0.0 <= c <= STRONGEST)
        except (TypeError, ValueError) as error:
            words = (
                f"coupling is {in_short(self.coupling)}: it must be in [0, {STRONGEST}] or 'learn'"
            )
            raise ValueError(words) from error
        object.__setattr__(self, 'coupling', coupling)

    @property
    def bins(self) -> Bins:
        """Return the possible couplings and their prior."""
        if self.coupling != LEARNT_COUPLING:
            return Bins.known(float(self.coupling))
        edges = STRONGEST * np.arange(COUPLINGS + 1) / COUPLINGS
        values = (edges[1:] + edges[:-1]) / 2.0
        return Bins(edges, values, np.full(COUPLINGS, -np.log(COUPLINGS)))

    @property
    def neighbors(self) -> NDArray[np.intp]:
        """Return the neighbours that share a side with each cell, or -1; shape (cells, 4)."""
        cells = np.arange(self.grid.cells).reshape(self.grid.height, self.grid.width)
        around = np.pad(cells, 1, constant_values=-1)
        sides = (around[1:-1, :-2], around[1:-1, 2:], around[:-2, 1:-1], around[2:, 1:-1])
        return np.stack(sides, axis=-1).reshape(-1, 4)

    def fields(
        self, possible: NDArray[np.bool_], densities: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the field a and log Z for each coupling and density (:eq:`clustered-density`)."""
        free = possible.reshape(self.grid.height, self.grid.width)
        if densities.size > 1 and min(free.shape) > STRIP and np.count_nonzero(~free) > 1:
            raise ValueError(
                f'hazard_density is unknown on a field of {self.grid.width} x {self.grid.height} '
                f'cells with obstacles: clustered hazards then need a known hazard_density, or a '
                f'field that is at most {STRIP} cells across'
            )
        sought = np.log(densities) - np.log1p(-densities)
        field = sought.copy()
        fields, log_zs = [], []
        for coupling in self.bins.values:
            # Start the search from the solution for the previous coupling.
            field, log_z = _solve_field(free, coupling, sought, field)
            fields.append(field)
            log_zs.append(log_z)
        return np.stack(fields), np.stack(log_zs)


def _solve_field(
    free: NDArray[np.bool_],
    coupling: float,
    sought: NDArray[np.float64],
    field: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Find the field for the log odds `sought`, and its log Z, by the secant method."""
    cells = np.count_nonzero(free)
    slope, off = np.ones_like(field), np.zeros_like(field)
    step = np.zeros_like(field)
    for _ in range(MAX_SECANTS):
        log_z, count = log_partition(free, field, coupling)
        before, off = off, np.log(count) - np.log(cells - count) - sought
        if np.abs(off).max() < PRECISION:
            return field, log_z
        moved = step != 0.0
        slope[moved] = np.maximum((off - before)[moved] / step[moved], 1.0)
        step = -off / slope
        field = field + step
    return field, log_z
