# SPDX-License-Identifier: Apache-2.0
"""The exact marginal posterior of a loss, in time linear in the path."""

from __future__ import annotations

from kbnitp_ros.core.field import (
    log_predicted_survival,
    SensorModel,
    sum_of_others,
    times_log,
    Visits,
)
import numpy as np
from numpy.typing import NDArray


def lost_likelihood(
    hazard: NDArray[np.float64], model: SensorModel, visits: Visits
) -> NDArray[np.float64]:
    """
    Return P(lost | Z_i = z) = 1 - s_z^n_i * prod_{k != i} S_k.

    S_k is the predicted survival of the n_k visits to cell k, so the other cells are summed out
    at their beliefs.

    Parameters
    ----------
    hazard : ndarray, shape (..., n)
        P(Z = 1) of the visited cells.
    model : SensorModel
        Gives s0 and s1.
    visits : Visits
        The n cells and how often each is visited.

    Returns
    -------
    ndarray, shape (..., n, 2)
        Indexed [..., visited cell, z], in [0, 1].

    """
    log_survival = model.log_survival
    others = sum_of_others(log_predicted_survival(hazard, visits.counts, log_survival))
    return -np.expm1(times_log(visits.counts[:, None], log_survival) + others[..., None])
