# SPDX-License-Identifier: Apache-2.0
"""The update of a loss as the paper prints it (arXiv:2305.06929, eq. 5 and 10-12)."""

from __future__ import annotations

from kbnitp_ros.core.field import SensorModel, Visits
import numpy as np
from numpy.typing import NDArray


def lost_likelihood(
    hazard: NDArray[np.float64], model: SensorModel, visits: Visits
) -> NDArray[np.float64]:
    """
    Return sum_j w_j P(D_i = [i = j] | Z_i = z), summed over the instances i of a repeated cell.

    The sum runs over the steps j at which the robot may have been destroyed, weighted by
    w_j = prod_{k<j} P(D_k = 0) * P(D_j = 1) with the prior's marginals. A cell's own marginal
    thus enters twice, and the cells after j count as survived: the update is more confident than
    the evidence allows. `exact` is the remedy; this is what the paper measured.

    Parameters
    ----------
    hazard : ndarray, shape (n,)
        P(Z = 1) of the visited cells.
    model : SensorModel
        Gives P(D = 0 | Z).
    visits : Visits
        The n cells, how often each is visited, and in which steps.

    Returns
    -------
    ndarray, shape (n, 2)
        Indexed [visited cell, z].

    """
    survives = model.survival(hazard)[visits.of_step]
    reached = np.concatenate([[1.0], np.cumprod(survives[:-1])])
    destroyed_here = reached * (1.0 - survives)
    here = np.bincount(visits.of_step, weights=destroyed_here)
    elsewhere = visits.counts * destroyed_here.sum() - here
    survives_given = model.survival((0, 1))
    likelihood: NDArray[np.float64] = here[:, None] * (1.0 - survives_given)
    likelihood += elsewhere[:, None] * survives_given
    return likelihood
