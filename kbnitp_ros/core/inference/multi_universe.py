# SPDX-License-Identifier: Apache-2.0
"""The update of a loss by multi-universe averaging (Otte & Sofge 2021)."""

from __future__ import annotations

from kbnitp_ros.core.field import log_predicted_survival, SensorModel, times_log, Visits
import numpy as np
from numpy.typing import NDArray


def lost_likelihood(
    hazard: NDArray[np.float64], model: SensorModel, visits: Visits
) -> NDArray[np.float64]:
    """
    Return the sum over universes j of P(destroyed in step j | Z_i = z).

    In universe j the robot survived the steps before j and was destroyed in step j. Each universe
    has a posterior of its own; averaged with the universes' probabilities as weights they give
    P(Z_i = z) times this sum. The universes exclude each other and together are the loss, so the
    average equals the exact marginal posterior.

    Parameters
    ----------
    hazard : ndarray, shape (n,)
        P(Z = 1) of the visited cells.
    model : SensorModel
        Gives s0 and s1.
    visits : Visits
        The n cells, how often each is visited, and in which steps.

    Returns
    -------
    ndarray, shape (n, 2)
        Indexed [visited cell, z], in [0, 1].

    """
    log_survival = model.log_survival
    cells = len(visits.cells)
    visited = visits.of_step[:, None] == np.arange(cells)
    # Visits made before each step, and after the last one: shape (steps + 1, n).
    made = np.concatenate([np.zeros((1, cells), dtype=np.intp), visited.cumsum(axis=0)])
    predicted = log_predicted_survival(hazard, made, log_survival)
    given = times_log(made[..., None], log_survival)
    # Survival of every cell but i, without a difference of infinities where S_i = 0.
    but_own = np.where(np.eye(cells, dtype=bool), 0.0, predicted[:, None, :]).sum(axis=-1)
    alive = np.exp(but_own[..., None] + given)
    destroyed: NDArray[np.float64] = (alive[:-1] - alive[1:]).sum(axis=0)
    return destroyed
