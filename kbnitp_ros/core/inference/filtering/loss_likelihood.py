# SPDX-License-Identifier: Apache-2.0
"""
The likelihood of a loss given the hazard of one cell: exact, by universes, and as published.

Each takes `lost_at`, shape (steps,): how well what was observed fits a loss in each step, up to a
factor; None if all steps are alike.
"""

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
    hazard: NDArray[np.float64],
    model: SensorModel,
    visits: Visits,
    lost_at: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    """
    Return P(lost | Z_i = z) = 1 - s_z^n_i * prod_{k != i} S_k: the exact marginal posterior.

    With `lost_at` it is that of `located_likelihood`, for one belief at a time.

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
    lost_at : ndarray, shape (steps,), optional
        How well each step fits.

    Returns
    -------
    ndarray, shape (..., n, 2)
        Indexed [..., visited cell, z], in [0, 1].

    """
    if lost_at is not None:
        return located_likelihood(hazard, model, visits, lost_at)
    log_survival = model.log_survival
    others = sum_of_others(log_predicted_survival(hazard, visits.counts, log_survival))
    return -np.expm1(times_log(visits.counts[:, None], log_survival) + others[..., None])


def located_likelihood(
    hazard: NDArray[np.float64],
    model: SensorModel,
    visits: Visits,
    lost_at: NDArray[np.float64],
) -> NDArray[np.float64]:
    """
    Return sum_k lost_at[k] P(lost in step k | Z_i = z): the exact marginal posterior.

    Equation :eq:`located-exact`. Cells are independent before the loss, so in each step only the
    cell that it leads to tells whether the robot goes on: of cell i the chances given z, of any
    other those by its own belief given that it spared the robot so far. Nothing is subtracted.

    Parameters
    ----------
    hazard, model, visits, lost_at
        As of `lost_likelihood`, of one belief.

    Returns
    -------
    ndarray, shape (n, 2)
        Indexed [visited cell, z].

    """
    survives, dies = np.exp(model.log_survival), -np.expm1(model.log_survival)
    chance = np.stack([1.0 - hazard, hazard], axis=1)
    reached = np.ones_like(chance)
    likelihood = np.zeros_like(chance)
    for cell, weight in zip(visits.of_step, lost_at):
        spared = chance[cell] @ survives
        lost, goes_on = np.full_like(chance, chance[cell] @ dies), np.full_like(chance, spared)
        lost[cell], goes_on[cell] = dies, survives
        likelihood += weight * reached * lost
        reached *= goes_on
        if spared > 0.0:
            chance[cell] *= survives / spared
    return likelihood


def multi_universe_likelihood(
    hazard: NDArray[np.float64],
    model: SensorModel,
    visits: Visits,
    lost_at: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    """
    Return the sum over universes j of P(destroyed in step j | Z_i = z) (Otte & Sofge 2021).

    Equation :eq:`loss-universes`.

    In universe j the robot survived the steps before j and was destroyed in step j. Each universe
    has a posterior of its own; averaged with the universes' probabilities as weights they give
    P(Z_i = z) times this sum. The universes exclude each other and together are the loss, so the
    average equals the exact marginal posterior. With `lost_at` each universe weighs by how well it
    fits what was observed, and the average is `located_likelihood`.

    Parameters
    ----------
    hazard, model, visits, lost_at
        As of `lost_likelihood`, of one belief.

    Returns
    -------
    ndarray, shape (n, 2)
        Indexed [visited cell, z], in [0, 1].

    """
    if lost_at is not None:
        return located_likelihood(hazard, model, visits, lost_at)
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
    hazard: NDArray[np.float64],
    model: SensorModel,
    visits: Visits,
    lost_at: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    """
    Return the likelihood as the paper prints it (arXiv:2305.06929, eq. 5 and 10-12).

    Equation :eq:`loss-published`: sum_j w_j P(D_i = [i = j] | Z_i = z), summed over the instances
    i of a repeated cell.

    The sum runs over the steps j at which the robot may have been destroyed, weighted by
    w_j = prod_{k<j} P(D_k = 0) * P(D_j = 1) with the prior's marginals. A cell's own marginal
    thus enters twice, and the cells after j count as survived: the update is more confident than
    the evidence allows. This is what the paper measured; `lost_likelihood` is the remedy. Each
    w_j is multiplied by `lost_at`, if given.

    Parameters
    ----------
    hazard, model, visits, lost_at
        As of `lost_likelihood`, of one belief.

    Returns
    -------
    ndarray, shape (n, 2)
        Indexed [visited cell, z].

    """
    survives = model.survival(hazard)[visits.of_step]
    reached = np.concatenate([[1.0], np.cumprod(survives[:-1])])
    destroyed_here = reached * (1.0 - survives)
    if lost_at is not None:
        destroyed_here *= lost_at
    here = np.bincount(visits.of_step, weights=destroyed_here)
    elsewhere = visits.counts * destroyed_here.sum() - here
    survives_given = model.survival((0, 1))
    likelihood: NDArray[np.float64] = here[:, None] * (1.0 - survives_given)
    likelihood += elsewhere[:, None] * survives_given
    return likelihood


def can_be_lost(
    possible: NDArray[np.bool_],
    of_step: NDArray[np.integer],
    lost_at: NDArray[np.float64],
    survives: NDArray[np.float64],
    dies: NDArray[np.float64],
) -> bool:
    """
    Return whether any hazards explain a loss in a step that fits what was observed.

    Parameters
    ----------
    possible : ndarray of bool, shape (n, 2)
        Which hazards z each of the n cells may have.
    of_step : ndarray of int, shape (steps,)
        The cell that each step leads to, as its place among these.
    lost_at : ndarray, shape (steps,)
        How well each step fits.
    survives, dies : ndarray, shape (2,)
        s_z and 1 - s_z.

    """
    open_to = possible.copy()
    for cell, weight in zip(of_step, lost_at):
        if weight > 0.0 and (open_to[cell] & (dies > 0.0)).any():
            return True
        open_to[cell] &= survives > 0.0
        if not open_to[cell].any():
            return False
    return False
