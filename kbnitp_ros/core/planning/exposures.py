# SPDX-License-Identifier: Apache-2.0
"""Distributions of the number of steps that lead into a hazard, as paths grow."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def with_visit(
    exposures: NDArray[np.float64], hazard: NDArray[np.float64], visits: NDArray[np.intp]
) -> NDArray[np.float64]:
    """
    Return the distributions of exposures after one more visit to a cell.

    Parameters
    ----------
    exposures : ndarray, shape (n, steps + 1)
        Before.
    hazard : ndarray, shape (n,)
        P(Z = 1) of the cell visited.
    visits : ndarray of int, shape (n,)
        How often it was visited before.

    Returns
    -------
    ndarray, shape (n, steps + 2)

    """
    after = np.zeros((len(exposures), exposures.shape[1] + 1))
    for count in np.unique(visits):
        same = visits == count
        z = hazard[same, None]
        others = without_cell(exposures[same], hazard[same], count)
        reach = others.shape[1]
        moved = np.zeros((len(others), after.shape[1]))
        moved[:, :reach] = (1.0 - z) * others
        moved[:, -reach:] += z * others
        after[same] = moved
    return after


def without_cell(
    exposures: NDArray[np.float64], hazard: NDArray[np.float64], visits: int
) -> NDArray[np.float64]:
    """
    Return the distributions of exposures in all cells but one.

    Takes one cell's factor (1 - z) + z t^visits out of the generating polynomial, from the end at
    which the division is stable: the lower coefficients where the cell is likely safe.

    Parameters
    ----------
    exposures : ndarray, shape (n, steps + 1)
        With the cell.
    hazard : ndarray, shape (n,)
        z = P(Z = 1) of the cell.
    visits : int
        How often it was visited.

    Returns
    -------
    ndarray, shape (n, steps + 1 - visits)

    """
    if not visits:
        return exposures
    deadly = hazard > 0.5
    product = np.where(deadly[:, None], exposures[:, ::-1], exposures).T
    rarer = np.where(deadly, 1.0 - hazard, hazard)
    quotient = np.empty((len(product) - visits, len(hazard)))
    for power in range(len(quotient)):
        quotient[power] = product[power]
        if power >= visits:
            quotient[power] -= rarer * quotient[power - visits]
        quotient[power] /= 1.0 - rarer
    return np.where(deadly[:, None], quotient.T[:, ::-1], quotient.T)
