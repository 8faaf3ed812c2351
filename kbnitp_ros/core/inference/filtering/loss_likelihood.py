# SPDX-License-Identifier: Apache-2.0
"""The likelihood of a loss given the hazard of one cell: exact, by universes, and as published."""

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
    Return P(lost | Z_i = z) = 1 - s_z^n_i * prod_{k != i} S_k: the exact marginal posterior.

    Equation :eq:`loss-exact`, in time linear in the path. S_k is the predicted survival
    of the n_k visits to cell k, so the other cells are summed out at their beliefs.

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


def multi_universe_likelihood(
    hazard: NDArray[np.float64], model: SensorModel, visits: Visits
) -> NDArray[np.float64]:
    """
    Return the sum over universes j of P(destroyed in step j | Z_i = z) (Otte & Sofge 2021).

    Equation :eq:`loss-universes`.

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


def published_likelihood(
    hazard: NDArray[np.float64], model: SensorModel, visits: Visits
) -> NDArray[np.float64]:
    """
    Return the likelihood as the paper prints it (arXiv:2305.06929, eq. 5 and 10-12).

    Equation :eq:`loss-published`: sum_j w_j P(D_i = [i = j] | Z_i = z), summed over the instances
    i of a repeated cell.

    The sum runs over the steps j at which the robot may have been destroyed, weighted by
    w_j = prod_{k<j} P(D_k = 0) * P(D_j = 1) with the prior's marginals. A cell's own marginal
    thus enters twice, and the cells after j count as survived: the update is more confident than
    the evidence allows. This is what the paper measured; `lost_likelihood` is the remedy.

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
