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

    Equation :eq:`loss-exact`.
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

    Equation :eq:`located-exact`.
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

    Equation :eq:`loss-published`.
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
    """Return whether any hazards explain a loss in a step that fits what was observed."""
    open_to = possible.copy()
    for cell, weight in zip(of_step, lost_at):
        if weight > 0.0 and (open_to[cell] & (dies > 0.0)).any():
            return True
        open_to[cell] &= survives > 0.0
        if not open_to[cell].any():
            return False
    return False
